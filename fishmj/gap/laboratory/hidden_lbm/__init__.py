"""Logs of the flow solver with hidden effects or constants, and the score of their estimates."""
