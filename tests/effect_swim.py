"""A swim in NumPy with effects in it, many parameter rows at once; and what its sensors report."""

import numpy as np

from fishmj.effects import EffectStack
from fishmj.effects.sites import SensorReadings
from fishmj.effects.stack import delivered
from fishmj.mjcf.reading import load_robot
from fishmj.water.dynamics import planar_chain
from fishmj.water.dynamics.hooks import Effects

ROBOT = load_robot("fish")
CHAIN, SWIMMER = planar_chain.chain_of(ROBOT), planar_chain.nominal(ROBOT)
H, JOINTS = CHAIN.dt, CHAIN.n - 1
BUS = 5  # physics steps between commands


def gait(seconds: float, frequency: float, amplitude_deg: float, bias_deg: float = 0.0) -> np.ndarray:
    """(T, J) rad at the physics rate, a new command every bus tick."""
    t = (np.arange(round(seconds / H)) // BUS * BUS * H)[:, None]
    beat = np.sin(2 * np.pi * frequency * t - np.radians(60) * np.arange(JOINTS))
    return np.minimum(t / 0.5, 1.0) * np.radians(bias_deg + amplitude_deg * beat)


def swim(active: EffectStack, rows, sent, start=(0.0,) * 6, push=(0.0,) * 6, flow=(0.0, 0.0), wet=1.0, swimmer=SWIMMER, ch=CHAIN):
    """q (B, T, 6), v (B, T, 6) after each step and power (B, T) of parameter rows (B, P) under commands sent (T, J)."""
    rows = np.asarray(rows, float)
    b = len(rows)
    told = delivered(np, active, rows, sent, H)
    late = np.rint(np.asarray(active.delay(np, list(rows.T), "command")) / H).astype(int) * np.ones(b, int)
    q, v = ([np.full(b, float(x)) for x in values] for values in (start, push))
    attached, memory = np.full(b, 0.5), [np.full(b, m) for m in active.memory]
    water = [tuple(np.full(b, u) for u in flow)] * CHAIN.n
    out = []
    for k in range(len(sent)):
        target = told[np.arange(b), np.maximum(k - late, 0)].T
        hooks = Effects(np, active, list(rows.T), memory, wet)
        s = planar_chain.step(np, ch, swimmer, q, v, attached, list(target), water, (0.0, 0.0), hooks)
        q, v, attached, memory = s.q, s.v, s.attached, s.memory
        out.append(np.array([*q, *v, s.power]))
    out = np.array(out).transpose(2, 0, 1)
    return out[..., :6], out[..., 6:12], out[..., 12]


def sense(active: EffectStack, rows, q, power) -> SensorReadings:
    """What the sensors report of a swim, every physics step."""
    rows, t = np.asarray(rows, float), (1 + np.arange(q.shape[1])) * H
    late = lambda clock: np.asarray(active.delay(np, list(rows.T[:, :, None]), clock, t)) * np.ones((len(rows), len(t)))
    at = lambda values, delay: np.array([np.interp(t - d, t, x) for x, d in zip(values, delay, strict=True)])
    x, y, yaw = (at(q[..., i], late("pose")) for i in range(3))
    joint = np.stack([at(q[..., 3 + j], late("joint")) for j in range(JOINTS)], -1)
    return active.measure(np, list(rows.T[:, :, None]), SensorReadings(t, x, y, yaw, joint, at(power, late("power"))))
