"""Optional: the method `hop-by-hop`, as rival systems localize."""
