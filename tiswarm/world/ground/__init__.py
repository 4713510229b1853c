"""Ground of any form: its distance function, the bodies that make it, and grids of distances."""
