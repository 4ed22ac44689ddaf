"""MuJoCo's own fluid, fitted: the first choice of a MuJoCo user, as a baseline for the strips.

force     its force on a link, term by term           swim     free swims of a batch of fish in it
fit       its coefficients by forces, then by swims   judged   the figures of the check
"""
