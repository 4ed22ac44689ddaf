"""Station holding through the host, its camera and its radio, compared with the direct simulation of the same trials."""
