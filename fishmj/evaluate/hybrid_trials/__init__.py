"""The verb `hydro_fit hybrid`: the value of the correction of a running water, if that water is right and if it is wrong."""
