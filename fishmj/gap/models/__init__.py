"""Plants: the simulations that the search can put effects into. One file each; all look the same to the search.

plant.constants     what every fit may adapt within its prior, and what it is nominally
plant.active        the effects, their parameters after the constants in a parameter row
plant.predict(records, which, rows) -> list of predictions, one dictionary of channels a record
"""
