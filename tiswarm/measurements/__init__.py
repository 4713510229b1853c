"""What a log says: measurements as rows, and what they determine."""
