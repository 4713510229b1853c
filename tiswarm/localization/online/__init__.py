"""The method `online`: robots are located as they join."""
