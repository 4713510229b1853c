"""Methods as other systems have them, to compare with."""
