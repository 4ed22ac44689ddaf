"""The fish live in MeshCat: a running server, a page that follows it, one transform a slice of skin and frame.

MeshCat's protocol moves rigid objects cheaply but not vertices, so the skin is cut into slices of equal hinge share (see
`mjcf.skin`): each is rigid, neighbours overlap by a row of triangles, and a bend shows as a fine fan.
"""

import contextlib
import io
import os
import socket
import subprocess
import sys

import numpy as np

from fishmj.base.errors import ConfigError, StoreError
from fishmj.base.processes import end_command, start_command
from fishmj.mjcf.description import Robot
from fishmj.mjcf.skin import Skin, hinge_frames, skin
from fishmj.view.replay.replay_data import ARRIVAL

LEVELS = 6  # steps of hinge share over a bend zone
FLOOR = -0.4  # m
TANK = 4.0  # m, side
TRAIL = 400  # points kept
LOCAL = "127.0.0.1"
ENDS = 5.0  # s that the server may take to end


class SceneServer:
    """The process that serves the scene (`meshcat_server.py`), on `host` alone; it ends with this one.

    Raises ConfigError: `host` is no address of this machine; StoreError: the server does not start.
    """

    def __init__(self, host: str = LOCAL):
        check_host(host)
        command = [sys.executable, "-u", "-m", "fishmj.view.replay.meshcat_server", host]
        environ = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        self.process = start_command(command, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environ)
        said = [self.process.stdout.readline().strip() for _ in range(2)]  # type: ignore[union-attr]
        if not all(said):
            self.close()
            raise StoreError(f"play: the MeshCat server on {host} did not start; see: {' '.join(command[:1] + command[2:])}")
        self.commands, self.url = said

    def close(self) -> None:
        """Stops the server."""
        end_command(self.process, ENDS)


def check_host(host: str) -> None:
    """Checks that this machine can listen on `host`. Raises ConfigError if it cannot."""
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            probe.bind(address)
    except (OSError, UnicodeError) as error:
        raise ConfigError(f"play: cannot listen on {host[:80]!r} ({error}); take one of this machine, or {LOCAL}") from error


class LiveView:
    """A MeshCat scene of one fish, its target and the current. `url` is the page to open, `host` the address that it listens on.

    Raises MissingExtra: meshcat is not installed; ConfigError: `host` is no address of this machine.
    """

    def __init__(self, robot: Robot, host: str = LOCAL):
        import meshcat
        import meshcat.geometry as shapes

        self._shapes = shapes
        self.server = SceneServer(host)
        self.url = self.server.url
        with contextlib.redirect_stdout(io.StringIO()):  # MeshCat announces itself; the caller says it in its own words
            self._vis = meshcat.Visualizer(zmq_url=self.server.commands)
        self.skin = skin(robot, spacing=0.008, around=20, smooth=True)
        self.slices = slices_of(self.skin)
        self._trail: list[np.ndarray] = []
        self._build()

    def _build(self) -> None:
        s, v = self._shapes, self._vis
        v["/Background"].set_property("top_color", [0.72, 0.89, 0.95])
        v["/Background"].set_property("bottom_color", [0.05, 0.26, 0.36])
        v["/Axes"].set_property("visible", False)
        v["/Grid"].set_property("visible", False)
        v["/Cameras/default/rotated/<object>"].set_property("position", [-0.15, 1.15, 1.2])
        v["tank/floor"].set_object(s.Box([TANK, TANK, 0.02]), s.MeshLambertMaterial(color=0x2A86A2))
        v["tank/floor"].set_transform(_at((0.0, 0.0), FLOOR - 0.02))
        for name, pitch, colour in (("tiles", 0.25, 0x6FB6CA), ("metres", 1.0, 0xEAFBFF)):
            lines = s.PointsGeometry(grid(TANK, pitch, FLOOR).T)
            v[f"tank/{name}"].set_object(s.LineSegments(lines, s.LineBasicMaterial(color=colour)))
        shiny = s.MeshPhongMaterial(vertexColors=True, shininess=40)
        for i, (hinge, _, vertices, faces, rgb) in enumerate(self.slices):
            mesh = s.TriangularMeshGeometry(vertices - [self.skin.hinge_x[hinge], 0, 0], faces, rgb)
            v[f"fish/{i}"].set_object(mesh, shiny)
        v["target"].set_object(s.TriangularMeshGeometry(*ring(ARRIVAL, 0.006)), s.MeshPhongMaterial(color=0xF08A1D))
        v["current"].set_object(s.TriangularMeshGeometry(*arrow()), s.MeshBasicMaterial(color=0x7EF0FF))

    def show(self, q, target, current) -> None:
        """Draws one moment: q (2 + N,) [m, rad], target (2,) m, mean current (2,) m/s."""
        q = np.asarray(q, float)
        hinges, headings = hinge_frames(self.skin.hinge_x, q)
        for i, (hinge, share, *_) in enumerate(self.slices):
            turn = headings[hinge] + share * q[3 + hinge]
            self._vis[f"fish/{i}"].set_transform(_at(hinges[hinge], 0.0, turn))
        self._vis["target"].set_transform(_at(target))
        speed = float(np.hypot(*current))
        length = max(0.05, 2.0 * speed)
        place = _at(q[:2], 0.14, np.arctan2(current[1], current[0])) @ np.diag([length, 0.25, 1.0, 1.0])
        self._vis["current"].set_transform(place)
        self._vis["current"].set_property("visible", speed > 1e-3)

    def trail(self, point) -> None:
        """Adds a point (2,) m to the path that is drawn."""
        self._trail = [*self._trail[-TRAIL:], np.array([*point, -0.003], np.float32)]
        if len(self._trail) > 1:
            path = self._shapes.PointsGeometry(np.array(self._trail).T)
            self._vis["trail"].set_object(self._shapes.Line(path, self._shapes.LineBasicMaterial(color=0xFF5A4D)))

    def clear_trail(self) -> None:
        """Removes the drawn path."""
        self._trail = []
        self._vis["trail"].delete()

    def page(self) -> str:
        """The present scene as static HTML."""
        return self._vis.static_html()

    def close(self) -> None:
        """Stops the server that this view started."""
        self.server.close()

    def __enter__(self) -> "LiveView":
        return self

    def __exit__(self, *failure) -> None:
        self.close()


def slices_of(s: Skin) -> list[tuple[int, float, np.ndarray, np.ndarray, np.ndarray]]:
    """Rigid parts of a skin: (hinge, share, vertices, faces, colours). A triangle on a border is in both its slices."""
    level = np.round(s.share * LEVELS).astype(int)
    key = s.hinge * (LEVELS + 1) + level
    parts = []
    for value in np.unique(key):
        faces = s.faces[(key[s.faces] == value).any(1)]
        used, index = np.unique(faces, return_inverse=True)
        hinge, share = divmod(int(value), LEVELS + 1)
        parts.append((hinge, share / LEVELS, s.vertices[used], index.reshape(-1, 3), s.colour[used]))
    return parts


def ring(radius: float, thick: float, n: int = 64, m: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """A torus in the plane z = 0: vertices (n m, 3) m and triangles."""
    a, b = np.meshgrid(np.linspace(0, 2 * np.pi, n, endpoint=False), np.linspace(0, 2 * np.pi, m, endpoint=False), indexing="ij")
    reach = radius + thick * np.cos(b)
    vertices = np.stack([reach * np.cos(a), reach * np.sin(a), thick * np.sin(b)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    corner = lambda di, dj: ((i + di) % n * m + (j + dj) % m).ravel()
    one, two = (corner(0, 0), corner(1, 0), corner(0, 1)), (corner(0, 1), corner(1, 0), corner(1, 1))
    return vertices, np.concatenate([np.stack(one, 1), np.stack(two, 1)])


def grid(side: float, pitch: float, z: float) -> np.ndarray:
    """End points (2 L, 3) m of the lines of a square grid, in pairs, float32."""
    at = np.arange(-side / 2, side / 2 + 1e-9, pitch)
    along = np.stack([np.repeat(at, 2), np.tile([-side / 2, side / 2], len(at)), np.full(2 * len(at), z)], 1)
    return np.concatenate([along, along[:, [1, 0, 2]]]).astype(np.float32)


def arrow() -> tuple[np.ndarray, np.ndarray]:
    """A flat arrow of length 1 along x, centred: vertices and triangles."""
    outline = [[-0.5, -0.08], [0.1, -0.08], [0.1, 0.08], [-0.5, 0.08], [0.1, -0.25], [0.5, 0.0], [0.1, 0.25]]
    vertices = np.column_stack([np.array(outline), np.zeros(7)])
    return vertices, np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6]])


def _at(place, z: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """Homogeneous transform (4, 4): turn about z [rad], then shift to `place` (2,) and z, m."""
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, -s, 0, place[0]], [s, c, 0, place[1]], [0, 0, 1, z], [0, 0, 0, 1.0]])
