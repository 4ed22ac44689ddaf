"""Descriptions of a measured double pendulum in MJCF, from its authors' parameters, with and without what they say it has.

    python -m studies.double_pendulum DIR --out OUT
    fishmj gap find DIR/design_A.0 --model OUT/A.0_2.0_bare.xml --columns OUT/tau_meas.toml --out REPORT

DIR holds design_*/model_*.yml and logs of github.com/dfki-ric-underactuated-lab/double_pendulum (BSD-3), commit 1e8544e.
*_full.xml has friction, damping and rotor inertia as stated, *_bare.xml none of them. Moments of inertia are about the joint
there: models whose links would have none about their own centre are left out. OUT/tau_meas.toml takes the measured torque for
the command, OUT/tau_con.toml the commanded one.
"""

from collections.abc import Iterator
from pathlib import Path

from fishmj.base import console
from studies.robot_files import write_robot_files

MISSING = ("Ir", "b1", "b2", "cf1", "cf2")  # rotor inertia, damping and Coulomb friction of shoulder and elbow


def parameters(path: Path) -> dict[str, float]:
    """Numbers of an authors' file of lines `name: number`, SI."""
    lines = (line.split(":") for line in path.read_text(encoding="utf-8").splitlines() if line.strip())
    return {name.strip(): float(value) for name, value in lines}


def mjcf(p: dict[str, float]) -> str:
    """MJCF of the pendulum, which hangs along -z at rest. Raises ValueError if a link would have no inertia of its own."""
    inertia = [p[f"I{i}"] - p[f"m{i}"] * p[f"r{i}"] ** 2 for i in (1, 2)]
    if min(inertia) <= 0:
        raise ValueError(f"moments of inertia about the links' centres: {inertia} kg m2")
    joint = lambda i: f'damping="{p[f"b{i}"]:g}" frictionloss="{p[f"cf{i}"]:g}" armature="{p["Ir"] * p["gr"] ** 2:g}"'
    link = lambda i, own: (
        f'<inertial pos="0 0 {-p[f"r{i}"]:g}" mass="{p[f"m{i}"]:g}" diaginertia="{own:g} {own:g} {own / 10:g}"/>'
    )
    motor = lambda name, i: f'<motor name="{name}" joint="{name}" ctrlrange="{-p[f"tl{i}"]:g} {p[f"tl{i}"]:g}"/>'
    return f"""<mujoco model="double_pendulum">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" type="hinge" axis="0 -1 0" {joint(1)}/>
      {link(1, inertia[0])}
      <body name="lower" pos="0 0 {-p["l1"]:g}">
        <joint name="elbow" type="hinge" axis="0 -1 0" {joint(2)}/>
        {link(2, inertia[1])}
      </body>
    </body>
  </worldbody>
  <actuator>{motor("shoulder", 1)}{motor("elbow", 2)}</actuator>
</mujoco>
"""


def files(data: Path) -> Iterator[tuple[str, str]]:
    """The descriptions and the maps of columns."""
    for path in sorted(data.glob("design_*/model_*.0.yml")):
        name, full = f"{path.parent.name[7:]}_{path.stem[6:]}", parameters(path)
        try:
            for kind, p in (("full", full), ("bare", full | dict.fromkeys(MISSING, 0.0))):
                yield f"{name}_{kind}.xml", mjcf(p)
        except ValueError as error:
            console.say(f"{name} left out: {error}")
    for torque in ("tau_meas", "tau_con"):
        joint, actuator = 'shoulder = "pos_meas1"\nelbow = "pos_meas2"', f'shoulder = "{torque}1"\nelbow = "{torque}2"'
        yield f"{torque}.toml", f'time = "time"\n[joint]\n{joint}\n[actuator]\n{actuator}\n'


if __name__ == "__main__":
    write_robot_files(__doc__, files)
