"""One fish live: you make the current and move the target. See `python -m fishmj.play --help`."""

from fishmj.play.live_session import Chunk, Pond

__all__ = ["Chunk", "Pond"]
