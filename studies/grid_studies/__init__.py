"""Studies of grid, time step and slip, on which the solver's results depend."""
