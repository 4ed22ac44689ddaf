"""Holding station through the host, its camera and its radio, against the direct simulation of the same trials."""
