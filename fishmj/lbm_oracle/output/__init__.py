"""What a swim leaves: slices, vorticity, volumes for ParaView, pictures."""
