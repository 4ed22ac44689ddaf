"""Comparison of the rankings of controllers in two waters."""
