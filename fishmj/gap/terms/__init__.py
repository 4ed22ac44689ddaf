"""Describes a gap that no effect of the catalogue explains: forces as products of the fish's motion.

Every term is a provisional effect with one coefficient, added to the model and whitened by the null like any other (library.py,
select.py). A term describes the gap in the units of a force; it is never a named effect.
"""
