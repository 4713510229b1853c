"""3D pictures of structures, and their solids for other programs."""
