"""A two-link arm whose elbow obeys laws that no field of MuJoCo holds, each written out here at a fine step, *synthetic*."""

from pathlib import Path

import mujoco
import numpy as np
from robot_arm import ARM

FINE = 0.0005  # s, a quarter of the description's step
ROTOR = 0.001  # kg m2
# The description of the arm with play: its rotor turns with the elbow. In the arm itself it is a body of its own.
GEARED = ARM.replace('<joint name="elbow" type="hinge"', f'<joint name="elbow" type="hinge" armature="{ROTOR}"')


def play(gap: float) -> str:
    """The arm with a rotor of its own at the elbow, and play of +-gap behind it."""
    turn = 'type="hinge" axis="0 1 0"'
    own = '<inertial pos="0 0 0" mass="1e-7" diaginertia="1e-8 1e-8 1e-8"/>'
    rotor = f'<joint name="elbow" {turn} damping="0.02" armature="{ROTOR}"/>{own}'
    free = f'<joint name="gap" {turn} limited="true" range="{-gap} {gap}" solreflimit="0.001 1"/>'
    text = ARM.replace("<option", '<compiler angle="radian"/><option')
    text = text.replace(f'<joint name="elbow" {turn} damping="0.02"/>', free)
    text = text.replace('<body name="lower" pos="0 0 -0.3">', f'<body name="rotor" pos="0 0 -0.3">{rotor}<body name="lower">')
    return text.replace("      </body>\n    </body>", "      </body></body>\n    </body>")


def swing_by_law(
    seconds: float, seed: int, law=None, *, text: str = ARM, packets: float = 0.0, late: float = 0.0, lost: float = 0.0
):
    """(t, commands, readings) every 4 ms.

    law(q, w, u) -> (torque at the elbow, limit of dry friction there). packets: s from one command to the next. late: s, mean of
    their exponential delays. lost: share of them that never arrives.
    """
    m = mujoco.MjModel.from_xml_string(text)
    m.opt.timestep = FINE
    d, rng = mujoco.MjData(m), np.random.default_rng(seed)
    steps, every = round(seconds / FINE), round(0.004 / FINE)
    t = FINE * np.arange(steps)
    rates, phases = rng.uniform(0.3, 2.2, (2, 4)), rng.uniform(0, 6.28, (2, 4))
    size = np.array([0.8, 0.25])[:, None] * rng.dirichlet(np.ones(4), 2) * 1.6
    asked = np.sum(size[..., None] * np.sin(2 * np.pi * rates[..., None] * t + phases[..., None]), 1).T
    if packets:
        each = round(packets / FINE)
        asked = asked[np.arange(steps) // each * each]
        sent = np.arange(0, steps, each)
        arrive = np.maximum.accumulate(t[sent] + late * rng.standard_exponential(len(sent)))
        arrive[rng.uniform(size=len(sent)) < lost] = np.inf
        given, order = np.empty_like(asked), sent[np.argsort(arrive, kind="stable")]
        last = np.searchsorted(np.sort(arrive), t, side="right") - 1
        given = np.where(last[:, None] >= 0, asked[order[np.maximum(last, 0)]], asked[0])
    else:
        given = asked
    read = np.empty((steps, 2))
    elbow = 1
    for k in range(steps):
        read[k] = d.qpos[0], d.qpos[1:].sum()
        d.ctrl[:] = given[k]
        if law is not None:
            torque, friction = law(d.qpos[elbow], d.qvel[elbow], given[k, 1])
            d.qfrc_applied[elbow], m.dof_frictionloss[elbow] = torque, max(friction, 1e-9)
        mujoco.mj_step(m, d)
    return t[::every], asked[::every], read[::every] + 2e-4 * rng.standard_normal(read[::every].shape)


def write_law_logs(folder: Path, logs: int = 3, seconds: float = 3.0, seed: int = 0, **hidden) -> Path:
    """A folder of logs as CSV: t, cmd_shoulder, cmd_elbow, pos_shoulder, pos_elbow. hidden: of `swing_by_law`."""
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(logs):
        rows = np.column_stack(swing_by_law(seconds, 100 * seed + i, **hidden))
        np.savetxt(
            folder / f"swing{i}.csv", rows, "%.6f", ",", header="t,cmd_shoulder,cmd_elbow,pos_shoulder,pos_elbow", comments=""
        )
    return folder
