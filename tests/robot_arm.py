"""A two-link arm in MJCF and its logs, *synthetic*: MuJoCo with edited attributes is the robot that a search must explain."""

from pathlib import Path

import mujoco
import numpy as np

from fishmj.gap.records.robot_logs import guess_columns, log_files, read_robot_logs, read_sheet

ARM = """<mujoco model="arm">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" type="hinge" axis="0 1 0" damping="0.06"/>
      <inertial pos="0 0 -0.2" mass="0.6" diaginertia="0.004 0.004 0.0005"/>
      <body name="lower" pos="0 0 -0.3">
        <joint name="elbow" type="hinge" axis="0 1 0" damping="0.02"/>
        <inertial pos="0.02 0 -0.15" mass="0.4" diaginertia="0.003 0.003 0.0003"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="shoulder" joint="shoulder" ctrlrange="-6 6"/>
    <motor name="elbow" joint="elbow" ctrlrange="-4 4"/>
  </actuator>
</mujoco>
"""


def trials_of(robot, logs: Path) -> list:
    """Trials of the logs in a folder, whose columns are guessed by the robot's names."""
    files = log_files(logs)
    columns = guess_columns(list(read_sheet(files[0]).columns), robot.sites("joint"), robot.actuators, torques=True)
    return read_robot_logs(files, columns)[0]


def edited(**changes) -> str:
    """The arm with attributes replaced: `elbow_joint='frictionloss="0.1"'` adds to an element, a text=text pair replaces one."""
    text = ARM
    for place, more in changes.items():
        name, _, kind = place.rpartition("_")
        old = f'<{kind} name="{name}"'
        assert old in text
        text = text.replace(old, f"{old} {more}")
    return text


def swing(
    text: str, seconds: float, seed: int, *, noise=2e-4, late=0.0, hold=0.0, step=0.0, tilt=0.0, zero=0.0, scale=1.0, rate=1.0
):
    """(t, commands, readings) of one log: motors driven by sums of sines, encoders at 250 Hz.

    late, hold: s that commands are late, and held. step: N m of quantised commands. tilt: rad about y of gravity.
    zero, scale: of the encoders, rad and 1. rate: of the readings' clock.
    """
    m = mujoco.MjModel.from_xml_string(text)
    g = m.opt.gravity[2]
    m.opt.gravity[:] = -g * np.sin(tilt), 0.0, g * np.cos(tilt)
    d, rng = mujoco.MjData(m), np.random.default_rng(seed)
    dt, m.opt.timestep = 0.002, 0.0002  # ten steps a command: a step of MuJoCo acts half its length early
    steps = round(seconds / dt)
    t = dt * np.arange(steps)
    rates, phases = rng.uniform(0.3, 2.2, (2, 4)), rng.uniform(0, 6.28, (2, 4))
    size = np.array([0.8, 0.25])[:, None] * rng.dirichlet(np.ones(4), 2) * 1.6
    asked = np.sum(size[..., None] * np.sin(2 * np.pi * rates[..., None] * t + phases[..., None]), 1).T
    q = np.empty((steps, 2))
    for k in range(steps):
        q[k] = d.qpos
        sent = max(k - round(late / dt), 0)
        u = asked[sent - sent % round(hold / dt) if hold else sent]
        d.ctrl[:] = np.where(np.asarray(step) > 0, step * np.round(u / np.maximum(step, 1e-9)), u)
        mujoco.mj_step(m, d, 10)
    read = np.stack([np.interp(t / rate, t, column) for column in q.T], 1)
    return t, asked, (scale * read - np.asarray(zero) + noise * rng.standard_normal(q.shape))[::2]


def write_logs(folder: Path, text: str, logs: int = 4, seconds: float = 5.0, seed: int = 0, **hidden) -> Path:
    """A folder of logs as CSV: t, cmd_shoulder, cmd_elbow, pos_shoulder, pos_elbow."""
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(logs):
        t, asked, read = swing(text, seconds, 100 * seed + i, **hidden)
        lines = ["t,cmd_shoulder,cmd_elbow,pos_shoulder,pos_elbow"]
        for k in range(0, len(t), 2):
            lines.append(",".join(f"{x:.6f}" for x in (t[k], *asked[k], *read[k // 2])))
        (folder / f"swing{i}.csv").write_text("\n".join(lines) + "\n")
    return folder
