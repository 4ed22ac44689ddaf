"""Effects in the flow solver's tanks: each acts as in `Sim`, or is refused by name because the solver is the water."""

import json
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fishmj import control, effects, engines, evaluate
from fishmj.base import console
from fishmj.base.calib import resolve
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.effects.effect import Effect, Parameter
from fishmj.effects.effect_calibration import FittedEffect, Interval, write
from fishmj.engines import FishState, Trace, lbm, tank_effects, tank_run
from fishmj.engines.tank_effects import in_tank, refused, without
from fishmj.engines.tank_run import EffectServos
from fishmj.evaluate import __main__ as command
from fishmj.evaluate import run_trials
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.link_dynamics import Corners
from fishmj.lbm_oracle.run import solver_water
from fishmj.lbm_oracle.run.domain import Domain
from fishmj.lbm_oracle.run.setup import SwimSetup
from fishmj.log import read_trial, stacked
from fishmj.mjcf import load_robot
from fishmj.mjcf.model import reference_qpos
from fishmj.sim import Sim
from fishmj.tasks import station_hold as task
from fishmj.tasks.episode import ControlLoop, Scenario
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import Flow

PLAIN = load_robot("fish")
TINY = Domain(name="tiny", shape=(56, 36, 20), dx=0.02, dt=0.004, follows=True)
POSE, TICKS = np.array([0.1, -0.2, 0.5]), 20
DRAWN = {"latency_jitter", "packet_loss", "turbulence", "noise_level"}
STRIPS = {"crossflow_drag", "tail_normal_force", "wake_memory", "wall_effect"}
FORCES = {"surge_added_mass", "sway_added_mass", "yaw_added_mass", "body_lift", "free_surface", "joint_hydro_damping"}
FORCES |= {"linear_surge_drag", "munk_moment", "quadratic_drag", "yaw_drag"}
UNEVEN = {"current_shear", "swirl"}
ACTING = sorted(set(effects.catalogue()) - DRAWN - STRIPS - FORCES - UNEVEN)
# the stream is that of the tank; clocks and what sensors make of a value are read outside the engine
MOVING = [name for name in ACTING if set(effects.get(name).sites) - {"measure", "flow"} or "command" in effects.get(name).delays]
SENSED = [name for name in ACTING if effects.get(name).measure or set(effects.get(name).delays) - {"command"}]


def robot_with(*names: str, **values: float):
    """The fish with effects at their larger typical values; `values` replaces those of the first."""
    many = [{p.name: p.probe for p in effects.get(name).parameters} for name in names]
    if values:
        many[0] |= values
    fitted = [FittedEffect(n, {k: Interval(x, x, x) for k, x in row.items()}) for n, row in zip(names, many, strict=True)]
    return replace(PLAIN, effects=tuple(fitted))


class Dry:
    """A tank without water: what `Run` asks of a coupled fish, and the equation of its step without the water's K and b0."""

    stepping = FluidStructure.stepping

    def __init__(self, stage: SwimSetup, body: ImmersedBody):
        self.body, self.steps, self.steps_since_sync, self.slip = body, 1, 1, 1.0  # step 1 for good: nobody looks after the water
        body.place(reference_qpos(body.model, stage.pose, np.array(stage.joints)))
        lattice, idle = SimpleNamespace(sound=np.inf, dt=body.dt), dict.fromkeys(("set_steps", "settle"), lambda *_: None)
        device = SimpleNamespace(is_cuda=False)
        self.fluid = SimpleNamespace(flow=stage.flow, lattice=lattice, steps=1, levels=[None], device=device, **idle)
        self.boundary = SimpleNamespace(corners=Corners(np.zeros((body.links, 8, 3)), body.water.centre))
        self.in_flight = False
        self.place_markers = self.assemble_response = self.push_water = self.join_stream = lambda: None

    @property
    def time(self) -> float:
        return float(self.body.data.time)

    def scope(self):
        return nullcontext()

    def solve(self, fixed, value):
        system, right = self.body.equation(interior=False)
        rows = np.flatnonzero(fixed) if fixed is not None else []
        system[rows], right[rows] = np.eye(len(right))[rows], 0.0
        self.velocity = np.linalg.solve(system, right)

    def advance(self):
        self.body.advance(self.velocity)

    def take_wrench(self, seconds):
        return np.zeros((self.body.links, 6)), np.zeros((self.body.links, 6))


@pytest.fixture
def dry(monkeypatch):
    """Tanks without water."""
    body = lambda stage, given: given or ImmersedBody.of(stage.robot, dt=stage.domain.dt)
    monkeypatch.setattr(SwimSetup, "coupled", lambda stage, given=None: Dry(stage, body(stage, given)))
    monkeypatch.setattr(lbm, "preset", lambda name: TINY)


@pytest.fixture
def tiny(monkeypatch):
    """The smallest box in which a fish swims."""
    monkeypatch.setattr(lbm, "preset", lambda name: TINY)


def beat(ticks=TICKS):
    """Bus commands (T, 3), rad; over the servo's range at times."""
    return 1.15 * np.sin(2 * np.pi * 1.3 * np.arange(ticks)[:, None] / 50 - np.arange(3))


def drawn_fish(robot):
    """A fish that is not the nominal one: `Swimmer` of `Sim` and `FishParams` of the engines."""
    rng, nominal = np.random.default_rng(5), planar_chain.nominal(robot)
    near = lambda values: (np.array(values) * rng.uniform(0.9, 1.1, len(values))).tolist()
    own = {name: near(getattr(nominal, name)) for name in ("mass", "kp", "kv", "kb")} | {"zero": [0.02, -0.03, 0.01]}
    params = engines.nominal_params(robot, 1)._replace(**{name: np.array([values]) for name, values in own.items()})
    return nominal._replace(**own), params


def in_air(robot, swimmer):
    """What `Sim` makes of the beat without water, and the memory of its effects."""
    sim = Sim(robot, water="none", pose=POSE, swimmer=swimmer)
    sim.data.qpos[3:] = swimmer.zero
    return sim.run(beat(), TICKS / 50), getattr(sim.water, "memory", [])


def in_dry_tank(robot, params):
    """State and trace of the same fish in a tank without water."""
    engine, state = lbm.LbmEngine(robot, [Flow()]), engines.at_rest(robot, POSE[None])
    state.q[:, 3:] = params.zero
    return engine.advance(state, beat()[None], params, None, np.zeros(1, int))


def same_swim(robot):
    swimmer, params = drawn_fish(robot)
    trial, memory = in_air(robot, swimmer)
    state, trace = in_dry_tank(robot, params)
    truth = trial.table("truth")
    close = lambda got, expected: np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9)
    close(trace.pose[0], np.stack([truth[k] for k in ("x", "y", "yaw")], -1))
    close(trace.velocity[0], np.stack([truth[k] for k in ("vx", "vy", "wz")], -1))
    close(trace.joint[0], stacked(truth, "j#"))
    close(trace.rate[0], stacked(truth, "k#"))
    if any(getattr(effects.get(fitted.name), site) for fitted in robot.effects for site in tank_run.STEPPED):
        close(state.memory[0], memory)
    return trial, trace


def test_every_effect_of_the_catalogue_acts_in_a_tank_or_is_the_waters():
    why = {name: in_tank(effect) for name, effect in effects.catalogue().items()}
    assert {name for name in why if not why[name]} == set(ACTING)
    assert all("coefficients of strips" in why[n] or "forces of strips" in why[n] for n in STRIPS)
    assert all("the solver replaces" in why[n] for n in STRIPS | FORCES)
    assert all("uniform, steady" in why[n] for n in UNEVEN) and all("stochastic" in why[n] for n in DRAWN)


def own(**sites) -> Effect:
    size = Parameter(name="size", unit="1", low=0.0, high=1.0, typical=(0.1, 0.5))
    known = {"name": "mine", "stage": "environment", "about": "", "formula": "", "source": ""}
    return Effect(**known, parameters=(size,), shows=(), **sites)


def test_an_effect_of_ones_own_is_judged_by_what_it_does_at_its_sites():
    braked = lambda xp, p, b, memory, h: (b._replace(fx=b.fx - p.size * b.u), memory)
    spring = lambda xp, p, b, memory, h: (b._replace(n=b.n - p.size * b.heading, mn=b.mn + p.size), memory)
    longer = lambda xp, p, c: c._replace(chain=c.chain._replace(d=tuple((1 + p.size) * d for d in c.chain.d)))
    pulsed = lambda xp, p, place: place._replace(u=place.u + p.size * xp.sin(place.time))
    faster = lambda xp, p, place: place._replace(u=(1 + p.size) * place.u)
    steady = lambda xp, p, place: place._replace(v=place.v - p.size)
    assert "force" in in_tank(own(body=braked)) and in_tank(own(body=spring)) == ""
    assert "hull" in in_tank(own(fish=longer))
    assert "steady" in in_tank(own(flow=pulsed)) and "steady" in in_tank(own(flow=faster)) and in_tank(own(flow=steady)) == ""


def test_a_tank_without_water_swims_as_sim_in_air_without_effects(dry):
    same_swim(PLAIN)


@pytest.mark.parametrize("name", MOVING)
def test_what_moves_the_fish_acts_in_a_tank_as_in_sim(dry, name):
    trial, trace = same_swim(robot_with(name))
    if effects.get(name).measure is None:
        drawn = trial.table("power")["V"] * trial.table("power")["I"] - PLAIN.servo.idle_power
        np.testing.assert_allclose(trace.power[0], drawn, rtol=0, atol=1e-9)
    plain = in_dry_tank(PLAIN, drawn_fish(PLAIN)[1])[1]
    assert np.abs(trace.pose - plain.pose).max() > 1e-6, "and it does something"


@pytest.mark.parametrize("name", ["body_mass", "com_offset", "yaw_inertia", "command_latency", "marker_offset"])
def test_effects_that_do_nothing_in_a_step_leave_the_servos_to_the_device(dry, name):
    fish, params = robot_with(name), drawn_fish(PLAIN)[1]
    params = params._replace(effects=engines.nominal_params(fish, 1).effects)
    given = engines.at_rest(fish, POSE[None])
    by_model = lbm.LbmEngine(fish, [Flow()]).tank(0, given.q[0], params)
    assert not isinstance(by_model, tank_run.EffectRun)
    both = robot_with(name, "coulomb_friction")
    assert isinstance(lbm.LbmEngine(both, [Flow()]).tank(0, given.q[0], engines.nominal_params(both, 1)), tank_run.EffectRun)


def test_many_effects_act_together_in_their_order(dry):
    same_swim(robot_with(*MOVING[::-1]))


def test_an_effect_with_a_mass_of_its_own_is_taken_implicitly(dry, monkeypatch):
    def body(xp, p, b, memory, h):
        return b._replace(mx=b.mx + p.size, my=b.my + 2 * p.size, mn=b.mn + p.size, fx=b.fx + p.size), memory

    monkeypatch.setitem(effects.catalogue(), "mine", own(body=body))
    same_swim(robot_with("mine"))


class Replayed:
    """An engine that gives what `Sim` did, control step by control step."""

    def __init__(self, trial, zero):
        truth, self.zero = trial.table("truth"), zero
        columns = ([truth[k] for k in ("x", "y", "yaw")], [truth[k] for k in ("vx", "vy", "wz")])
        pose, velocity = (np.stack(column, -1)[None] for column in columns)
        self.trace = Trace(pose, stacked(truth, "j#")[None], stacked(truth, "k#")[None], velocity, np.zeros((1, TICKS)))

    def advance(self, state, commands, params, current, tick):
        part = slice(tick[0], tick[0] + commands.shape[1])
        return FishState(state.q, state.v, *state[2:]), Trace(*(column[:, part] for column in self.trace))


@pytest.mark.parametrize("name", SENSED)
def test_sensors_and_late_clocks_report_of_a_tank_what_they_report_of_sim(dry, name):
    robot = robot_with(name)
    swimmer, params = drawn_fish(robot)
    camera = task.draw_fish(np, robot, np.full((1, task.n_fish(robot)), 0.5), 0.0)[1]
    seen = []
    for engine in (lbm.LbmEngine(robot, [Flow()]), Replayed(in_air(robot, swimmer)[0], swimmer.zero)):
        loop = ControlLoop(robot, engine)
        loop.start(POSE[None], Scenario(params, camera, Flow().current()))
        for part in np.split(beat(), TICKS // loop.ticks):
            loop.act(part[None])
        seen.append(loop.observe(np.zeros((1, 2)), np.zeros((1, 11))))
    np.testing.assert_allclose(seen[0], seen[1], rtol=0, atol=1e-9)


def test_a_second_attempt_at_a_tick_remembers_what_the_first_did(dry):
    robot = robot_with("gear_backlash", "skin_hysteresis")
    engine, params = lbm.LbmEngine(robot, [Flow()]), engines.nominal_params(robot, 1)
    state, _ = engine.advance(engines.at_rest(robot, POSE[None]), beat()[None], params, None, np.zeros(1, int))
    (run,) = engine.tanks.runs
    found = []
    for factor in (1, 1, 2):
        driver = EffectServos(run, run.coupled, factor)
        assert run.added.memory == state.memory[0].tolist()
        driver.actuate(0)
        found.append(list(run.added.memory))
    assert found[0] == found[1] != state.memory[0].tolist() and driver.power > 0


def test_a_steady_current_joins_the_stream_of_the_tank(tiny):
    robot = robot_with("steady_current", x=0.05, y=-0.02)
    flow = Flow(speed=0.2, direction=1.0, turbulence="shear", intensity=0.1, seed=3)
    engine, params = lbm.LbmEngine(robot, [flow] * 2), engines.nominal_params(robot, 2)
    params.effects[1] = 0.0  # each fish has its own parameters
    runs = [engine.tank(i, np.zeros(6), params, np.zeros(2)) for i in range(2)]
    more, same = (run.coupled.fluid.flow for run in runs)
    np.testing.assert_allclose(more.mean, flow.mean + [0.05, -0.02, 0.0], atol=1e-12)
    assert more.rms == flow.rms and same is flow
    for old, new in zip(flow.current()[1:], more.current()[1:], strict=True):
        np.testing.assert_array_equal(old, new)
    where = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_allclose(more.at(where, 0.0), flow.at(where, 0.0) + [0.05, -0.02, 0.0], atol=1e-9)
    water, plain = (run.coupled.fluid.velocity() for run in runs)
    np.testing.assert_allclose((water - plain).reshape(-1, 3).mean(0), [0.05, -0.02, 0.0], atol=1e-4)


def test_solver_tank_applies_tether_and_friction_and_ignores_null_effects(tiny):
    names, ticks = ("tether", "viscous_friction", "body_mass"), 8
    null = engines.with_effects(PLAIN, names)
    rows = np.tile(engines.nominal_params(null, 1).effects, (2, 1))
    place = [(name, p.name) for name in names for p in effects.get(name).parameters]
    for key, value in ((("tether", "stiffness"), 5.0), (("tether", "x"), 1.5), (("viscous_friction", "damping"), 1.0)):
        rows[0, place.index(key)] = value
    commands = np.tile(0.4 * beat(ticks), (2, 1, 1))
    traces = []
    for robot, many in ((null, 2), (PLAIN, 1)):
        engine = lbm.LbmEngine(robot, [Flow()] * many, domain="laptop", device="cpu")
        params = engines.nominal_params(robot, many)
        state = engines.at_rest(robot, np.zeros((many, 3)))
        params = params._replace(effects=rows if many == 2 else params.effects)
        traces.append(engine.advance(state, commands[:many], params, None, np.zeros(many, int))[1])
        assert engine.stopped == [""] * many
    trace, plain = traces
    np.testing.assert_allclose(trace.pose[1], plain.pose[0], atol=1e-6)
    np.testing.assert_allclose(trace.power[1], plain.power[0], atol=1e-4)
    assert trace.pose[0, -1, 0] > plain.pose[0, -1, 0] + 0.01, "5 N/m over 1.5 m for 0.16 s"
    assert np.abs(trace.rate[0, :, 0]).max() < 0.9 * np.abs(plain.rate[0, :, 0]).max()


@pytest.mark.slow
def test_in_water_a_steady_current_is_a_stream_of_that_speed(tiny):
    drift = []
    for robot, flow in ((robot_with("steady_current", x=0.1, y=0.0), Flow()), (PLAIN, Flow(speed=0.1))):
        engine, params = lbm.LbmEngine(robot, [flow], domain="laptop", device="cpu"), engines.nominal_params(robot, 1)
        state = engines.at_rest(robot, np.zeros((1, 3)))
        drift.append(engine.advance(state, np.zeros((1, 10, 3)), params, None, np.zeros(1, int))[1].pose[0])
    np.testing.assert_allclose(drift[0], drift[1], atol=1e-6)
    assert drift[0][-1, 0] > 1e-4


def test_what_is_the_waters_is_refused_by_name_and_can_be_left_out():
    robot = robot_with("wake_memory", "coulomb_friction", "swirl")
    assert list(refused(robot)) == ["wake_memory", "swirl"]
    with pytest.raises(ConfigError, match=r"wake_memory: .*the solver replaces; swirl: .*--leave-out wake_memory,swirl"):
        lbm.LbmEngine(robot, [Flow()])
    assert [fitted.name for fitted in without(robot, ["swirl", "wake_memory"]).effects] == ["coulomb_friction"]
    with pytest.raises(UnknownName, match="wake_memory"):
        without(robot, ["wake_memry"])
    assert tank_effects.check_effects(PLAIN) is None


def patched(tmp_path, *names: str) -> str:
    """A description file with these effects."""
    path = tmp_path / "patched.toml"
    path.write_text(resolve("fish").read_text(encoding="utf-8"), encoding="utf-8")
    return str(write(path, robot_with(*names).effects))


QUICK = ("--speeds", "0", "--turbulence", "none", "--los", "180", "--repeats", "1", "--duration", "1")


def test_the_command_refuses_what_is_the_waters_and_judges_without_it(dry, tmp_path, capsys):
    path, out = patched(tmp_path, "quadratic_drag", "coulomb_friction"), tmp_path / "out"
    judge = lambda *more: console.run(command.main, ["drift", "--robot", path, "--water", "lbm", *QUICK, *more])
    assert judge() == console.BAD_INPUT
    said = capsys.readouterr().err
    assert "quadratic_drag: " in said and "--leave-out quadratic_drag" in said and "coulomb_friction" not in said
    assert judge("--leave-out", "quadratic_drg") == console.BAD_INPUT
    assert "Did you mean 'quadratic_drag'" in capsys.readouterr().err
    less = ("--leave-out", "quadratic_drag", "--domain", "laptop", "--device", "cpu", "--out", str(out), "--log")
    assert judge(*less) == console.OK
    said = "without the effects quadratic_drag"
    assert said in capsys.readouterr().out and said in (out / "report.html").read_text(encoding="utf-8")
    found = json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert found["left_out"] == ["quadratic_drag"] and said in found["condition"]
    assert read_trial(out / "logs" / "drift_u0_los180_r0").value("left_out") == ["quadratic_drag"]


def test_a_kept_trial_belongs_to_the_effects_that_it_was_swum_with():
    brain, plan = control.make("drift", PLAIN), evaluate.trials(speeds=[0.2], los_deg=[0], repeats=1, duration=1.0)
    robots = (PLAIN, robot_with("coulomb_friction"), robot_with("coulomb_friction", torque=0.01), robot_with("servo_gain"))
    assert len({run_trials.fingerprint(brain, robot, plan, solver_water.PLAIN) for robot in robots}) == len(robots)


def test_dm_control_solver_fish_has_described_and_drawn_effects(dry):
    suite = pytest.importorskip("fishmj.tasks.dm_control")
    given = {"robot": robot_with("coulomb_friction"), "effects": ("viscous_friction",), "seconds": 0.4, "water": "lbm"}
    env = suite.load("fish", "station_hold", task_kwargs={"random": 1, **given})
    env.reset()
    env.step(np.array([0.5, 0.0, 0.0]))
    (run,), params = env.physics.engine.tanks.runs, env.task.scenario.params
    assert run.added.row == params.effects[0].tolist() and 0.02 <= params.effects[0, 1] <= 0.15
    np.testing.assert_array_equal(env.physics.fish.memory[0], run.added.memory)
    assert run.added.memory[tank_run.CLOCK] == pytest.approx(0.2), "the held second before is not part of the session"
    with pytest.raises(ConfigError, match="wake_memory"):
        suite.load("fish", "station_hold", task_kwargs={**given, "effects": ("wake_memory",)})
