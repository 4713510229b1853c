"""The method `distributed`: robots locate themselves by messages."""
