"""The world: terrain, flips, and structures that grow out of robots climbing each other."""
