"""The learnt residual inside MuJoCo, by the callback and as wrenches on the links, on both roots."""

import threading
from contextlib import contextmanager

import mujoco
import numpy as np
import pytest

from fishmj import engines, mjcf
from fishmj.base.errors import ConfigError, SimDiverged, UnknownName
from fishmj.mjcf.model import reference_qpos
from fishmj.sim import Sim
from fishmj.water.flow import Flow
from fishmj.water.hydro_model import HydroModel
from fishmj.water.injection import inject
from fishmj.water.link_wrench import LinkWrench
from fishmj.water.planar_water import PlanarWater
from fishmj.water.spatial_water import FreeWater

ROBOT, MODEL = mjcf.load_robot("fish"), HydroModel.load("swift")
FITTED = engines.in_water(ROBOT, "swift")
FLOW = Flow(speed=0.2, direction=2.0, turbulence="default", intensity=0.15, seed=4)
ROOTS = pytest.mark.parametrize("root", ["planar", "free"])
WAYS = pytest.mark.parametrize("way", ["callback", "xfrc"])


def gait(t):
    return np.radians(35) * np.sin(7.5 * t - np.arange(3))


def water_of(root, learnt=MODEL.learnt, kind=None):
    kind = kind or {"planar": PlanarWater, "free": FreeWater}[root]
    water = kind(ROBOT, MODEL.swimmer(ROBOT), learnt=learnt)
    water.set_flow(np.array([[0.1, -0.05], [0.12, 0.0], [0.08, 0.02], [0.1, 0.1]]), (0.2, -0.1))
    return water


def fish_of(root):
    """A bent, moving fish."""
    model = mjcf.build(ROBOT, root)
    data, rng = mujoco.MjData(model), np.random.default_rng(6)
    data.qpos[:] = reference_qpos(model, [0.3, -0.2, 0.7], [0.2, -0.3, 0.4])
    data.qvel[:] = rng.normal(size=model.nv) * (
        [0.3, 0.1, 1, 2, 2, 2] if root == "planar" else [0.3, 0.1, 0.05, 0.3, 0.3, 1, 2, 2, 2]
    )
    return model, data


@contextmanager
def injected(way, model, water):
    """What has `step(data)`."""
    if way == "xfrc":
        yield LinkWrench(model, water)
    else:
        with inject(model, water) as handle:
            yield handle


def ends(data, water):
    return [data.time, *data.qpos, *data.qvel, water.attached, *water.memory]


def swim(way, root, steps=40, between=lambda model, data, fish: None):
    """The state and what the water remembers after some steps, with something done before each of them."""
    (model, data), water = fish_of(root), water_of(root)
    with injected(way, model, water) as fish:
        for _ in range(steps):
            data.ctrl[:] = gait(data.time)
            between(model, data, fish)
            fish.step(data)
    return ends(data, water)


@ROOTS
def test_wrenches_and_callback_take_the_same_steps(root):
    """2 s, to 1e-9 after 500 steps in pose, rates, attachment and wake."""
    callback, xfrc = (swim(way, root, 500) for way in ("callback", "xfrc"))
    np.testing.assert_allclose(xfrc, callback, rtol=0, atol=1e-9)
    assert np.abs(callback[-18:-2]).max() > 0.1 and np.abs(callback[1:4]).max() > 0.3


def spoil(model, data, fish):
    """Fields that MuJoCo keeps from the step before hold nonsense."""
    for name in ("qfrc_passive", "qfrc_actuator", "qfrc_bias", "qfrc_smooth", "qacc", "qacc_smooth", "actuator_force"):
        getattr(data, name)[:] = np.nan


def look_twice(model, data, fish):
    for _ in range(3):
        mujoco.mj_forward(model, data)
    mujoco.mj_step1(model, data)


def apply_twice(model, data, fish):
    if isinstance(fish, LinkWrench):
        for _ in range(3):
            fish.apply(data)


@ROOTS
@WAYS
@pytest.mark.parametrize("between", [spoil, look_twice, apply_twice])
def test_stale_fields_and_extra_passes_change_nothing(root, way, between):
    """To the last bit, of the state and of what the water remembers."""
    assert swim(way, root, between=between) == swim(way, root)


class Broken:
    """A mistake in the water, half-way."""

    def forces(self, model, data):
        if data.time > 0.05:
            raise ZeroDivisionError("my own mistake")
        return super().forces(model, data)


@ROOTS
@WAYS
def test_a_water_that_fails_leaves_state_and_memory_as_they_were(root, way):
    kind = type("BrokenWater", (Broken, {"planar": PlanarWater, "free": FreeWater}[root]), {})
    (model, data), water = fish_of(root), water_of(root, kind=kind)
    with pytest.raises(ZeroDivisionError, match="^my own mistake$"), injected(way, model, water) as fish:
        for _ in range(100):
            before = ends(data, water)
            data.ctrl[:] = gait(data.time)
            fish.step(data)
    assert ends(data, water) == before and np.abs(before[-18:]).max() > 0.0
    assert mujoco.get_mjcb_passive() is None


@ROOTS
@WAYS
def test_a_residual_that_is_not_a_number_is_named_and_nothing_moves(root, way):
    bad = MODEL.learnt.net._replace(outer_bias=np.full_like(MODEL.learnt.net.outer_bias, np.nan))
    (model, data), water = fish_of(root), water_of(root, MODEL.learnt._replace(net=bad))
    before = ends(data, water)
    with pytest.raises(SimDiverged, match="term 'learnt residual' on link 'head'") as caught, injected(way, model, water) as fish:
        fish.step(data)
    assert (caught.value.term, caught.value.link) == ("learnt residual", "head") and ends(data, water) == before


@ROOTS
@WAYS
def test_two_fish_side_by_side_each_remember_their_own(root, way):
    alone = swim(way, root)
    (one, first), (two, second), waters = fish_of(root), fish_of(root), (water_of(root), water_of(root, None))
    with injected(way, one, waters[0]) as fish, injected(way, two, waters[1]) as other:
        for _ in range(40):
            for step, data in ((fish, first), (other, second)):
                data.ctrl[:] = gait(data.time)
                step.step(data)
    assert ends(first, waters[0]) == alone
    assert waters[1].memory == [] and np.abs(first.qpos - second.qpos).max() > 1e-3


def test_wrenches_serve_any_number_of_threads():
    made = lambda: [Sim(FITTED, flow=FLOW, root=root, injection="xfrc") for root in ("planar", "free")]
    apart, together = made(), made()
    work = [threading.Thread(target=sim.run, args=(gait, 0.3)) for sim in together]
    for thread in work:
        thread.start()
    for thread in work:
        thread.join()
    for alone, threaded in zip(apart, together, strict=True):
        alone.run(gait, 0.3)
        np.testing.assert_array_equal(threaded.data.qpos, alone.data.qpos)
        assert threaded.water.memory == alone.water.memory


@ROOTS
def test_the_wrenches_are_what_mujoco_makes_of_them(root):
    """J^T of force and moment about each centre of mass, by MuJoCo's own Jacobians, is Q - M_a a."""
    (model, data), water = fish_of(root), water_of(root)
    data.ctrl[:] = 0.4
    fish = LinkWrench(model, water)
    wrenches, total = fish.wrenches(data), np.zeros(model.nv)
    for i, wrench in enumerate(wrenches):
        mujoco.mj_applyFT(model, data, wrench[:3], wrench[3:], data.xipos[1 + i], 1 + i, total)
    (added, force), before = water.forces(model, data), data.qvel.copy()
    fish.step(data)
    np.testing.assert_allclose(total, force - added @ ((data.qvel - before) / model.opt.timestep), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(data.xfrc_applied[1:5], wrenches)
    assert wrenches[:, 2:5].any() == (root == "free")


@ROOTS
def test_a_loop_of_ones_own_applies_before_every_step(root):
    """What the water remembers moves on by itself, a push of one's own reaches the added mass, and a jump is noticed."""

    def pushed(way):
        (model, data), water = fish_of(root), water_of(root)
        push = lambda: data.qfrc_applied.__setitem__(0, 2.0 * np.cos(20 * data.time))
        with injected(way, model, water) as fish:
            for _ in range(25):
                push()
                data.ctrl[:] = gait(data.time)
                if way == "xfrc":
                    fish.apply(data)
                    mujoco.mj_step(model, data)
                else:
                    fish.step(data)
            if way == "xfrc":
                fish.apply(data)  # takes over what the last step left
        return data, water, fish

    (one, own, _), (two, injected_water, fish) = pushed("callback"), pushed("xfrc")
    np.testing.assert_allclose(ends(two, injected_water), ends(one, own), rtol=0, atol=1e-11)
    mujoco.mj_resetData(fish.model, two)
    with pytest.raises(ConfigError, match="went from 0.1000 s to 0.0000 s, expected one step of 0.004 s; call apply before"):
        fish.apply(two)
    fish.begin()
    assert injected_water.memory == [0.0] * 18 and injected_water.attached == 0.5
    fish.apply(two)


@pytest.mark.parametrize(("root", "way"), [("planar", "callback"), ("planar", "qfrc"), ("free", "callback"), ("free", "xfrc")])
def test_coefficients_may_be_replaced_between_ticks_and_the_memory_copied(root, way):
    """Every water holds `swimmer`, `attached` and `memory`; added mass follows new coefficients too."""
    other = MODEL.base._replace(k=[1.3 * k for k in MODEL.base.k], ke=0.3)
    first = Sim(FITTED, flow=FLOW, root=root, injection=way)
    first.run(gait, 0.3)
    again = Sim(FITTED, flow=FLOW, root=root, injection="callback" if way == "xfrc" else "xfrc")
    again.run(gait, 0.2)
    for sim in (first, again):
        sim.water.swimmer = sim.water.swimmer._replace(water=other)
    again.data.qpos[:], again.data.qvel[:], again.data.time = first.data.qpos, first.data.qvel, first.data.time
    again.commands, again.tick = list(first.commands), first.tick
    again.water.attached, again.water.memory = first.water.attached, list(first.water.memory)
    ends = []
    for sim in (first, again):
        for _ in range(10):
            sim.step(gait(sim.data.time))
        ends.append([*sim.data.qpos, *sim.data.qvel, sim.water.attached, *sim.water.memory])
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-10)
    fresh = Sim(FITTED, flow=FLOW, root=root)
    fresh.run(gait, 0.5)
    assert np.abs(fresh.data.qpos - first.data.qpos).max() > 1e-4


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"injection": "callbck"}, UnknownName, "Did you mean 'callback'?"),
        ({"injection": "qfrc", "root": "free"}, ConfigError, "closed form of a planar root; take 'callback' or 'xfrc'"),
        ({"injection": "xfrc", "water": "none"}, ConfigError, "has nothing to inject"),
        ({"injection": "xfrc", "robot": engines.with_effects(ROBOT, ["tether"])}, ConfigError, "take 'qfrc', or no"),
        ({"robot": engines.with_effects(ROBOT, ["tether"]), "root": "free"}, ConfigError, "planar root"),
    ],
)
def test_ways_that_cannot_be_are_refused(options, error, said):
    with pytest.raises(error) as caught:
        Sim(**options)
    assert said in str(caught.value)


def test_wrenches_are_for_eulers_step_and_the_waters_own_root():
    model = mjcf.build(ROBOT)
    with pytest.raises(ConfigError, match="LinkWrench: the model's root is 'planar', the water's 'free'"):
        LinkWrench(model, FreeWater(ROBOT))
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    with pytest.raises(ConfigError, match="not Euler"):
        LinkWrench(model, PlanarWater(ROBOT))
