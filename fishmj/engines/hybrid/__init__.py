"""The water `hybrid`: MuJoCo swims in the fitted water, and short segments of the flow solver correct that water while it does.

hybrid.py     when a segment begins and ends, the worker beside the simulation, what was corrected
hybrid_segment.py    the swim of a fish, the same swim in a better water, and the difference of the two
tanks.py      the better water: tanks of the flow solver, seeded from MuJoCo's own state and stream
engine.py     all of it as an engine, for the judge and for `play`
"""

from fishmj.engines.hybrid.hybrid import Hybrid, HybridOptions

__all__ = ["Hybrid", "HybridOptions"]
