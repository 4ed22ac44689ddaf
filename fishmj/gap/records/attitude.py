"""Pose of a free base: unit quaternions (w, x, y, z), and rotation vectors from one to another as MuJoCo's mju_subQuat.

    rotation_vector(q, ref)   (.., 3) rad in the frame of ref:  q = ref exp(v / 2)
    turned(ref, v)            the inverse
    quaternion_rate(q, w)     q' = q w / 2, w rad/s in the frame of q

A base has six coordinates: place in the world [m], and turn about its own axes, counted from the start of each segment [rad].
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from fishmj.base.errors import LogError

COORDINATES = ("base_x", "base_y", "base_z", "base_roll", "base_pitch", "base_yaw")
PLACE, QUATERNION = ("x", "y", "z"), ("qw", "qx", "qy", "qz")
UNIT = 0.02  # by which the length of a logged quaternion may differ from 1


def has_base(channels: Sequence[str]) -> bool:
    """Returns True if the channels of a robot begin with the coordinates of a free base."""
    return tuple(channels[:6]) == COORDINATES


def rotation_vector(q: np.ndarray, ref: np.ndarray) -> np.ndarray:
    """(.., 3) rotation from ref to q (.., 4) in the frame of ref, rad; NaN where one of them is not finite."""
    q, ref = np.broadcast_arrays(q, ref)
    flat, base = q.reshape(-1, 4), ref.reshape(-1, 4)
    known = np.isfinite(flat).all(1) & np.isfinite(base).all(1) & (np.abs(flat).max(1) > 0.0)
    out = np.full((len(flat), 3), np.nan)
    if known.any():
        one, other = (Rotation.from_quat(x[known], scalar_first=True) for x in (flat, base))
        out[known] = (other.inv() * one).as_rotvec()
    return out.reshape(*q.shape[:-1], 3)


def turned(ref: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """(.., 4) quaternion ref (.., 4) turned by a rotation vector (.., 3) of its own frame."""
    shape = np.broadcast_shapes(ref.shape[:-1], vector.shape[:-1])
    base = Rotation.from_quat(np.array(np.broadcast_to(ref, (*shape, 4))).reshape(-1, 4), scalar_first=True)
    more = Rotation.from_rotvec(np.array(np.broadcast_to(vector, (*shape, 3))).reshape(-1, 3))
    return (base * more).as_quat(scalar_first=True).reshape(*shape, 4)


def quaternion_rate(q: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """(.., 4) per second of quaternions (.., 4) that turn at rates (.., 3) of their own frame."""
    w, v = q[..., :1], q[..., 1:]
    return 0.5 * np.concatenate([-np.sum(v * rate, -1, keepdims=True), w * rate + np.cross(v, rate)], -1)


def unit_quaternions(q: np.ndarray, where: str) -> np.ndarray:
    """(T, 4) quaternions of a log, made of length 1. Raises LogError if they are not near it."""
    length = np.linalg.norm(q, axis=1)
    wrong = np.flatnonzero(~(np.abs(length - 1.0) < UNIT))
    if len(wrong):
        k = wrong[0]
        got = f"{', '.join(f'{x:.3g}' for x in q[k])} has length {length[k]:.3g}"
        raise LogError(f"{where}: row {k + 1} of the quaternion, {got}; expected 1: are these its four columns?")
    return q / length[:, None]
