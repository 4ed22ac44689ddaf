"""The oracle: a three-dimensional lattice Boltzmann flow around the articulated fish, the judge of every simpler water.

Warp kernels, one source for `cpu` and `cuda`. SI units outside, lattice units (names end in `_lu`) inside; only `lattice.Lattice`
converts between them. docs/solver/method.md has the method and the limits, docs/solver/results.md the validation table.
"""
