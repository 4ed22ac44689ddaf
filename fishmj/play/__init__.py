"""One fish live: you make the current and move the target. See `python -m fishmj.play --help`."""

from fishmj.play.pond import Chunk, Pond

__all__ = ["Chunk", "Pond"]
