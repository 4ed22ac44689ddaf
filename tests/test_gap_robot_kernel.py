"""Compiled rollouts of a robot beside those of MuJoCo, which they stand for. *Synthetic*."""

import numpy as np
import pytest

from fishmj.gap.models import joint_laws, robot_kernel
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.models.robot_description import read_robot
from fishmj.gap.models.robot_sizes import RobotSizes

pytest.importorskip("numba")
STEPS, ROLLOUTS = 120, 20


def drawn(rng, joints: int, *, integrator="implicitfast", servo=False, slide=False, medium="", poly=True, ranged=False) -> str:
    """A tree with skew axes, springs, polynomial damping, dry friction and a welded body; a branch from four joints on."""
    few = lambda size, count=3: " ".join(f"{x:.4f}" for x in rng.uniform(-size, size, count))
    turned = lambda: "quat='" + " ".join(f"{x:.6f}" for x in rng.standard_normal(4)) + "'"
    text, close = "", ""
    for k in range(joints):
        kind = "slide" if slide and k == 1 else "hinge"
        damping = " ".join(f"{x:.4f}" for x in rng.uniform(0, (0.1, 0.05 * poly, 0.02 * poly)))
        limit = "range='-52 52' limited='true'" if ranged else ""
        text += f"<body pos='{few(0.3)}' {turned()}><joint name='j{k}' type='{kind}' axis='{few(1.0)}' pos='{few(0.05)}' {limit}"
        text += f" damping='{damping}' armature='0.01' frictionloss='{0.1 * (k % 2):g}'"
        text += " stiffness='0.3' springref='0.3' ref='0.1'/>"
        text += f"<inertial pos='{few(0.2)}' {turned()} mass='0.6' diaginertia='.004 .005 .003'/>"
        text += f"<body {turned()}><inertial pos='{few(0.1)}' mass='.2' diaginertia='.001 .002 .0015'/></body>" if k == 0 else ""
        branch = "</body>" if k == 1 and joints > 3 else ""
        text, close = text + branch, close + ("" if branch else "</body>")
    position = "<position name='j{0}' joint='j{0}' kp='8' kv='0.3' forcerange='-2 2' gear='1.3'/>"
    motor = "<motor name='j{0}' joint='j{0}' ctrlrange='-1.5 1.5' gear='0.8'/>"
    drives = "".join((position if servo else motor).format(k) for k in range(joints))
    option = f"<option timestep='0.002' integrator='{integrator}' {medium}/>"
    return f"<mujoco>{option}<worldbody>{text}{close}</worldbody><actuator>{drives}</actuator></mujoco>"


MEDIUM = "density='1.2' viscosity='0.01' wind='1 -2 0.5'"
ROBOTS = {
    "pendulum": dict(joints=1),
    "servos": dict(joints=3, servo=True),
    "slide": dict(joints=3, slide=True),
    "branch_in_wind": dict(joints=5, servo=True, slide=True, medium=MEDIUM),
    "euler": dict(joints=2, integrator="Euler", poly=False),
    "euler_in_wind": dict(joints=2, integrator="Euler", poly=False, servo=True, medium=MEDIUM),
}


@pytest.fixture
def robot_of(tmp_path):
    def read(text: str) -> RigidRobot:
        path = tmp_path / "robot.xml"
        path.write_text(text)
        robot = read_robot(path)
        ones = np.ones(len(robot.joints))
        return RigidRobot(robot, RobotSizes(ones, ones, *[np.ones(len(robot.actuators))] * 2))

    return read


def rollouts(model: RigidRobot, rng, models: list, lawful: bool = False, pushed: bool = True):
    """(states by the kernel or what stands in for it, states by MuJoCo) of the same begins, commands and pushes."""
    joints = model.joints
    begins = rng.uniform(-1, 1, (ROLLOUTS, 1 + 2 * joints)) * np.repeat([0.0, 0.8, 3.0], [1, joints, joints])
    u = rng.uniform(-2, 2, (ROLLOUTS, STEPS // 20, joints)).repeat(20, 1)
    force = rng.uniform(-0.2, 0.2, (ROLLOUTS, STEPS, joints)) if pushed else None
    each = [models[r * len(models) // ROLLOUTS] for r in range(ROLLOUTS)]
    return model._rolled(models, begins, u, force, lawful), model._stepped(each, begins, u, force, lawful)


@pytest.mark.parametrize("name", ROBOTS)
def test_kernel_takes_the_steps_of_mujoco(name, robot_of):
    rng = np.random.default_rng(5)
    model = robot_of(drawn(rng, **ROBOTS[name]))
    other = model.nothing
    other[: len(model.constants)] *= np.exp(0.1 * rng.standard_normal(len(model.constants)))
    models = [model.model(model.nothing), model.model(other)]
    assert model._kernel is not None
    ours, theirs = rollouts(model, rng, models, pushed=name != "slide")
    assert np.abs(theirs[:, -1, 1:] - theirs[:, 0, 1:]).max() > 0.3
    np.testing.assert_allclose(ours, theirs, atol=1e-10)


@pytest.mark.parametrize("law", list(joint_laws.laws()))
def test_kernel_has_the_laws_of_the_joints(law, robot_of):
    rng = np.random.default_rng(6)
    model = robot_of(drawn(rng, joints=2, servo=law != "speed_limit"))
    row = model.nothing
    for effect in (x for x in model.active.effects if x.name.startswith(law)):
        for p in effect.parameters:
            row[model.index(effect.name, p.name)] = p.typical[1] if not p.shape else p.typical[0]
    ours, theirs = rollouts(model, rng, [model.model(row)], lawful=True)
    off = np.abs(ours - theirs).reshape(ROLLOUTS, -1).max(1)
    # a gap that closes within rounding of a step's end closes a step later in the other: a few rollouts may part
    assert np.median(off) < 1e-9
    assert np.mean(off < 1e-6) >= (0.8 if law == "gear_backlash" else 1.0)


def test_rollouts_at_the_end_of_a_range_are_mujocos(robot_of):
    rng = np.random.default_rng(7)
    model = robot_of(drawn(rng, joints=2, ranged=True))
    begins = np.array([[0.0, 0.85, 0.0, 9.0, 0.0], [0.0, 0.1, 0.0, 0.0, 0.0]] * 2)
    _, known = model._kernel([model._plain], np.zeros(4, int), begins, np.zeros((4, 30, 2)))
    assert known.tolist() == [False, True, False, True]
    ours, theirs = rollouts(model, rng, [model._plain])
    np.testing.assert_allclose(ours, theirs, atol=1e-10)


def test_a_rollout_that_diverges_writes_nothing(robot_of, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    model = robot_of(drawn(np.random.default_rng(7), joints=2))
    begins = np.array([[0.0, 0.0, 0.0, 1e12, -1e12]])
    model._rolled([model._plain], begins, np.zeros((1, 30, 2)), None, False)
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists() and capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("integrator='implicitfast'", "integrator='RK4'"),
        lambda text: text.replace("<joint ", "<joint actuatorgravcomp='true' ", 1),
        lambda text: text.replace("<inertial", "<geom size='0.1' mass='0' fluidshape='ellipsoid'/><inertial", 1),
        lambda text: text.replace("<option ", "<option noslip_iterations='3' "),
    ],
)
def test_robots_beyond_the_kernel_stay_mujocos(change, robot_of):
    text = drawn(np.random.default_rng(8), joints=2)
    assert robot_kernel.can_roll(robot_of(text)._plain)
    model = robot_of(change(text))
    assert not robot_kernel.can_roll(model._plain) and model._kernel is None
    ours, theirs = rollouts(model, np.random.default_rng(9), [model._plain])
    np.testing.assert_array_equal(ours, theirs)


def test_rollouts_do_not_hang_on_those_before_them(robot_of):
    rng = np.random.default_rng(10)
    model = robot_of(drawn(rng, joints=1))
    model._kernel = None
    row = model.nothing
    for name, value in (("half_gap", 0.05), ("rotor", 0.01)):
        row[model.index("gear_backlash@j0", name)] = value
    begins, u = np.array([[0, 0.1, 1.0]] * 6), rng.uniform(-1, 1, (6, 40, 1))
    whole = model._rolled([model.model(row)], begins, u, None, True)
    for r in range(6):
        np.testing.assert_array_equal(model._rolled([model.model(row)], begins[r : r + 1], u[r : r + 1], None, True)[0], whole[r])
