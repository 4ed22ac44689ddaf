"""The fish in the fluid: markers, the immersed boundary, the water inside the hull, and the coupled solve with its links."""
