"""Blind robots: independent simulators whose logs hide an effect, to test the search on."""
