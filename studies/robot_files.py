"""The command of a study that writes descriptions of a robot from a folder of its authors' data."""

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path

from fishmj.base import console


def write_robot_files(doc: str | None, made: Callable[[Path], Iterable[tuple[str, str]]]) -> None:
    """Writes the files (name, text) that are made of the folder DATA into `--out`; `doc` is the help."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    for name, text in made(args.data):
        (args.out / name).parent.mkdir(parents=True, exist_ok=True)
        (args.out / name).write_text(text, encoding="utf-8")
        console.say(f"{args.out / name}")


def pendulum(joint: str, mass: float, length: float, own: float, friction: str = "", gear: float = 1.0) -> str:
    """MJCF of a motor with a point mass [kg] on an arm [m] that hangs along -z at rest.

    own: moment of inertia about the mass, kg m2. friction: attributes of the joint. gear: of the motor.
    """
    return f"""<mujoco model="pendulum">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <joint name="{joint}" type="hinge" axis="0 -1 0" {friction}/>
      <inertial pos="0 0 {-length}" mass="{mass}" diaginertia="{own} {own} {own / 2}"/>
    </body>
  </worldbody>
  <actuator><motor name="{joint}" joint="{joint}" gear="{gear:.6g}"/></actuator>
</mujoco>
"""
