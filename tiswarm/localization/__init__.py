"""Localizers: from a sensing log alone to positions."""
