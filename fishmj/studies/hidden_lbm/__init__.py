"""Data sets of the solver with hidden effects and hidden numbers, and how well they were found."""
