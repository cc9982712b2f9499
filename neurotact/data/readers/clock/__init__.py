"""How time stamps are read: their units, and times of day."""
