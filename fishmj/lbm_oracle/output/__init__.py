"""What a swim leaves: slices, vorticity, volumes for ParaView, block averages, pictures."""
