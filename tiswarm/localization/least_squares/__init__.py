"""All robots at once by a general optimiser: the problem, and rounds of solving it."""
