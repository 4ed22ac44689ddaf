"""Calibrate a fish against its logs: servo, latency, friction of the hull, masses."""
