"""The cost of configurations, its minima near a state, and their uncertainty."""
