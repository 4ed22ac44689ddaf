"""fishmj: a robotic fish in MuJoCo whose water is fitted to a CFD solver.

`import fishmj` loads NumPy only; everything heavier is imported where it is used.
"""

from fishmj.base import compile_cache, extras, interrupt, renderer
from fishmj.tasks import gym_ids

__version__ = "0.1.0"

interrupt.arm()  # before anything heavier is imported; does nothing but in a command
compile_cache.keep()  # before JAX is imported: it reads its environment then
renderer.watch()  # before MuJoCo is imported: a MUJOCO_GL that does not work is one line
extras.watch()  # a missing optional package is one line with its install command
gym_ids.announce()  # gymnasium.make("fishmj/StationHold-v0") works once both are imported
