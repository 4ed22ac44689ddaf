"""Output of a swim: slices, vorticity, volumes for ParaView, pictures."""
