"""The oracle: a three-dimensional lattice Boltzmann flow around the articulated fish, the judge of every simpler water.

Warp kernels, one source for `cpu` and `cuda`. SI units outside, lattice units (names end in `_lu`) inside; only `lattice.Lattice`
converts between them. `lbm_oracle.Scene` is the flow round a body of your own. docs/solver/method.md has the method and the
limits, docs/solver/results.md the validation table.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fishmj.lbm_oracle.run.grid_study import grid_study
    from fishmj.lbm_oracle.scene import Scene, cylinder, mesh, plate, section, sphere

__all__ = ["Scene", "cylinder", "grid_study", "mesh", "plate", "section", "sphere"]


def __getattr__(name: str) -> Any:
    """Loads the names of `__all__`, and so Warp, at their first use."""
    if name not in __all__:
        raise AttributeError(f"module 'fishmj.lbm_oracle' has no attribute {name!r}")
    if name == "grid_study":
        from fishmj.lbm_oracle.run.grid_study import grid_study

        return grid_study
    from fishmj.lbm_oracle import scene

    return getattr(scene, name)


def __dir__() -> list[str]:
    """Names that a session shows."""
    return sorted({*globals(), *__all__})
