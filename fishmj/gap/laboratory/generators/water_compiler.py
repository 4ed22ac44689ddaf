"""Compiles the water models of this package; NaN propagates."""

from pathlib import Path

from fishmj.gap.laboratory.numba_entry import compilers

FILES = (__file__, str(Path(__file__).with_name("link_chain.py")))
inlined, entry = compilers("generators with other forms of water", FILES, {"fastmath": {"contract", "nsz", "arcp"}})
