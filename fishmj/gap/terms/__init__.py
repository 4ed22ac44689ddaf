"""What a gap looks like when no effect of the catalogue explains it: forces as products of what the fish does.

Every term is a provisional effect with one coefficient, put into the model and whitened by the null like any other (library.py,
select.py). A term is a description in the units of a force, never a name.
"""
