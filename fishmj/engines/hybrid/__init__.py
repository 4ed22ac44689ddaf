"""The water `hybrid`: MuJoCo swims in the fitted water, which short segments of the flow solver correct during the swim.

hybrid.py     schedule of the segments, the worker thread, and the report of corrections
hybrid_segment.py    a segment of a swim, repeated in the reference water, and the difference of the two
tanks.py      the reference water: tanks of the flow solver, initialised from MuJoCo's state and stream
engine.py     the whole as an engine, for `evaluate` and `play`
"""

from fishmj.engines.hybrid.hybrid import Hybrid, HybridOptions

__all__ = ["Hybrid", "HybridOptions"]
