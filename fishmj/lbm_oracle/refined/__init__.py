"""A box of finer cells nested in a coarser water: finer where the body is, coarse where only its wake and the stream are."""
