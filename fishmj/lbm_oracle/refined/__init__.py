"""A box of finer cells nested in a coarser water: fine cells round the body, coarse cells in its wake and in the stream."""
