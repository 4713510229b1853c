"""From the ends of chains to an estimate: weights, solutions, outliers and verdicts."""
