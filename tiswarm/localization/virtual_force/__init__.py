"""The paper's method: virtual forces, robot by robot or on all at once."""
