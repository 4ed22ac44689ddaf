"""Replays of logs: one self-contained MeshCat page, or a top-view film.

from fishmj.view.replay import write_html, write_mp4
write_html([read_trial("runs/a"), read_trial("runs/b")], "replay.html")
"""

from fishmj.view.replay.html import write_html
from fishmj.view.replay.replay_data import Track, track
from fishmj.view.replay.video import write_mp4, write_png

__all__ = ["Track", "track", "write_html", "write_mp4", "write_png"]
