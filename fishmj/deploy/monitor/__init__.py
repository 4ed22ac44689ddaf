"""Comparison of a running swim with its simulation: prediction, statistics, alarms."""
