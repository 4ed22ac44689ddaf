"""Which experiment separates what the records cannot."""
