"""The oracle's guard, device, settings, known answers and command line (faults 8, 9 and 11 of tests/FAULTS.md)."""

import os
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

wp = pytest.importorskip("warp")

from fishmj.base import console
from fishmj.base.errors import ConfigError, FishmjError, OracleUnstable, UnknownName
from fishmj.lbm_oracle import __main__ as verbs
from fishmj.lbm_oracle import cases
from fishmj.lbm_oracle.cases.sphere import ball
from fishmj.lbm_oracle.fluid import device, guard
from fishmj.lbm_oracle.fluid.device import device_of
from fishmj.lbm_oracle.fluid.domain_faces import PERIODIC, Axis, Boundaries, channel
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.markers import Markers, Sharpness, fish_markers, sphere_markers
from fishmj.lbm_oracle.refined.refined_fluid import RefinedFluid
from fishmj.lbm_oracle.run import stability
from fishmj.lbm_oracle.run.domain import Domain, preset, tank
from fishmj.lbm_oracle.run.setup import Gait, SwimSetup
from fishmj.water.flow import Flow
from studies.grid_studies import converge

pytestmark = pytest.mark.oracle
ONE = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=0.02)


def test_fault_8_unstable_oracle_is_refused_with_a_stable_setup(capsys):
    domain = preset("paper")
    with pytest.raises(OracleUnstable, match=r"Mach 0.35 at 1 m/s .* dt = 0.003333 s") as error:
        stability.check(domain, speed=1.0)
    assert error.value.limit == "mach"
    stability.check(domain.changed(dx=0.02, dt=0.02 / 6), speed=1.0)
    with pytest.raises(OracleUnstable, match="tau = 0.50003"):
        stability.check(domain, speed=0.3, subgrid="none")
    with pytest.raises(OracleUnstable, match="Space them by 0.02 m"):
        stability.check(domain, speed=0.3, spacing=0.05)
    with pytest.raises(OracleUnstable, match="2.0 cells from a face"):
        stability.check(domain, speed=0.3, clearance=2.0)
    capsys.readouterr()
    for speed in (0.3, 0.5, 0.5):
        stability.check(domain, speed=speed)
    assert capsys.readouterr().err == "fishmj: paper: Mach 0.17 at 0.5 m/s: compressibility errors of 3 %\n"


@pytest.mark.parametrize(("along", "rest", "limit"), [(np.nan, 0.0, "lost"), (0.45, 0.0, "speed"), (0.0, 0.4, "density")])
def test_fault_9_the_watch_stops_a_fluid_that_blows_up(along, rest, limit):
    water = Fluid(ONE, (12, 10, 8), subgrid="none")
    water.impose(np.full((12, 10, 8, 3), 0.01))
    water.run(50)
    assert water.watch.looks == 1 and water.watch.fastest > 0
    f = water.f.numpy()
    f[:3, 3, 3, 3] += rest, along, -along
    water.f.assign(f)
    water.run(1)
    with pytest.raises(OracleUnstable, match="at step 51") as error:
        water.watch.check(water)
    assert error.value.limit == limit


@pytest.mark.parametrize("alone", [True, False])
def test_water_that_blows_up_stops_whoever_steps_it_from_python(alone):
    """`Fluid.run`, `Fluid.step` and `FluidStructure.step` look every 50 steps; sooner it is not found."""
    lattice = replace(ONE, nu=0.0004)
    shape = (16, 16, 16)
    water = Fluid(lattice, shape, subgrid="none")
    rng = np.random.default_rng(1)
    water.impose(np.clip(0.12 * rng.normal(size=(*shape, 3)), -0.09, 0.09))
    f = water.f.numpy()
    f[:, 3:6, 3:6, 3:6] *= 6.0
    water.f.assign(f)
    body = FluidStructure(water, ball(3.0, lattice, at=(8.1, 8.2, 7.9)), sphere_markers(3.0, 1.0), slip=0.0)
    with pytest.raises(OracleUnstable, match="fluid: at step [0-9]+, .* would halve every Mach number") as error:
        if alone:
            water.run(200)
        for _ in range(200):
            body.step(np.ones(3), np.zeros(3))
    assert "at step 50," in str(error.value) or not alone


def test_water_and_bodies_above_the_mach_limit_are_refused():
    half = 0.5 * 3**-0.5  # cells a step: Mach 0.5
    for make, said in (
        (lambda: Fluid(ONE, (8, 8, 8), flow=Flow(speed=half)), "fluid: background flow: Mach 0.50"),
        (lambda: Fluid(ONE, (8, 8, 8)).set_flow(Flow(speed=half)), "fluid: background flow: Mach 0.50"),
        (lambda: Fluid(ONE, (8, 8, 8)).impose(np.full((8, 8, 8, 3), half)), "fluid: velocity: Mach 0.87"),
    ):
        with pytest.raises(OracleUnstable, match=said) as error:
            make()
        assert error.value.limit == "mach"
    lid = Boundaries(z=Axis("wall", "moving"), wall_velocity_lu=(half, 0, 0))
    with pytest.raises(OracleUnstable, match="moving wall: Mach 0.50 .* would give 0.30"):
        Fluid(ONE, (8, 8, 8), boundaries=lid, subgrid="none")
    with pytest.raises(OracleUnstable, match="tau = 0.50030 .* no subgrid model; at least 0.5005") as error:
        Fluid(replace(ONE, nu=1e-4), (8, 8, 8), subgrid="none")
    assert error.value.limit == "tau"
    towed = FluidStructure(Fluid(ONE, (16, 16, 16)), ball(3.0, ONE, at=(8.1, 8.2, 7.9)), sphere_markers(3.0, 1.0))
    with pytest.raises(OracleUnstable, match="coupled: a marker at t = 1 s: Mach 0.50 at 0.2886"):
        towed.step(np.ones(3), [half, 0, 0])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"blend": 1.5}, "fluid: blend = 1.5; expected a finite number from 0 to 1"),
        ({"blend": np.nan}, "fluid: blend = nan"),
        ({"cw": -0.1}, "fluid: cw = -0.1"),
        ({"omega_bulk": 2.1}, "fluid: omega_bulk = 2.1"),
        ({"body_acceleration": (0.0, np.nan, 0.0)}, r"fluid: body_acceleration\[1\] = nan"),
        ({"body_acceleration": 0.1}, r"fluid: body_acceleration has the shape \(\); expected \(3,\)"),
        ({"threads": 0}, "fluid: threads = 0"),
        ({"shape": (8, 8)}, r"fluid: shape has the shape \(2,\); expected \(3,\)"),
        ({"shape": (8, 8.0, 8)}, "fluid: shape has the type float64; expected whole numbers"),
        ({"shape": "8x8"}, "fluid: shape = '8x8'; expected numbers"),
    ],
)
def test_numbers_of_a_fluid_are_checked_where_it_is_made(options, said):
    with pytest.raises(ConfigError, match=said):
        Fluid(ONE, **({"shape": (8, 8, 8)} | options))


def test_fields_prescribed_motions_and_steps_are_checked():
    water = Fluid(ONE, (16, 16, 16))
    for u, said in ((np.zeros((16, 16, 16)), "velocity has the shape"), (np.full((16, 16, 16, 3), np.nan), "= nan")):
        with pytest.raises(ConfigError, match=said):
            water.impose(u)
    with pytest.raises(ConfigError, match="pressure has the shape"):
        water.impose(np.zeros((16, 16, 16, 3)), np.zeros(3))
    for steps in (-1, 2.5):
        with pytest.raises(ConfigError, match="fluid: steps"):
            water.run(steps)
    with pytest.raises(ConfigError, match="fluid: box has the shape"):
        water.step((0, 0, 0))
    with pytest.raises(ConfigError, match="lattice: corner"):
        replace(ONE, corner=(0.0, np.inf, 0.0))
    with pytest.raises(ConfigError, match="wall_velocity_lu"):
        Boundaries(z=Axis("wall", "moving"), wall_velocity_lu=(np.nan, 0.0, 0.0))
    held = FluidStructure(water, ball(3.0, ONE, at=(8.1, 8.2, 7.9)), sphere_markers(3.0, 1.0))
    for fixed, value, said in (
        (1.0, None, r"fixed has the shape \(\); expected \(3,\)"),
        ([1, 1, 2], None, r"fixed\[2\] = 2"),
        (np.ones(3), [0, np.nan, 0], r"value\[1\] = nan"),
        (None, np.zeros(3), "a value and no `fixed`"),
    ):
        with pytest.raises(ConfigError, match=said):
            held.step(fixed, value)
    for make, said in (
        (lambda: sphere_markers(np.nan, 1.0), "sphere: radius = nan"),
        (lambda: fish_markers("fish", 0.02, spacing=np.nan), "markers: spacing = nan"),
        (lambda: fish_markers("fish", 0.0), "markers: dx = 0"),
        (lambda: fish_markers("fish", 0.02, slip=1.5), "markers: slip = 1.5; expected a finite number from 0 to 1"),
        (lambda: fish_markers("fish", 0.02, hydro_offset=np.inf), "markers: hydro_offset = inf"),
        (lambda: Sharpness(rim=np.nan), "sharpness: rim = nan"),
        (lambda: water.shift((0.5, 0, 0)), "fluid: shift has the type float64"),
        (lambda: RefinedFluid(water, (4, 4, 4), (4.0, 4, 4)), "refined: size has the type float64"),
        (lambda: SwimSetup(domain=preset("laptop"), device="cpu").run(latency=np.nan), "run: latency = nan"),
    ):
        with pytest.raises(ConfigError, match=said):
            make()
    with pytest.raises(ConfigError, match="passes has the type float64"):
        FluidStructure(water, ball(3.0, ONE), sphere_markers(3.0, 1.0), passes=2.5)


def test_fault_11_too_small_gpu_is_refused_with_free_and_needed_memory(monkeypatch, capsys):
    monkeypatch.setattr(wp, "get_cuda_devices", lambda: [SimpleNamespace(free_memory=300 * 2**20)])
    with pytest.raises(ConfigError, match="300 MB free, the fluid needs 359 MB"):
        device_of("cuda", 359 * 2**20)
    with pytest.raises(ConfigError, match="cuda:3"):
        device_of("cuda:3")
    assert device_of("auto", 359 * 2**20).is_cpu and "running on the CPU" in capsys.readouterr().err
    with pytest.raises(UnknownName, match="cuda"):
        device_of("gpu")


@pytest.mark.parametrize(("said", "queues"), [(None, "32"), ("8", "8")])
def test_gpu_gets_32_queues_unless_the_environment_sets_another_number(said, queues, monkeypatch):
    if said is None:
        monkeypatch.delenv("CUDA_DEVICE_MAX_CONNECTIONS", raising=False)
    else:
        monkeypatch.setenv("CUDA_DEVICE_MAX_CONNECTIONS", said)
    device._warp.__wrapped__()
    assert os.environ["CUDA_DEVICE_MAX_CONNECTIONS"] == queues


@pytest.mark.parametrize(("levels", "steps"), [(1, 50), (2, 100), (3, 200)])
def test_the_watch_looks_every_fifty_steps_of_the_coarsest_water(levels, steps):
    seen = [n for n in range(1, 401) if guard.StabilityMonitor().due(SimpleNamespace(steps=n, levels=[None] * levels))]
    assert seen == list(range(steps, 401, steps))


def test_fault_11_without_an_accelerator_auto_falls_back_and_cuda_says_why():
    if wp.get_cuda_devices():
        with pytest.raises(ConfigError, match="MB free"):
            device_of("cuda", 2**60)
        return
    assert device_of("auto").is_cpu
    with pytest.raises(ConfigError, match="no usable accelerator"):
        device_of("cuda")


def test_wrong_settings_say_what_they_expected():
    with pytest.raises(UnknownName, match="slip"):
        Boundaries(x=Axis("slop", "slip"))
    with pytest.raises(ConfigError, match="both faces are periodic or none"):
        Boundaries(x=Axis("periodic", "slip"))
    with pytest.raises(ConfigError, match="dx = -1"):
        Lattice(dx=-1.0, dt=1.0)
    with pytest.raises(UnknownName, match="wale"):
        Fluid(ONE, (4, 4, 4), subgrid="smago")
    with pytest.raises(ConfigError, match="shape"):
        Fluid(ONE, (0, 4, 4), boundaries=PERIODIC)
    with pytest.raises(UnknownName, match="laptop"):
        preset("labtop")


@pytest.mark.parametrize("name", ["taylor_green", "poiseuille", "pulse"])
def test_known_answers_of_the_fluid(name):
    outcome = cases.solve(cases.known()[name], "cpu")
    assert outcome.ok, [check for check in outcome.checks if not check.ok]


def test_a_missed_check_exits_with_one(monkeypatch, capsys):
    wrong = cases.Case("wrong", 0, "none", "none", True, lambda device: [cases.below("nan", float("nan"), 1.0)])
    monkeypatch.setattr(cases, "known", lambda: {"wrong": wrong})
    assert cases.main(["wrong", "--json"]) == console.FAILED_CHECK
    assert '"verdict": "MISS"' in capsys.readouterr().out


def test_the_convergence_command_finds_second_order(capsys):
    assert converge.main([]) == console.OK
    assert "ok" in capsys.readouterr().out


OWN = """
from fishmj.lbm_oracle.cases import below, register

kept = register("{name}", rung=99, grid="none", source="rest")


def plain(device):
    yield below("speed, m/s", 0.0, 1e-6)


@kept
def mine(device):
    {body}
"""


@pytest.mark.parametrize(
    "name, body, called, said",
    [
        ("at_rest", 'yield below("speed, m/s", 0.0, 1e-6)', "mine", None),
        ("at_rest", 'yield below("speed, m/s", 1.0, 1e-6)', "mine", "0 of 1 checks hold"),
        ("at_rest", "return []", "plain", "expected a function under @register"),
        ("at_rest", "yield 1.0", "mine", "expected it to yield checks .* got 1.0"),
        ("at_rest", "return [1 / 0]", "mine", r"own.py:13: ZeroDivisionError"),
        ("poiseuille", "return []", "mine", "'poiseuille': registered twice"),
        ("at_rest", "return []", "min", "did you mean 'mine'"),
    ],
)
def test_a_case_may_be_a_function_of_the_users_own(name, body, called, said, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cases, "REGISTRY", dict(cases.known()))
    (tmp_path / "own.py").write_text(OWN.format(name=name, body=body))
    code = console.run(cases.main, [f"{tmp_path / 'own.py'}:{called}"])
    out, err = capsys.readouterr()
    failed = said is not None and "checks hold" in said
    assert code == (console.OK if said is None else console.FAILED_CHECK if failed else console.BAD_INPUT), err
    assert re.search(said or "1 of 1 checks hold", out + err) and ("Traceback" not in err)


def test_unknown_cases_and_verbs_are_named():
    with pytest.raises(UnknownName, match="poiseuille"):
        cases.main(["poisseuille"])
    with pytest.raises(UnknownName, match="cases"):
        verbs.main(["case"])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"lattice": {"dx": 1.0}}, r"fluid: lattice = .*expected fishmj.*Lattice\(...\)"),
        ({"boundaries": "wall"}, "fluid: boundaries = 'wall'; expected fishmj.*Boundaries"),
        ({"flow": 0.1}, "fluid: flow = 0.1; expected fishmj.water.flow.Flow"),
        ({"device": None}, "unknown device 'None'"),
        ({"boundaries": channel(sponge=4)}, "fluid: 8 cells along x and a sponge of 4 behind each open face"),
        ({"body_acceleration": (9.0, 0.0, 0.0)}, "fluid: body_acceleration, in a step: Mach 15.59"),
    ],
)
def test_fluid_of_other_objects_or_without_free_water_is_refused(options, said):
    with pytest.raises(FishmjError, match=said):
        Fluid(**({"lattice": ONE, "shape": (8, 8, 8)} | options))


def test_water_of_impossible_pressure_clock_or_parts_is_refused():
    water, rest = Fluid(ONE, (8, 8, 8)), np.zeros((8, 8, 8, 3))
    with pytest.raises(OracleUnstable, match="fluid: pressure: density 31.000 to 31.000") as error:
        water.impose(rest, np.full((8, 8, 8), 10.0))
    assert error.value.limit == "density"
    for make, said in (
        (lambda: water.set_flow(0.1), "fluid: flow = 0.1; expected fishmj.water.flow.Flow"),
        (lambda: water.set_steps(np.nan), "fluid: steps has the type float64"),
        (lambda: water.step(((5, 5, 5), (1, 1, 1))), "its low corner first"),
        (lambda: water.finer(0), "factor of finer steps = 0"),
        (lambda: water.finer(1.5), "factor of finer steps has the type float64"),
        (lambda: water.planes(0.5, 2), "fluid: planes has the type float64"),
        (lambda: guard.StabilityMonitor(every=0), "watch: every = 0"),
        (lambda: guard.StabilityMonitor(every=np.nan), "watch: every has the type float64"),
        (lambda: Lattice(dx="1", dt=1.0), "lattice: dx = '1'; expected a finite number"),
        (lambda: Lattice(dx=1.0, dt=1.0, corner=(0.0, None, 0.0)), "lattice: corner"),
        (lambda: Boundaries(x="slip"), "boundaries: x = 'slip'; expected Axis"),
        (lambda: Boundaries(sponge=2.5), "boundaries: sponge has the type float64"),
        (lambda: Boundaries(sponge_rate=np.nan), "boundaries: sponge_rate = nan"),
        (lambda: Boundaries(wall_velocity_lu=0.1), "boundaries: wall_velocity_lu has the shape"),
    ):
        with pytest.raises(ConfigError, match=said):
            make()
    assert Boundaries(x=("slip", "wall")).x == Axis("slip", "wall")
    box = np.array([[0, 0, 0], [4, 4, 4]])
    water.step(box)
    box[1] = 2  # the same array with other numbers is another box
    water.step(box)
    assert water.box.numpy().tolist() == [0, 0, 0, 2, 2, 2]


def test_snapshot_of_other_arrays_or_storage_is_refused():
    """Half precision holds scaled populations: read as single precision they would be another water."""
    water = Fluid(ONE, (8, 8, 8), subgrid="none")
    good = water.snapshot()
    for state, said in (
        ({}, "a snapshot without f, u, origin, steps"),
        (None, "fluid: a snapshot = None; expected builtins.dict"),
        ({**good, "u": np.zeros(3)}, "u of a snapshot has the shape"),
        ({**good, "f": np.full_like(good["f"], np.nan)}, "f of a snapshot is not finite"),
        ({**good, "f": good["f"].astype(np.float16)}, "a snapshot of float16 does not fit storage of float32"),
    ):
        with pytest.raises(ConfigError, match=said):
            water.restore(state)
    water.restore(good)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Domain(name="t", shape=(48, 30), dx=0.02, dt=0.004), r"domain t: shape has the shape \(2,\)"),
        (lambda: Domain(name="t", shape=(48.5, 30, 16), dx=0.02, dt=0.004), "domain t: shape has the type float64"),
        (lambda: Domain(name="t", shape=(48, 30, 16), dx=0.0, dt=0.004), "domain t: dx = 0"),
        (lambda: Domain(name="t", shape=(48, 30, 16), dx=0.02, dt=0.004, sides="moving"), "unknown kind of side 'moving'"),
        (lambda: Domain(name="t", shape=(48, 30, 16), dx=0.02, dt=0.004, fine=(1, 1)), r"fine has the shape \(2,\)"),
        (lambda: Domain(name="t", shape=(48, 30, 16), dx=0.02, dt=0.004, finer=((0.1,) * 3,)), "finer boxes in no box"),
        (lambda: preset("laptop").changed(depth=-1.0), "domain: depth = -1"),
        (lambda: preset("laptop").changed(dx=0.0), "domain: dx = 0"),
        (lambda: preset(["laptop"]), "unknown domain"),
        (lambda: tank("t", (-1, 1, 1), 0.02, 0.004), r"domain: size\[0\] = -1"),
        (lambda: Gait(frequency=np.inf), "gait: frequency = inf"),
        (lambda: Gait(amplitude=np.nan), "gait: amplitude = nan"),
        (lambda: Gait(bias=(0.0, 0.0, np.nan)), r"gait: bias\[2\] = nan"),
        (lambda: Gait(lag=(1, 2)), r"gait: lag has the shape \(2,\)"),
        (lambda: Gait(joints=2.5), "gait: joints has the type float64"),
        (lambda: SwimSetup(domain="laptop"), "oracle: domain = 'laptop'; expected fishmj.*Domain"),
        (lambda: SwimSetup(flow=0.1), "oracle: flow = 0.1"),
        (lambda: SwimSetup(pose=(0.0, 0.0)), r"oracle: pose has the shape \(2,\)"),
        (lambda: SwimSetup(sharpness="sharp"), "oracle: sharpness = 'sharp'"),
        (lambda: SwimSetup(joints=(0.0, 9.0, 0.0)), r"oracle: joints.* = 9; expected a finite number"),
        (lambda: fish_markers(sharpness="sharp"), "markers: sharpness = 'sharp'"),
        (lambda: stability.check(preset("laptop"), speed=0.3, subgrid="wal"), "unknown subgrid model 'wal'"),
        (lambda: stability.check(preset("laptop"), speed="a"), "guard: speed = 'a'"),
        (lambda: Markers.rigid(3, [[0, 0, 1]], 1.0), r"markers: rest has the shape \(\)"),
        (lambda: Markers.rigid([[0, 0, 0]], [[0, 0, 1]], "x"), r"markers: area = array\(\['x'\]"),
    ],
)
def test_set_up_of_a_swim_is_checked_where_it_is_made(make, said):
    with pytest.raises(FishmjError, match=said):
        make()
