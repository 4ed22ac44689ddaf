"""Effects of a robot that no field of MuJoCo holds: against laws written out in robot_laws.py, and as a module. *Synthetic*."""

import importlib.util
from math import copysign, exp, pi, sin

import mujoco
import numpy as np
import pytest
from robot_arm import ARM
from robot_laws import GEARED, ROTOR, play, write_law_logs
from test_gap_robot import misfit, named, records_of, verdict_of
from test_gap_robot_search import search_among

from fishmj import effects
from fishmj.gap.commands.apply_robot import apply_robot
from fishmj.gap.models import joint_laws
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.models.robot_description import read_robot
from fishmj.gap.models.robot_sizes import sizes_of

pytest.importorskip("numba")
LIMIT = 0.5  # N m, of the elbow's motor
WEAK = ARM.replace('ctrlrange="-4 4"', f'ctrlrange="-{LIMIT} {LIMIT}"')
HIDDEN = {  # effect at its site -> (value, robot)
    "stribeck@elbow": (
        {"torque": 0.06, "speed": 0.4},
        {"law": lambda q, w, u: (0.0, 0.06 * exp(-((w / 0.4) ** 2)))},
    ),
    "load_friction@elbow": ({"ratio": 0.3}, {"law": lambda q, w, u: (0.0, 0.3 * abs(u))}),
    "speed_limit@elbow": (
        {"slowness": 0.3},
        {
            "text": WEAK,
            "law": lambda q, w, u: (
                min(max(LIMIT * (1 - 0.3 * max(copysign(w, u * w), 0)), 0) - abs(u), 0) * copysign(1, u),
                0.0,
            ),
        },
    ),
    "torque_ripple@elbow": (
        {"sine": 0.05, "cosine": 0.0, "period": 2 * pi / 12},
        {"law": lambda q, w, u: (0.05 * sin(12 * q), 0.0)},
    ),
    "gear_backlash@elbow": ({"half_gap": 0.06, "rotor": ROTOR}, {"text": play(0.06)}),
    "latency_jitter": ({"sigma": 0.02}, {"packets": 0.008, "late": 0.02}),
    "packet_loss": ({"probability": 0.75}, {"packets": 0.004, "lost": 0.75}),
}
RIVALS = {
    "stribeck@elbow": ("coulomb_friction", "load_friction", "viscous_friction"),
    "load_friction@elbow": ("coulomb_friction", "stribeck", "servo_gain"),
    "speed_limit@elbow": ("torque_saturation", "viscous_friction", "quadratic_friction"),
    "torque_ripple@elbow": ("torque_offset", "joint_stiffness", "coulomb_friction"),
    "gear_backlash@elbow": ("command_latency", "servo_gain", "coulomb_friction"),
    "latency_jitter": ("command_latency", "packet_loss", "command_hold"),
    "packet_loss": ("command_latency", "latency_jitter", "command_hold"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("laws")


def described(folder, name):
    kind, text = {"gear": ("geared", GEARED), "spee": ("weak", WEAK)}.get(name[:4], ("arm", ARM))
    path = folder / f"{kind}.xml"
    path.write_text(text)
    return read_robot(path)


def row_of(model, name: str, values: dict) -> np.ndarray:
    row = model.null
    for parameter, value in values.items():
        row[model.index(name, parameter)] = value
    return row


@pytest.mark.parametrize("name", HIDDEN)
def test_law_at_its_value_is_the_robot_with_the_law(name, folder):
    values, hidden = HIDDEN[name]
    robot = described(folder, name)
    logs = records_of(robot, write_law_logs(folder / name.replace("@", "_"), 2, 2.6, **hidden))
    model = RigidRobot(robot, sizes_of(robot, logs))
    without, with_it = misfit(model, logs, model.null), misfit(model, logs, row_of(model, name, values))
    random = name in ("latency_jitter", "packet_loss")  # the logs hold one draw, the model its mean
    assert np.all(with_it < ([0.02, 0.08] if random else [0.01, 0.03])), with_it
    assert np.all(with_it < without / (1.3 if random else 2.0)), (without, with_it)


# ------------------------------------------------------------------------------------------------------------------------- module
def module_of(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


PLACED = {name: values for name, (values, _) in HIDDEN.items() if "@" in name}
PLACED["stribeck@elbow"] = {"torque": 0.06, "speed": 2.0}  # the elbow is fast here


@pytest.mark.parametrize(
    "names", [*([name] for name in PLACED), list(PLACED)], ids=lambda names: names[0] if len(names) == 1 else "all"
)
def test_patch_and_its_module_move_like_the_search(names, folder, tmp_path):
    """robot.v2.xml with the module, stepped from Python, against the compiled laws in the rollouts of the search."""
    robot = described(folder, "gear")
    logs = records_of(robot, write_law_logs(folder / "short", 1, 1.0, text=GEARED))
    model = RigidRobot(robot, sizes_of(robot, logs))
    row = model.null
    for name in names:
        for parameter, value in PLACED[name].items():
            row[model.index(name, parameter)] = value
    verdict = verdict_of(robot, "NAMED", *(named(name, **PLACED[name]) for name in names))
    verdict["context"]["rest"] = dict(zip(robot.sites("joint"), model.rest, strict=True))
    told = apply_robot(tmp_path, verdict, None, False)
    module = module_of(tmp_path / "geared_v2_effects.py")
    assert mujoco.__version__ in module.__doc__ and "geared_v2_effects.py" in told["reason"]
    searched = model.model(row)
    d, searched_d = mujoco.MjData(mujoco.MjModel.from_xml_path(str(told["path"]))), mujoco.MjData(searched)
    written = d.model
    moved = []
    for one, data, install in ((searched, searched_d, None), (written, d, module.install)):
        data.qpos[:], data.qvel[:] = [0.4, -0.7], [1.0, 2.0]
        path = []
        with joint_laws.acting(install is None):
            if install:
                install()
            for k in range(150):
                data.ctrl[:] = 0.5 * np.sin(0.05 * k), 0.4 * np.cos(0.09 * k)
                mujoco.mj_step(one, data)
                path.append(data.qpos.copy())
            mujoco.set_mjcb_passive(None)
        moved.append(np.array(path))
    np.testing.assert_allclose(moved[1], moved[0], atol=2e-5)  # six digits of a number in XML
    without = mujoco.MjData(robot.model)
    without.qpos[:], without.qvel[:] = [0.4, -0.7], [1.0, 2.0]
    for k in range(150):
        without.ctrl[:] = 0.5 * np.sin(0.05 * k), 0.4 * np.cos(0.09 * k)
        mujoco.mj_step(robot.model, without)
    assert np.abs(without.qpos - moved[0][-1]).max() > 1e-3


def test_module_delivers_commands_as_the_search_does(folder, tmp_path):
    robot = described(folder, "arm")
    found = named("packet_loss", probability=0.5), named("command_quantisation@elbow", step=0.1)
    apply_robot(tmp_path, verdict_of(robot, "NAMED", *found), None, False)
    module = module_of(tmp_path / "arm_v2_effects.py")
    t, c = np.arange(4.0), np.array([0.0, 1.0, 0.5, 0.26])
    np.testing.assert_allclose(module.delivered(t, c, "shoulder")[1], [0.0, 0.5, 0.5, 0.38])
    assert np.all(np.isclose(np.mod(module.delivered(t, c, "elbow")[1] / 0.1 + 0.5, 1.0), 0.5))


def test_laws_are_off_outside_a_rollout(folder):
    with joint_laws.acting(True):
        assert mujoco.get_mjcb_passive() is not None
    assert mujoco.get_mjcb_passive() is None


# ------------------------------------------------------------------------------------------------------------------------- search
@pytest.mark.slow
@pytest.mark.parametrize("name", HIDDEN)
def test_search_names_the_hidden_law_or_its_class(name, folder):
    robot = described(folder, name)
    logs = write_law_logs(folder / f"searched_{name}", 4, 3.0, seed=3, **HIDDEN[name][1])
    v = search_among(robot, logs, effects.kind_of(name), *RIVALS[name]).verdict
    members = {e.name for e in (*v.effects, *v.tentative)} | {str(r["name"]) for r in v.rivals}
    if name in ("packet_loss", "gear_backlash@elbow"):
        # What is lost at random weighs as much as the mean change; when a gap closes hangs on all constants. Neither is misnamed.
        assert v.answer != "AGREES" and members & {name, *RIVALS[name]}, v.text()
        assert v.answer != "NAMED" or [e.name for e in v.effects] == [name], v.text()
        return
    assert v.answer in ("NAMED", "CLASS"), v.text()
    assert name in members, v.text()


@pytest.mark.slow
def test_healthy_arm_agrees_among_the_laws(folder):
    robot = described(folder, "arm")
    logs = write_law_logs(folder / "healthy", 3, 3.0, seed=5)
    v = search_among(robot, logs, *(effects.kind_of(name) for name in HIDDEN)).verdict
    assert v.answer == "AGREES", v.text()
