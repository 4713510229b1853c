"""The cost of an estimate and steps toward its minima; constants with their units and reasons.

Lengths in R.
"""

OVERLAP_SD = 0.05
"""Overlap of two docks that counts like a measurement missed by one standard deviation [R]."""

EXTENSION = 1.5
"""Gain in log-likelihood for each R more between robots in contact [R^-1]: robots climb as far as
they can, so that most configurations that fit are folded closer than what they build."""

ROBUST_SD = 3.0
"""Width of the robust loss [standard deviations]: where a measurement begins to give way."""
