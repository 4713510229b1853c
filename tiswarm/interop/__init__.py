"""From other programs and to them: poses in, structures and estimates out."""
