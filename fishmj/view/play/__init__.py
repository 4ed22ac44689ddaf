"""One fish live: you make the current and move the target. See `python -m fishmj play --help`."""

from fishmj.view.play.live_session import Chunk, LiveSession

__all__ = ["Chunk", "LiveSession"]
