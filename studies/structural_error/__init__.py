"""Widths of the structural error of the search: how far healthy robots of other waters lie from their calibrated models."""
