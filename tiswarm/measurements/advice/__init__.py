"""What to measure next, and how measurements narrow the places of one robot."""
