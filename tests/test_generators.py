"""Generators with other forms of water: what any passive water must hold, whichever law it has, and how they swim."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.gap.laboratory import generators
from fishmj.gap.laboratory.generators.ellipsoid import hull, lamb
from fishmj.gap.laboratory.generators.family import drawn, family_named
from fishmj.gap.laboratory.generators.generator_trials import record, robot_of
from fishmj.gap.laboratory.generators.mujoco_robot import RobotSimulation
from fishmj.log import excitation
from fishmj.log.excitation import Excitation
from fishmj.mjcf.description import Link, Robot
from fishmj.mjcf.reading import load_robot

ROOM = Path(generators.__file__).parent
SHORT = Excitation(id="short", commands=excitation.get("gait").commands[:150], about="three seconds of a beat")


def chain(links: int) -> Robot:
    """A fish of equal mid-links and a thin tail."""
    body = [
        Link(name=f"b{i}", length=0.08, mass=0.12, sections=((0.0, 0.07, 0.04), (0.08, 0.06, 0.03))) for i in range(links - 2)
    ]
    head = Link(name="head", length=0.2, mass=0.6, sections=((0.0, 0.02, 0.01), (0.1, 0.09, 0.06), (0.2, 0.07, 0.04)))
    tail = Link(name="tail", length=0.15, mass=0.08, sections=((0.0, 0.05, 0.02), (0.06, 0.04, 0.005), (0.15, 0.11, 0.002)))
    return Robot(name=f"chain{links}", links=(head, *body, tail))


def loaded(name: str):
    """(family, law, its compiled forces) of the shipped fish."""
    from importlib import import_module

    family = family_named(name)
    water = family.build(load_robot(), {k: c.value for k, c in family.coefficients.items()})
    return family, water, import_module(f"fishmj.gap.laboratory.generators.{name}").forces


def states(rng, n: int) -> np.ndarray:
    """(n, N, 12) motions of four links; columns as `chain.MOTION` has them, only u, v, r matter."""
    motion = np.zeros((n, 4, 12))
    motion[:, :, :3] = rng.normal(size=(n, 4, 3)) * np.array([0.4, 0.4, 3.0])
    return motion


@pytest.mark.parametrize("name", generators.NAMES)
def test_the_water_never_feeds_energy(name):
    family, water, forces = loaded(name)
    rng = np.random.default_rng(1)
    out = np.zeros((4, 3))
    for motion in states(rng, 500):
        memory = rng.normal(size=2) * 0.5
        forces(water.law, motion, memory, 0.002, out)
        power = float(np.sum(out * motion[:, :3]))
        assert power <= 1e-12 and power < 0.0


@pytest.mark.parametrize("name", generators.NAMES)
def test_water_at_rest_pushes_nothing(name):
    family, water, forces = loaded(name)
    out = np.ones((4, 3))
    forces(water.law, np.zeros((4, 12)), np.zeros(2), 0.002, out)
    assert np.array_equal(out, np.zeros((4, 3)))


@pytest.mark.parametrize("name", generators.NAMES)
def test_forces_are_symmetric_under_a_mirror(name):
    family, water, forces = loaded(name)
    rng, out, other = np.random.default_rng(2), np.zeros((4, 3)), np.zeros((4, 3))
    turn = np.array([1.0, -1.0, -1.0])
    for motion in states(rng, 100):
        memory = rng.normal(size=2)
        mirrored = motion.copy()
        mirrored[:, :3] *= turn
        forces(water.law, motion, memory.copy(), 0.002, out)
        forces(water.law, mirrored, -memory, 0.002, other)
        np.testing.assert_allclose(other, out * turn, atol=1e-12)


def test_no_two_families_give_the_same_forces():
    motion = states(np.random.default_rng(3), 1)[0]
    outs = []
    for name in generators.NAMES:
        out = np.zeros((4, 3))
        _, water, forces = loaded(name)
        forces(water.law, motion, np.zeros(2), 0.002, out)
        outs.append(out)
    assert all(np.linalg.norm(a - b) > 0.1 * np.linalg.norm(a) for i, a in enumerate(outs) for b in outs[i + 1 :])


@pytest.mark.parametrize("name", generators.NAMES)
def test_added_mass_is_positive_and_of_the_water_displaced(name):
    _, water, _ = loaded(name)
    assert np.all([np.linalg.eigvalsh(a) >= -1e-12 for a in water.added])
    sideways = water.added[:, 1, 1].sum()
    assert 1.5 < sideways < 3.0  # kg; the fish weighs 1.1 kg, the strips carry 2.2


def test_lamb_ellipsoid_has_the_known_limits():
    assert sum(lamb(1.0, 1.0, 1.0)) == pytest.approx(4 / 3, rel=1e-6)  # a sphere: 2/3 each
    along, across, turning = hull(0.5, 0.5, 0.4999, 1000.0)
    assert along == pytest.approx(0.5 * 1000 * 4 / 3 * np.pi * 0.125, rel=1e-3)  # half the displaced mass
    assert turning < 1e-3 * along
    a0, g0 = lamb(5.0, 1.0, 1.0)  # prolate spheroid, Lamb 1932, art. 114, closed form
    e = np.sqrt(1 - 1 / 25)
    closed = 2 * (1 - e * e) / e**3 * (0.5 * np.log((1 + e) / (1 - e)) - e)
    assert a0 == pytest.approx(closed, rel=1e-6) and g0 == pytest.approx(1 - closed / 2, rel=1e-6)


def energy(run: RobotSimulation) -> float:
    """Kinetic energy of the fish and of the water that it carries, J."""
    m = np.zeros((run.model.nv, run.model.nv))
    for value, row, column in zip(run.data.M, run.chain.rows, run.chain.columns, strict=True):
        m[row, column] = m[column, row] = value
    v = run.data.qvel
    return float(v @ m @ v / 2)


def limp(name: str, *, ideal: bool, step: float = 0.001) -> np.ndarray:
    """Energy of a thrown fish without servos over half a second, a value a step."""
    fish = robot_of(name, {}, 0, nuisance=0.0)
    fish.kp, fish.kv, fish.kb = fish.kp * 0, fish.kv * 0, fish.kb * 0
    fish.friction, fish.armature = fish.friction * 0, fish.armature * 0 + 1e-9
    if ideal:
        dead = {"cross_round", "cross_flat", "swimming", "shed_body", "shed_edge"}
        fish.coefficients |= dict.fromkeys(dead & set(fish.coefficients), 0.0)
    run = RobotSimulation(fish, step)
    run.place((0.0, 0.0, 0.3), (0.3, 0.1, 1.0), np.array([0.3, -0.2, 0.4]))
    run.data.qvel[3:] = 2.0, -3.0, 4.0
    out = []
    for _ in range(round(0.5 / step)):
        run.forward()
        out.append(energy(run))
        mujoco.mj_Euler(run.model, run.data)
    return np.array(out)


def test_in_ideal_water_a_limp_fish_keeps_its_energy():
    """Added mass in the mass matrix and its velocity terms belong together: no other force is left in `morison`."""
    found = limp("morison", ideal=True)
    assert np.abs(found / found[0] - 1.0).max() < 0.02
    finer = limp("morison", ideal=True, step=0.0005)
    assert np.abs(finer / finer[0] - 1.0).max() < 0.6 * np.abs(found / found[0] - 1.0).max()


@pytest.mark.parametrize("name", generators.NAMES)
def test_a_limp_fish_only_loses_energy(name):
    found = limp(name, ideal=False)
    assert np.all(np.diff(found) < 1e-4 * found[0]) and found[-1] < 0.7 * found[0]


@pytest.mark.parametrize("name", generators.NAMES)
def test_halving_the_step_converges(name):
    fish = robot_of(name, {}, 1)
    ends = [record(fish, SHORT, 1, 0, 0.0, step) for step in (0.004, 0.002, 0.001)]
    q = [np.stack([end.at(np.arange(0.1, 2.9, 0.1), k) for k in range(3)], 1) for end in ends]
    rough, fine = (np.abs(a - b).max() for a, b in zip(q, q[1:], strict=False))
    assert fine < 0.7 * rough and fine < 0.01


@pytest.mark.parametrize("name", generators.NAMES)
def test_mirrored_commands_mirror_the_motion(name):
    fish = robot_of(name, {}, 1, nuisance=0.0)
    there, other = record(fish, SHORT, 1, 0, 0.0), record(fish, replace(SHORT, commands=-SHORT.commands), 1, 0, 0.0)
    sign = np.array([1, -1, -1, -1, -1, -1])
    np.testing.assert_allclose(other.q * sign, there.q, atol=1e-6)


@pytest.mark.parametrize("name", generators.NAMES)
def test_a_fish_left_alone_stays(name):
    still = Excitation(id="still", commands=np.zeros((50, 3)), about="nothing")
    found = record(robot_of(name, {}, 0, nuisance=0.0), still, 0, 0, 0.0)
    np.testing.assert_allclose(found.q, 0.0, atol=1e-9)


@pytest.mark.parametrize("name", generators.NAMES)
def test_a_current_is_a_boat_that_moves(name):
    """In a uniform stream the motion is that in still water, carried along."""
    fish, stream = robot_of(name, {}, 0, nuisance=0.0), robot_of(name, {}, 0, nuisance=0.0, flow=(0.2, 0.5))
    moving = Excitation(id="m", commands=SHORT.commands, about="in the stream", push=(0.2 * np.cos(0.5), 0.2 * np.sin(0.5), 0))
    there, other = record(fish, SHORT, 0, 0, 0.0), record(stream, moving, 0, 0, 0.0)
    drift = 0.2 * there.t[:, None] * np.array([np.cos(0.5), np.sin(0.5)])
    np.testing.assert_allclose(other.q[:, :2] - drift, there.q[:, :2], atol=1e-6)


@pytest.mark.parametrize("name", generators.NAMES)
@pytest.mark.parametrize("links", [2, 3, 5, 8])
def test_chains_of_any_length_beat_their_tails(name, links):
    trial = generators.generate(name, {}, [SHORT], 3, robot=chain(links))[0]
    pose, joint, cmd = (trial.table(t) for t in ("pose", "joint", "cmd"))
    numbers = [str(j + 1) for j in range(links - 1)]
    assert set(joint) == {"t", *(f"j{k}" for k in numbers)} and set(cmd) == {"t", "seq", *(f"c{k}" for k in numbers)}
    assert max(np.ptp(joint[f"j{k}"]) for k in numbers) > 0.3 and np.isfinite(pose["yaw"]).all()
    if links > 2:  # a tail on one hinge hardly swims in two of these waters
        assert np.hypot(pose["x"][-1] - pose["x"][0], pose["y"][-1] - pose["y"][0]) > 0.02


def test_the_experiments_fit_any_chain():
    given = excitation.get("gait").commands
    assert np.array_equal(excitation.get("gait", 3).commands, given)
    assert np.array_equal(excitation.get("gait", 1).commands, given[:, :1])
    more = excitation.get("hold_angles", 6).commands
    held = excitation.get("hold_angles").commands
    np.testing.assert_allclose(more.sum(1), held.sum(1))  # the same angle from head to tail


@pytest.mark.parametrize("name", generators.NAMES)
def test_one_seed_is_one_robot_and_another_is_another(name):
    family = family_named(name)
    a, b, c = (robot_of(name, {}, seed).coefficients for seed in (4, 4, 5))
    assert a == b and a != c
    for key, known in family.coefficients.items():
        assert abs(a[key] / known.value - 1.0) <= known.tolerance + 1e-12 and known.source
    assert drawn(family, 0.0, np.random.default_rng(0)) == {k: v.value for k, v in family.coefficients.items()}
    first, again = (generators.generate(name, {}, [SHORT], 4)[0] for _ in range(2))
    assert all(np.array_equal(first.tables[t][k], again.tables[t][k]) for t in first.tables for k in first.tables[t])


def test_generated_logs_are_marked_synthetic_and_hide_effects_and_truth():
    trial = generators.generate("foil", {"coulomb_friction": {"torque": 0.1}}, [SHORT], 2)[0]
    assert trial.meta["origin"] == "synthetic" and trial.meta["water"] == "generator foil"
    assert "coulomb" not in repr(trial.meta) and "truth" not in trial.tables and "seed" not in trial.meta


def test_what_does_not_exist_is_refused():
    with pytest.raises(UnknownName, match="generator"):
        generators.generate("bernoulli", {}, [SHORT], 0)
    with pytest.raises(UnknownName, match="crossflow_drag"):
        robot_of("foil", {"crossflow_drag": {"gain": 0.2}}, 0)
    with pytest.raises(ConfigError, match="9 links; expected 2 to 8"):
        robot_of("foil", {}, 0, robot=chain(9))
    with pytest.raises(ConfigError, match="nuisance"):
        robot_of("foil", {}, 0, nuisance=0.9)
