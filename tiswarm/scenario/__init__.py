"""Scenarios: YAML files that define studies."""
