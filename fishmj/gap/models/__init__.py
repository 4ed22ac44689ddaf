"""The models that can be searched for missing effects. One file each, with a common interface.

model.constants     factors that null runs vary within their tolerance, with nominal values
model.active        the effects, their parameters after the constants in a parameter row
model.predict(records, rows) -> list of predictions, one dictionary of channels a record
"""
