"""DAgger for the water: a policy swims in the refitted water, the solver swims what it met, and both train the next fit."""
