"""Descriptions of a Unitree Go2 held in the air, from its authors' MJCF, without and with what they identified.

    fishmj gap fetch go2 --out DIR
    python -m studies.go2 DIR --out OUT
    fishmj calibrate model DIR/logs --model OUT/go2_bare.xml --only friction,damping,armature,delay --yes

DIR/go2.xml and DIR/logs/traj_0.pt are of github.com/iit-DLSLab/sim2real-robot-identification (BSD-3). The base is fixed, visual
meshes are left out, and each motor becomes the servo of the recording: kp 20 N m/rad, kd 1.5 N m s/rad. *_bare.xml has no
friction, damping and rotor inertia; *_key.xml has what the authors found with PACE, of hips and calves (docs of the data).
"""

from collections.abc import Iterator
from pathlib import Path

import mujoco

from studies.robot_files import write_robot_files

KP, KD = 20.0, 1.5  # of the recording's configuration
KEY = {"hip": (0.175, 0.19, 0.008), "calf": (0.725, 0.335, 0.043)}  # friction N m, damping N m s/rad, rotor inertia kg m2


def described(path: Path, key: bool) -> str:
    """MJCF in the air. key: with the authors' numbers."""
    spec = mujoco.MjSpec.from_string(without_meshes(path.read_text(encoding="utf-8")))
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            spec.delete(joint)
            continue
        found = KEY.get(joint.name.split("_")[1], (0.0, 0.0, 0.0)) if key else (0.0, 0.0, 0.0)
        joint.frictionloss, joint.damping, joint.armature = found[0], [found[1], 0.0, 0.0], found[2]
    for actuator in spec.actuators:
        force = actuator.ctrlrange.copy()
        actuator.set_to_position(kp=KP, kv=KD)
        actuator.ctrllimited, actuator.forcelimited, actuator.forcerange = 0, 1, force
    for keyframe in list(spec.keys):
        spec.delete(keyframe)
    spec.option.timestep = 0.002
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.compile()
    return spec.to_xml()


def without_meshes(text: str) -> str:
    """The text without lines of meshes."""
    return "\n".join(line for line in text.splitlines() if "mesh=" not in line and "<mesh " not in line)


def files(data: Path) -> Iterator[tuple[str, str]]:
    """Both descriptions."""
    for name, key in (("bare", False), ("key", True)):
        yield f"go2_{name}.xml", described(data / "go2.xml", key)


if __name__ == "__main__":
    write_robot_files(__doc__, files)
