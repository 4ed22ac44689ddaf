"""Every way of putting the water into an engine takes the same step as the closed form."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace

import jax
import mujoco
import numpy as np
import pytest

from fishmj import engines, mjcf
from fishmj.base.errors import ConfigError, InjectionError, MissingExtra
from fishmj.engines import batch, mjx, planar
from fishmj.mjcf.model import reference_pose, reference_qpos
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import Flow, stack
from fishmj.water.hydro_model import HydroModel
from fishmj.water.injection import inject
from fishmj.water.link_wrench import LinkWrench
from fishmj.water.planar_water import PlanarWater
from fishmj.water.spatial_water import FreeWater


def gait(t, n):
    """Joint commands (n,) of a travelling wave, 1 Hz, 30 deg, 60 deg lag, rad."""
    return np.radians(30) * np.sin(2 * np.pi * t - np.radians(60) * np.arange(n))


def closed_form(robot, q, v, attached, seconds, flow, ambient):
    """The reference: rows of (q, v, attached) after every step of the gait."""
    ch, sw = planar_chain.chain_of(robot), planar_chain.nominal(robot)
    q, v, rows = list(q), list(v), []
    for i in range(round(seconds / ch.dt)):
        s = planar_chain.step(np, ch, sw, q, v, attached, gait(i * ch.dt, ch.n - 1), flow, ambient)
        q, v, attached = s.q, s.v, s.attached
        rows.append([*q, *v, attached])
    return np.array(rows)


@pytest.mark.parametrize("way", ["callback", "xfrc"])
@pytest.mark.parametrize("name", ["fish", "tendon_fish"])
def test_callback_and_wrenches_equal_closed_form(name, way):
    """2 s of swimming from a random state in a random flow: the same to 1e-11 after 500 steps."""
    robot = mjcf.load_robot(name)
    model = mjcf.build(robot)
    data = mujoco.MjData(model)
    water = PlanarWater(robot)
    n = water.chain.n
    rng = np.random.default_rng(3)
    data.qpos[:], data.qvel[:] = rng.normal(size=n + 2) * 0.3, rng.normal(size=n + 2) * 0.2
    flow, ambient = rng.normal(size=(n, 2)) * 0.2, rng.normal(size=2)
    reference = closed_form(robot, data.qpos, data.qvel, 0.5, 2.0, [tuple(r) for r in flow], tuple(ambient))
    water.set_flow(flow, ambient)
    rows = []
    with inject(model, water) if way == "callback" else nullcontext(LinkWrench(model, water)) as fish:
        for _ in range(len(reference)):
            data.ctrl[:] = gait(data.time, n - 1)
            fish.step(data)
            rows.append([*data.qpos, *data.qvel, water.attached])
    np.testing.assert_allclose(np.array(rows), reference, rtol=0, atol=1e-11)


def test_an_extra_forward_changes_nothing():
    """The callback is pure: forward passes between steps leave the next step as it was, to the last bit."""
    robot = mjcf.load_robot("fish")
    model, ends = mjcf.build(robot), []
    for extra in (0, 3):
        water, data = PlanarWater(robot), mujoco.MjData(model)
        with inject(model, water) as fish:
            for _ in range(50):
                data.ctrl[:] = gait(data.time, 3)
                for _ in range(extra):
                    mujoco.mj_forward(model, data)
                fish.step(data)
        ends.append([*data.qpos, *data.qvel, water.attached])
    assert ends[0] == ends[1]


def test_two_fish_in_two_waters_each_get_their_own():
    robot = mjcf.load_robot("fish")
    models = [mjcf.build(robot) for _ in range(3)]
    datas = [mujoco.MjData(m) for m in models]
    still, stream = PlanarWater(robot), PlanarWater(robot)
    stream.set_flow(np.full((4, 2), 0.3))
    alone = mujoco.MjData(models[1])
    with inject(models[1], other := PlanarWater(robot)) as fish:
        other.set_flow(np.full((4, 2), 0.3))
        for _ in range(100):
            fish.step(alone)
    with inject(models[0], still) as one, inject(models[1], stream) as two:
        for _ in range(100):
            one.step(datas[0])
            two.step(datas[1])
            mujoco.mj_step(models[2], datas[2])  # a bystander, in air
    assert not datas[0].qvel.any() and not datas[2].qvel.any()
    assert datas[1].qvel[0] > 0.01
    np.testing.assert_array_equal(datas[1].qpos, alone.qpos)
    assert mujoco.get_mjcb_passive() is None


def test_the_callback_slot_is_guarded():
    robot = mjcf.load_robot("fish")
    model, free = mjcf.build(robot), mjcf.build(robot, "free")
    with pytest.raises(ConfigError, match="same root"), inject(free, PlanarWater(robot)):
        pass
    with inject(model, PlanarWater(robot)), pytest.raises(InjectionError, match="has a water already"):
        with inject(model, PlanarWater(robot)):
            pass
    mujoco.set_mjcb_passive(lambda m, d: None)
    try:
        with pytest.raises(InjectionError, match="taken by someone else"), inject(model, PlanarWater(robot)):
            pass
    finally:
        mujoco.set_mjcb_passive(None)
    assert mujoco.get_mjcb_passive() is None


def test_a_thread_that_builds_models_and_one_that_swims_do_not_meet():
    """MuJoCo compiles nothing while a callback is installed: whoever comes second waits, and nobody starves."""
    robot = mjcf.load_robot("fish")
    model, another, sizes = mjcf.build(robot), mjcf.build(robot), []

    def build_some():
        for _ in range(5):
            sizes.append(mjcf.build(robot, "free").nv)
            mjcf.mjcf_xml(robot)

    with ThreadPoolExecutor(1) as pool:
        working, data, water = pool.submit(build_some), mujoco.MjData(model), PlanarWater(robot)
        ticks = 0
        while not working.done() or ticks < 50:
            with inject(model, water) as fish:
                for _ in range(3):
                    fish.step(data)
            ticks += 1
        working.result()
        with inject(model, water), pytest.raises(InjectionError, match="build the model before"):
            mjcf.build(robot)  # one's own block is not waited for
        with inject(model, water), pytest.raises(InjectionError, match="another thread"):
            pool.submit(inject(another, PlanarWater(robot)).__enter__).result()
    assert sizes == [9] * 5 and ticks < 2000


def randomised(robot, count):
    """A batch of unequal fish in unequal turbulent flows with busy commands: arguments of `advance`."""
    rng = np.random.default_rng(8)
    scale = lambda a, r: a * rng.uniform(1 - r, 1 + r, a.shape)
    p = engines.nominal_params(robot, count)
    p = p._replace(mass=scale(p.mass, 0.1), kp=scale(p.kp, 0.1), kv=scale(p.kv, 0.05), kb=scale(p.kb, 0.05))
    p = p._replace(water=scale(p.water, 0.2))
    p = p._replace(zero=rng.uniform(-0.09, 0.09, p.zero.shape), delay=rng.integers(5, 31, count).astype(np.int32))
    pose = rng.uniform(-1.5, 1.5, (count, 3))
    commands = np.clip(np.cumsum(rng.uniform(-0.4, 0.4, (count, 20, robot.n_joints)), 1), -1.2, 1.2)
    flow = stack([Flow(speed=0.3, direction=i % 6.28, turbulence="default", intensity=0.2, seed=i) for i in range(count)])
    return engines.at_rest(robot, pose), commands, p, flow, np.arange(count, dtype=np.int32)


def reference(robot, case):
    with jax.enable_x64(True):
        return jax.tree.map(np.asarray, planar.PlanarEngine(robot).advance(*case))


def assert_same(result, expected, atol):
    names = (*result[0]._fields, *result[1]._fields)
    for name, mine, other in zip(names, jax.tree.leaves(result), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(np.asarray(mine), other, rtol=0, atol=atol, err_msg=name)


@pytest.fixture(scope="module")
def swim():
    """(robot, arguments, what the closed form makes of them)."""
    robot = mjcf.load_robot("fish")
    case = randomised(robot, 5)
    return robot, case, reference(robot, case)


@pytest.mark.parametrize("evaluator", ["compiled", "jax"])
def test_batched_c_equals_closed_form(swim, evaluator):
    """Two control steps of unequal fish: the same to 1e-11 in pose, joints, rates, power and memory."""
    robot, case, expected = swim
    try:
        engine = batch.BatchEngine(robot, threads=2, evaluator=evaluator)
    except MissingExtra as missing:
        pytest.skip(str(missing))
    assert_same(engine.advance(*case), expected, 1e-11)
    assert_same(engine.advance(*case), expected, 1e-11)  # the persistent batch carries nothing over


def test_batched_c_takes_any_number_of_links():
    robot = mjcf.load_robot("tendon_fish")
    case = randomised(robot, 3)
    assert_same(batch.BatchEngine(robot, evaluator="jax").advance(*case), reference(robot, case), 1e-11)


def test_batched_c_shares_fish_between_threads_alike():
    """Unequal fish on one thread and on three: the same to 1e-12 (JAX vectorises blocks of other sizes differently)."""
    robot = mjcf.load_robot("fish")
    case = randomised(robot, 50)
    one, three = (batch.BatchEngine(robot, threads=n, evaluator="jax").advance(*case) for n in (1, 3))
    assert_same(one, three, 1e-12)
    assert len(set(one[0].q[:, 0])) == 50


def test_batch_follows_new_parameters(swim):
    """The same engine, then other fish: masses and gains of the first call are gone."""
    robot, case, expected = swim
    engine = batch.BatchEngine(robot, evaluator="jax")
    engine.advance(case[0], case[1], engines.nominal_params(robot, 5), *case[3:])
    assert_same(engine.advance(*case), expected, 1e-11)


def test_mjx_equals_closed_form_in_double(swim):
    robot, case, expected = swim
    with jax.enable_x64(True):
        result = jax.tree.map(np.asarray, mjx.MjxEngine(robot).advance(*case))
    assert_same(result, expected, 1e-11)


def test_mjx_equals_closed_form_in_single(swim):
    """float32 rounding over 100 physics steps: 2e-4 in the fastest quantity (rates up to 10 rad/s)."""
    robot, case, expected = swim
    single = jax.tree.map(lambda a: np.asarray(a, np.float32) if np.asarray(a).dtype == float else a, case)
    assert_same(mjx.MjxEngine(robot).advance(*single), expected, 2e-4)


WING = {"edge_place": 0.6, "tail_held": 0.7, "linear_drag": 0.4}


@pytest.mark.parametrize(("learnt", "shape"), [(None, {}), ("swift", {}), (None, WING)])
def test_free_water_is_the_planar_water_in_the_plane(learnt, shape):
    """Same pose and velocities, nothing vertical: M_a and forces agree to 1e-12, and only buoyancy pushes out of the plane."""
    robot = mjcf.load_robot("fish")
    robot = replace(robot, water=robot.water | shape)
    models = mjcf.build(robot), mjcf.build(robot, "free")
    flat, free = (mujoco.MjData(m) for m in models)
    residual = learnt and HydroModel.load(learnt).learnt
    waters = PlanarWater(robot, learnt=residual), FreeWater(robot, learnt=residual)
    rng = np.random.default_rng(0)
    for water in waters:
        water.memory = [0.3] * len(water.memory)
    inplane = [0, 1, 5, 6, 7, 8]
    for _ in range(20):
        q, v = rng.normal(size=6), rng.normal(size=6)
        flow, ambient = rng.normal(size=(4, 2)), rng.normal(size=2)
        if learnt:  # slow and nearly straight ahead, within the residual's range
            q[3:], v, flow = 0.2 * q[3:], 0.05 * v + [0.3 * np.cos(q[2]), 0.3 * np.sin(q[2]), 0, 0, 0, 0], 0.01 * flow
        flat.qpos[:], flat.qvel[:] = q, v
        free.qpos[:], free.qvel[:] = reference_qpos(models[1], q[:3], q[3:]), [v[0], v[1], 0, 0, 0, *v[2:]]
        results = []
        for model, data, water in zip(models, (flat, free), waters, strict=True):
            mujoco.mj_forward(model, data)
            water.set_flow(flow, ambient)
            results.append(water.forces(model, data))
        (added, force), (added3, force3) = results
        assert np.any(waters[0].instant(models[0], flat).residual) == bool(learnt)
        np.testing.assert_allclose(added3[np.ix_(inplane, inplane)], added, rtol=0, atol=1e-12)
        np.testing.assert_allclose(force3[inplane], force, rtol=0, atol=1e-11)
        assert force3[2] == pytest.approx(robot.mass * 9.81)


@pytest.mark.parametrize("name", ["fish", "tendon_fish"])
def test_free_fish_swims_as_the_planar_one_and_stays_upright(name):
    """4 s of 1 Hz, 30 deg, 60 deg lag: path and heading within 1 %, roll and pitch under 5 deg, depth within 2 cm."""
    robot, ends, tilt, depth = mjcf.load_robot(name), [], 0.0, 0.0
    for root, kind in (("planar", PlanarWater), ("free", FreeWater)):
        model, water = mjcf.build(robot, root), kind(robot)
        data = mujoco.MjData(model)
        data.qpos[:] = reference_qpos(model, np.zeros(3), np.zeros(robot.n_joints))
        with inject(model, water) as fish:
            for _ in range(1000):
                data.ctrl[:] = gait(data.time, robot.n_joints)
                fish.step(data)
                tilt = max(tilt, np.degrees(np.arccos(min(data.xmat[1, 8], 1.0))))
                depth = max(depth, abs(data.xpos[1, 2]))
        ends.append(reference_pose(model, data))
    assert np.linalg.norm(ends[0][:2]) > 0.4
    np.testing.assert_allclose(ends[1][:3], ends[0][:3], atol=0.01 * np.linalg.norm(ends[0][:2]))
    assert tilt < 5 and depth < 0.02


@pytest.mark.parametrize("axis", [0, 1])
def test_free_fish_rights_itself(axis):
    """Rolled or pitched by 20 deg and let go, straight and still: after 6 s it sways by less than 5 deg."""
    robot = mjcf.load_robot("fish")
    model, water = mjcf.build(robot, "free"), FreeWater(robot)
    data = mujoco.MjData(model)
    data.qpos[3:7] = [np.cos(np.radians(10)), *(np.sin(np.radians(10)) * np.eye(3)[axis])]
    late = []
    with inject(model, water) as fish:
        for i in range(1750):
            fish.step(data)
            late += [data.xmat[1, 8]] * (i >= 1500)
    assert np.degrees(np.arccos(min(late))) < 5


@pytest.mark.slow
def test_free_fish_conserves_energy_without_drag_to_first_order():
    """Kirchhoff's terms in three dimensions do no work: the energy error of 0.5 s falls with the step."""
    robot, errors = mjcf.load_robot("fish"), []
    idle = planar_chain.nominal(robot)
    water_of = idle.water._replace(cn=[0.0] * 4, cf=0.0, ca_forward=0.0, ca_backward=0.0, ke=0.0)
    for dt in (0.002, 0.001, 0.0005):
        model, water = mjcf.build(robot, "free"), FreeWater(robot, idle._replace(water=water_of))
        water.plates = []
        model.opt.timestep, model.dof_damping[:], model.actuator_gainprm[:], model.actuator_biasprm[:] = dt, 0, 0, 0
        data, rng = mujoco.MjData(model), np.random.default_rng(1)
        data.qpos[:] = reference_qpos(model, np.zeros(3), rng.normal(size=3) * 0.5)
        data.qvel[:] = rng.normal(size=9) * [0.2, 0.2, 0.2, 1, 1, 1, 1, 1, 1]
        energy = []
        with inject(model, water) as fish:
            for _ in range(round(0.5 / dt)):
                mujoco.mj_forward(model, data)
                energy.append(total_energy(model, data, water))
                fish.step(data)
        errors.append(abs(energy[-1] - energy[0]) / kinetic(model, data))
    assert errors[2] < errors[1] < errors[0]
    assert errors[0] / errors[2] == pytest.approx(4, rel=0.25)


def kinetic(model, data):
    dense = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, dense)
    return data.qvel @ dense @ data.qvel / 2


def total_energy(model, data, water):
    """Kinetic energy with the water's, weight and buoyancy, J."""
    lift = 0.0
    for i in range(water.chain.n):
        centre = data.xpos[i + 1] + data.xmat[i + 1].reshape(3, 3)[:, 0] * water.geometry.com[i, 0]
        lift += water.geometry.mass[i] * 9.81 * (data.xipos[i + 1, 2] - centre[2])
    return kinetic(model, data) + lift
