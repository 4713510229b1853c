"""The swarm engine: virtual forces on every robot at once."""
