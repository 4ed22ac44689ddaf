"""Writes a swim as MCAP, for Foxglove: the trial folder through `fishmj log export`, with the links of its robot."""

from pathlib import Path

from fishmj.log.export import export
from fishmj.mjcf.description import Robot
from fishmj.mjcf.drawing import solids


def write(folder: Path, robot: Robot) -> Path:
    """Writes FOLDER.mcap beside a trial folder.

    Raises MissingExtra: mcap is not installed; StoreError: the file is there, or the disk refuses.
    """
    out = folder.with_name(f"{folder.name}.mcap")
    export(folder, "mcap", out, shape=lambda trial: solids(robot))
    return out
