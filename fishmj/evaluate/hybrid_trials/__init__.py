"""The verb `hydro_fit hybrid`: what the correction of a running water is worth, where it is right and where it is wrong."""
