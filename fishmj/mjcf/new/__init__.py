"""A description of a fish from eight answers, a table of sections or a photo, with checks and a picture."""
