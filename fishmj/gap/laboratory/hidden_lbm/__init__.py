"""Logs of the flow solver in which effects or numbers are hidden, and how well they were found."""
