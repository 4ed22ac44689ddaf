"""The discrepancy workflow: where simulation and measurement disagree, which effect is missing, and the gap closed."""
