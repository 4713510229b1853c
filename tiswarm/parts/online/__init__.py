"""Optional: estimates while robots join, by the class `Tracker` and the method `online`."""
