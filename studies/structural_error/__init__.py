"""Scales of the structural error of the search: distance of healthy robots of other waters from their calibrated models."""
