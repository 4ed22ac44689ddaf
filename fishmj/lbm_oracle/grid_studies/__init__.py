"""Grid, time step and slip: what the solver's figures depend on."""
