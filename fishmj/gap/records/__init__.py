"""Measurements: records, their residual, checks that they are enough, and weighings."""
