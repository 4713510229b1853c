"""The only room that knows the compute backend: start-up, rotations, random numbers, cells."""
