"""All robots at once: equations from a log, annealed by several chains, summed up."""
