"""Plain data that passes from room to room, and the files it is kept in."""
