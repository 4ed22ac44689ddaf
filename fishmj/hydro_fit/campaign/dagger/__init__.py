"""DAgger for the water: a policy swims in the refitted water, the solver repeats its states, and both train the next fit."""
