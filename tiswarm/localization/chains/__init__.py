"""Chains: Langevin annealing of all robots at once, from a log's measurements."""
