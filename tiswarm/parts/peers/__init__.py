"""Optional: methods by which rival systems, and general solvers, localize."""
