"""One self-contained HTML file: MeshCat's own viewer, a small player, and the trials as compact binary data.

The page needs no network and no server. MeshCat's scene tree holds the objects (`/fish/..`, `/target/..`, `/water/..`), so its
controls still switch them; the player moves the skin, as `fishmj.mjcf.skin.posed` does, and draws the distance chart.
"""

import base64
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from fishmj.base import pages
from fishmj.base.errors import ConfigError, LogError, MissingExtra
from fishmj.base.store import write_text
from fishmj.log import Trial
from fishmj.mjcf.description import Robot
from fishmj.mjcf.skin import Skin, skin
from fishmj.view.replay.replay_data import ARRIVAL, TRACKS, Track, page_data, read_wake, robot_of, tracks_of

SCRIPTS = Path(__file__).parent / "page"
PLAYER = ("scene.js", "fish.js", "wake.js", "chart.js", "player.js")
TANK = 4.0  # m, side of the tank that is drawn


def write_html(
    trials: list[Trial],
    out: str | Path,
    robot: "Robot | str | None" = None,
    title: str = "fishmj replay",
    *,
    speed: float = 1.0,
    fields: str | Path | None = None,
) -> Path:
    """Writes a replay of one trial, or of several overlaid (the first solid, the others translucent).

    Args:
        robot: description for all trials; default, the one that each trial names.
        speed: playing speed at the start, 1 = real time.
        fields: folder with the vorticity slices of the first trial, as `lbm_oracle swim --fields` writes it.

    Raises:
        LogError: no trial, or one without a pose. ConfigError: joints do not match, or the fields are of another run.
        StoreError: the file cannot be written.
    """
    if not trials:
        raise LogError("nothing to replay: give at least one trial")
    if not 0 < speed <= 100:
        raise ConfigError(f"speed = {speed}; expected a factor in (0, 100], 1 = real time")
    chosen = [robot_of(trial, robot) for trial in trials]
    tracks = tracks_of(trials, chosen)
    data = {
        "title": title,
        "speed": speed,
        "arrival": ARRIVAL,
        "tank": TANK,
        "tracks": [_track_data(t, TRACKS[i % len(TRACKS)]) for i, t in enumerate(tracks)],
        "skins": [_skin_data(skin(one, smooth=True)) for one in chosen],
        "wake": None if fields is None else page_data(read_wake(fields, trials[0], tracks[0])),
    }
    return write_text(out, page(title, data))


def page(title: str, data: dict) -> str:
    """The whole document as text."""
    read = lambda name: (SCRIPTS / name).read_text(encoding="utf-8")
    player = '"use strict";\n' + "\n".join(map(read, PLAYER))
    return pages.page("replay.html", title, [read("trouble.js"), viewer_bundle(), player], data=pages.data(data))


def viewer_bundle() -> str:
    """MeshCat's viewer (three.js included) as it lies in the installed package."""
    found = find_spec("meshcat")
    if found is None or not found.origin:
        raise MissingExtra("meshcat", "view", "replay")
    bundle = Path(found.origin).parent / "viewer" / "dist" / "main.min.js"
    if not bundle.is_file():
        raise ConfigError(f"{bundle}: MeshCat's viewer is missing; reinstall it: pip install --force-reinstall meshcat")
    return bundle.read_text(encoding="utf-8").replace("</script", "<\\/script")


def _pack(array, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(array, dtype=kind).tobytes()).decode("ascii")


def _track_data(t: Track, colour: str) -> dict:
    return {
        "label": t.label,
        "origin": t.origin,
        "colour": colour,
        "frames": len(t.t),
        "duration": float(t.t[-1]),
        "links": t.q.shape[1] - 2,
        "meanFlow": t.mean_flow,
        "source": t.pose_from if t.pose_from == t.joints_from else f"{t.pose_from} and {t.joints_from}",
        **{key: _pack(getattr(t, key), "<f4") for key in ("q", "target", "flow", "power", "speed", "distance")},
    }


def _skin_data(s: Skin) -> dict:
    kinds = {"vertices": "<f4", "normals": "<f4", "faces": "<u4", "hinge": "<u4", "share": "<f4", "colour": "<f4"}
    return {key: _pack(getattr(s, key), kind) for key, kind in kinds.items()} | {"hingeX": s.hinge_x}
