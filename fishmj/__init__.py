"""fishmj: a robotic fish in MuJoCo whose water is fitted to a CFD solver.

`import fishmj` loads NumPy only; everything heavier is imported where it is used.
"""

__version__ = "0.1.0"
