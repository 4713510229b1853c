"""Optional parts: no other room imports them, and each can be left out of a copy."""
