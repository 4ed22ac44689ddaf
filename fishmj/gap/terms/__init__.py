"""Describes a gap that no effect of the catalogue explains: forces as products of the fish's motion.

Every term is a provisional effect with one coefficient, put into the model and whitened by the null like any other (library.py,
select.py). A term is a description in the units of a force, never a name.
"""
