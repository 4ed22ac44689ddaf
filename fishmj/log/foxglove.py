"""Messages that Foxglove's panels show without set-up, and their published JSON schemas (encoding `jsonschema`).

    FrameTransform, FrameTransforms    tank -> fish, and from link to link: the frames that the 3D panel moves
    PoseInFrame                        the pose of the reference point in the tank
    SceneUpdate                        the links as triangles that ride on their frames, the target as a sphere with its ring

Field names, required keys and titles are those of github.com/foxglove/foxglove-sdk, schemas/jsonschema (2026-08); a test holds
every message against its schema. Positions m, angles rad, stamps {sec, nsec}.
"""

from functools import partial
from math import cos, pi, sin
from typing import Any, NamedTuple

import numpy as np

Json = dict[str, Any]
TANK, FISH = "tank", "fish"  # frames: the tank's, and the reference point of the fish (fixed to its first link)
PLATE = 0.002  # m, thickness of a fin as drawn
RING = 0.1  # m, within which a target counts as reached
RED, WATER = (0.85, 0.22, 0.18, 1.0), (0.31, 0.64, 0.83, 0.9)


class Solid(NamedTuple):
    """One link for drawing. Lengths in m."""

    name: str
    front: float  # x of the link's front end along the straight body from the reference point, x to the nose
    points: np.ndarray  # (V, 3) in the link's frame: the fish's for the first link, else at the joint before the link
    faces: np.ndarray  # (F, 3) indices of points
    plates: tuple[tuple[float, float, float, float], ...]  # fins: x and y of the middle, chord, span, in the same frame
    colour: tuple[float, float, float]  # red, green, blue, 0 to 1


# ------------------------------------------------------------------------------------------------------------------- schemas
def _thing(title: str, about: str, /, **properties: Json) -> Json:
    named = {"title": f"foxglove.{title}", "description": about, "type": "object"}
    return {**named, "properties": properties, "required": list(properties)}


def _of_type(kind: str, about: str) -> Json:
    return {"type": kind, "description": about}


_number, _text, _truth = (partial(_of_type, kind) for kind in ("number", "string", "boolean"))


def _list(items: Json, about: str) -> Json:
    return {"type": "array", "items": items, "description": about}


def _choice(title: str, *names: str) -> Json:
    return {"title": f"foxglove.{title}", "oneOf": [{"title": name, "const": i} for i, name in enumerate(names)]}


def _vector(title: str = "Vector3") -> Json:
    return _thing(title, "m", **{axis: _number(f"{axis}, m") for axis in "xyz"})


_NSEC = {"type": "integer", "minimum": 0, "maximum": 999999999}
TIME = {"type": "object", "title": "time", "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": _NSEC}}
DURATION = {"type": "object", "title": "duration", "properties": {"sec": {"type": "integer"}, "nsec": _NSEC}}
QUATERNION = _thing("Quaternion", "orientation", **{axis: _number(axis) for axis in "xyzw"})
POSE = _thing("Pose", "position and orientation", position=_vector(), orientation=QUATERNION)
COLOUR = _thing("Color", "0 to 1", **{part: _number(part) for part in "rgba"})
_POINTS = _list(_vector("Point3"), "m")
_COLOURS = _list(COLOUR, "one for each point, or none")
_INDICES = _list({"type": "integer", "minimum": 0}, "into points, or none")
_VERTICES = {"points": _POINTS, "color": COLOUR, "colors": _COLOURS, "indices": _INDICES}
_BOX = {"pose": POSE, "size": _vector()}
_LENGTHS = {name: _number("m") for name in ("shaft_length", "shaft_diameter", "head_length", "head_diameter")}
FRAME_TRANSFORM = _thing(
    "FrameTransform",
    "where a frame is in its parent: first the translation, then the rotation",
    timestamp=TIME,
    parent_frame_id=_text("name of the parent frame"),
    child_frame_id=_text("name of the child frame"),
    translation=_vector(),
    rotation=QUATERNION,
)
_SHAPES = {  # field of an entity -> what it holds, and what that is called
    "arrows": (_thing("ArrowPrimitive", "an arrow along +x of its pose", pose=POSE, **_LENGTHS, color=COLOUR), "arrows"),
    "cubes": (_thing("CubePrimitive", "a box", **_BOX, color=COLOUR), "boxes"),
    "spheres": (_thing("SpherePrimitive", "an ellipsoid; size: diameters", **_BOX, color=COLOUR), "ellipsoids"),
    "cylinders": (
        _thing(
            *("CylinderPrimitive", "a cylinder or cone"),
            **{**_BOX, "bottom_scale": _number("0 to 1"), "top_scale": _number("0 to 1"), "color": COLOUR},
        ),
        "cylinders",
    ),
    "lines": (
        _thing(
            *("LinePrimitive", "a line"),
            type=_choice("LineType", "LINE_STRIP", "LINE_LOOP", "LINE_LIST"),
            pose=POSE,
            thickness=_number("m, or pixels"),
            scale_invariant=_truth("whether the thickness is in pixels"),
            **_VERTICES,
        ),
        "lines",
    ),
    "triangles": (_thing("TriangleListPrimitive", "triangles", pose=POSE, **_VERTICES), "triangles"),
    "texts": (
        _thing(
            *("TextPrimitive", "a label"),
            pose=POSE,
            billboard=_truth("whether it faces the viewer"),
            font_size=_number("m, or pixels"),
            scale_invariant=_truth("whether the size is in pixels"),
            color=COLOUR,
            text=_text("the label"),
        ),
        "labels",
    ),
    "models": (
        _thing(
            *("ModelPrimitive", "a 3D model"),
            pose=POSE,
            scale=_vector(),
            color=COLOUR,
            override_color=_truth("whether the colour is used"),
            url=_text("where the model lies"),
            media_type=_text("of the model"),
            data={**_text("the model itself"), "contentEncoding": "base64"},
        ),
        "models",
    ),
}
_ENTITY = _thing(
    "SceneEntity",
    "a visual element in a 3D scene",
    timestamp=TIME,
    frame_id=_text("frame of reference"),
    id=_text("an entity replaces the one before it with the same id"),
    lifetime=DURATION,
    frame_locked=_truth("whether it follows its frame"),
    metadata=_list(_thing("KeyValuePair", "a key with its value", key=_text("key"), value=_text("value")), "more about it"),
    **{name: _list(shape, about) for name, (shape, about) in _SHAPES.items()},
)
_DELETION = _thing(
    "SceneEntityDeletion",
    "remove entities",
    timestamp=TIME,
    type=_choice("SceneEntityDeletionType", "MATCHING_ID", "ALL"),
    id=_text("of the entity"),
)
SCHEMAS: dict[str, Json] = {
    "foxglove.FrameTransform": FRAME_TRANSFORM,
    "foxglove.FrameTransforms": _thing("FrameTransforms", "several", transforms=_list(FRAME_TRANSFORM, "transforms")),
    "foxglove.PoseInFrame": _thing(
        "PoseInFrame", "a pose at a time", timestamp=TIME, frame_id=_text("frame of reference"), pose=POSE
    ),
    "foxglove.SceneUpdate": _thing(
        "SceneUpdate", "what a 3D scene shows", deletions=_list(_DELETION, "to remove"), entities=_list(_ENTITY, "to show")
    ),
}


# ------------------------------------------------------------------------------------------------------------------ messages
def stamp(nanoseconds: int) -> Json:
    """A time in ns as {sec, nsec}."""
    return {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9}


def turned(yaw: float) -> Json:
    """Quaternion of a rotation by `yaw` [rad] about z."""
    return {"x": 0.0, "y": 0.0, "z": sin(yaw / 2), "w": cos(yaw / 2)}


def placed(x: float, y: float, yaw: float = 0.0) -> Json:
    """A `Pose` in the plane z = 0."""
    return {"position": _xyz(x, y), "orientation": turned(yaw)}


def frame(at: int, parent: str, child: str, x: float, y: float, yaw: float) -> Json:
    """One `FrameTransform`: pose of `child` in `parent`, m and rad, at `at` ns."""
    named = {"timestamp": stamp(at), "parent_frame_id": parent, "child_frame_id": child}
    return {**named, "translation": _xyz(x, y), "rotation": turned(yaw)}


def pose(at: int, x: float, y: float, yaw: float) -> Json:
    """One `PoseInFrame` in the tank."""
    return {"timestamp": stamp(at), "frame_id": TANK, "pose": placed(x, y, yaw)}


def links(at: int, solids: tuple[Solid, ...], angles) -> Json:
    """`FrameTransforms` from link to link: `angles` [rad] of the joints, one less than there are solids."""
    behind = [FISH, *(f"{FISH}/{s.name}" for s in solids[1:])]
    fronts = [0.0, *(s.front for s in solids[1:])]
    steps = zip(angles, behind, behind[1:], fronts, fronts[1:], strict=False)
    return {"transforms": [frame(at, a, b, x1 - x0, 0.0, float(j)) for j, a, b, x0, x1 in steps]}


def body(at: int, solids: tuple[Solid, ...]) -> Json:
    """`SceneUpdate` with the whole fish, sent once: every link is fixed to its own frame. Without solids, an arrow."""
    if not solids:
        arrow = {"shaft_length": 0.2, "shaft_diameter": 0.03, "head_length": 0.08, "head_diameter": 0.07}
        drawn = {"pose": placed(-0.14, 0.0), **arrow, "color": _rgba(RED)}
        return {"deletions": [], "entities": [_entity(at, FISH, FISH, arrows=[drawn])]}
    entities = []
    for i, s in enumerate(solids):
        paint = _rgba((*s.colour, 1.0))
        hull = {"pose": placed(0.0, 0.0), "points": [_xyz(*point) for point in s.points], "color": paint}
        hull |= {"colors": [], "indices": s.faces.ravel().tolist()}
        sizes = [{"x": chord, "y": span, "z": PLATE} for _, _, chord, span in s.plates]
        fins = [{"pose": placed(p[0], p[1]), "size": size, "color": paint} for p, size in zip(s.plates, sizes, strict=True)]
        entities.append(_entity(at, FISH if i == 0 else f"{FISH}/{s.name}", s.name, triangles=[hull], cubes=fins))
    return {"deletions": [], "entities": entities}


def target(at: int, x: float, y: float) -> Json:
    """`SceneUpdate` with the target: a sphere, and the ring within which it counts as reached."""
    ball = {"pose": placed(x, y), "size": {"x": 0.04, "y": 0.04, "z": 0.04}, "color": _rgba(WATER)}
    ring = {
        "type": 1,  # LINE_LOOP
        "pose": placed(x, y),
        "thickness": 0.008,
        "scale_invariant": False,
        "points": [_xyz(RING * cos(k * pi / 24), RING * sin(k * pi / 24)) for k in range(48)],
        "color": _rgba(WATER),
        "colors": [],
        "indices": [],
    }
    return {"deletions": [], "entities": [_entity(at, TANK, "target", spheres=[ball], lines=[ring], locked=False)]}


def _entity(at: int, where: str, name: str, locked: bool = True, **shapes: list[Json]) -> Json:
    about = {"timestamp": stamp(at), "frame_id": where, "id": name, "lifetime": {"sec": 0, "nsec": 0}, "frame_locked": locked}
    return {**about, "metadata": [], **{kind: shapes.get(kind, []) for kind in _SHAPES}}


def _xyz(x: float, y: float, z: float = 0.0) -> Json:
    return {"x": float(x), "y": float(y), "z": float(z)}


def _rgba(colour) -> Json:
    return dict(zip("rgba", map(float, colour), strict=True))
