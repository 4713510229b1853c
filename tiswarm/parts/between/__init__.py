"""Optional: localization by robots that know their own rows and what others sent them."""
