"""The verb `hydro_fit hybrid`: benefit of the online correction of a water, for correct and for wrong waters."""
