"""The fish's equations of motion: a planar chain of links, strip forces on it, and hooks where effects enter."""
