"""Offscreen pictures of structures, by whichever renderer the machine can run."""
