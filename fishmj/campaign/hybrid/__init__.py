"""Online correction: the surrogate swims, the solver swims a segment of the same motion, and the water is corrected by it."""
