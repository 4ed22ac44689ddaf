"""Logs of the flow solver with hidden effects or numbers, and the score of their estimates."""
