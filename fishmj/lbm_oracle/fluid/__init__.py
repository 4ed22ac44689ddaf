"""The fluid on its lattice: units, one fused step, collision, faces of the domain, inflow, storage, whole fields."""
