"""The models that are questioned, into which the search can put effects. One file each; all look the same to the search.

model.constants     factors that null runs differ by within their tolerance, and what each is nominally
model.active        the effects, their parameters after the constants in a parameter row
model.predict(records, rows) -> list of predictions, one dictionary of channels a record
"""
