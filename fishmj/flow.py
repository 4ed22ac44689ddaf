"""Background flow: what users import of `fishmj.water.flow`."""

from fishmj.water.flow import PRESETS, Flow

__all__ = ["PRESETS", "Flow"]
