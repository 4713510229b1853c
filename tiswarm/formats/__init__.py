"""Poses and trajectories of other programs in, structures and estimates out."""
