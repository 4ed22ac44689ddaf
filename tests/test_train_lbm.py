"""Training in tanks of the flow solver, and a water that is refitted between trainings. Most tanks here hold no water."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from training import Point, StopAt, figures_of

from fishmj.base import console
from fishmj.base.errors import ConfigError, OracleUnstable
from fishmj.control.policy import Policy
from fishmj.engines import lbm, nominal_params
from fishmj.engines.lbm_episodes import LbmEpisodes
from fishmj.hydro_fit.campaign.dagger import dagger
from fishmj.lbm_oracle.run.domain import Domain
from fishmj.lbm_oracle.run.run import LeftDomain
from fishmj.mjcf import load_robot
from fishmj.tasks import station_hold
from fishmj.train import correct_water
from fishmj.train.__main__ import main
from fishmj.train.build import environment, settled
from fishmj.train.hyperparameters import PPOConfig
from fishmj.train.ppo import PPO
from fishmj.train.settings import change, preset
from fishmj.train.training_run import TrainingRun, learner_of

TINY = Domain(name="tiny", shape=(60, 60, 20), dx=0.02, dt=0.004, follows=True, sponge=4)
STEPS, TICKS = 5, 10  # control steps of an episode, bus ticks of a control step


def tiny_run(**changes):
    """Three fish, two iterations of 24 control steps, in episodes of a second."""
    small = {"envs": 3, "horizon": 8, "minibatches": 2, "epochs": 1, "hidden": (8, 8)}
    base = change(preset("lbm"), task={"seconds": 1.0}, algorithm=small, solver={"device": "cpu", "slip": 0.97})
    return settled(change(base, **{"steps": 48, "assess_every": 48, "assess_episodes": 2, **changes}))


class Drifting:
    """A run without water: once released, the fish drifts with the mean stream of its tank; `ends` is raised in tick 13."""

    def __init__(self, q, flow, ends=None):
        self.q, self.flow, self.ends = np.array(q, float), flow, ends
        self.stopped, self.rows, self.ticks, self.tethered = "", [], 0, True
        self.coupled = SimpleNamespace(fluid=SimpleNamespace(flow=flow))

    @property
    def pose(self):
        return np.concatenate([self.q[:3], self.flow.mean[:2], [0.0]])

    def angles(self):
        return self.q[3:].copy()

    def rates(self):
        return np.zeros(len(self.q) - 3)

    def begin(self):
        self.ticks = 0

    def ticking(self, command):
        yield
        if self.ticks == 12 and self.ends is not None and not self.tethered:
            raise self.ends
        if not self.tethered:
            self.q[:2] += 0.02 * self.flow.mean[:2]
        self.ticks += 1


@pytest.fixture
def tanks(monkeypatch):
    """Tanks without water: a list of (fish, run) as they are filled, and `ends`, the error of a fish's first tank."""
    made, ends = [], {}

    def tank(engine, i, q, params, memory=None):
        made.append((i, Drifting(q, engine.flows[i], ends.pop(i, None))))
        return made[-1][1]

    monkeypatch.setattr(LbmEpisodes, "tank", tank)
    monkeypatch.setattr(lbm, "set_clock", lambda run, time: None)
    return SimpleNamespace(made=made, ends=ends)


def test_a_fish_that_begins_an_episode_gets_a_tank_of_its_own_flow_and_pose(tanks):
    env = environment(tiny_run())
    state, filled = env.reset(jax.random.key(1), 3, True), 0
    for _ in range(2 * STEPS):
        before = state
        state = env.step(state, jnp.zeros((3, 3)))
        fresh = np.flatnonzero(before.tick == 0)
        assert [i for i, _ in tanks.made[filled:]] == fresh.tolist()
        for i, run in tanks.made[filled:]:
            np.testing.assert_allclose(run.flow.mean[:2], before.current.mean[i], atol=1e-6)
            assert run.flow.rms == pytest.approx(float(before.current.rms[i])) and not run.tethered
        filled = len(tanks.made)
        done = np.asarray(state.truncated | state.terminated)
        moved = np.asarray(before.fish.q[:, :2] + 0.02 * TICKS * before.current.mean)
        np.testing.assert_allclose(state.fish.q[~done, :2], moved[~done], atol=1e-5)
        assert (np.asarray(state.tick)[done] == 0).all()
    assert filled > 2 * 3, "every fish has begun anew by then, each at its own time"


def test_a_fish_at_a_wall_has_left_and_one_whose_water_failed_is_dropped(tanks):
    tanks.ends |= {0: LeftDomain("left_domain at t = 0.24 s"), 1: OracleUnstable("too fast", limit="mach")}
    env = environment(tiny_run())
    state = env.reset(jax.random.key(1), 3)
    state = env.step(state, jnp.zeros((3, 3)))
    assert not state.terminated.any() and not state.diverged.any()
    state = env.step(state, jnp.zeros((3, 3)))
    assert state.terminated.tolist() == [True, False, False] and state.diverged.tolist() == [False, True, False]
    assert state.tick.tolist() == [0, 0, 2 * TICKS] and np.isfinite(state.final_obs).all()


def test_a_stopped_run_goes_on_with_new_episodes(tanks, tmp_path, capsys):
    settings = tiny_run()
    learner = learner_of(settings)
    first = StopAt(settings, tmp_path / "run", 24, learner=learner).go()
    assert first["stopped"] and first["steps"] == 24
    run = TrainingRun(settings, tmp_path / "run", resume=True, quiet=True, learner=learner)
    assert "every fish begins a new episode" in capsys.readouterr().err and not run.training.env_state.tick.any()
    filled = len(tanks.made)
    assert run.go()["steps"] == 48 and {i for i, _ in tanks.made[filled : filled + 3]} == {0, 1, 2}
    assert [row["step"] for row in figures_of(run)] == [24, 48, 48]
    header = Policy.load(tmp_path / "run" / "best.safetensors").meta
    assert (header["engine"], header["water"]["name"], header["solver"]["slip"]) == ("lbm", "lbm", 0.97)


def test_an_error_of_a_tank_ends_the_run_as_it_is(tanks, tmp_path, monkeypatch):
    def refuse(*_):
        raise OracleUnstable("the fish is 0.4 cells from a face", limit="clearance")

    monkeypatch.setattr(LbmEpisodes, "tank", refuse)
    with pytest.raises(OracleUnstable, match="0.4 cells from a face"):
        TrainingRun(tiny_run(), tmp_path / "run", quiet=True).go()
    assert not list((tmp_path / "run" / "checkpoints").glob("*"))


def test_a_critic_that_learns_alone_leaves_the_actor_as_it_is():
    config = PPOConfig(envs=8, horizon=8, minibatches=2, hidden=(8,))
    ppo = PPO(Point(), config, 640, moves=False)
    state = ppo.init(jax.random.key(0))
    kept = jax.tree.map(np.array, (state.actor, state.log_sigma, state.critic))
    state, _ = ppo.iterate(state)
    same = lambda a, b: all(np.array_equal(x, y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))
    assert same((state.actor, state.log_sigma), kept[:2]) and not same(state.critic, kept[2])


def test_tanks_take_several_devices_in_turn(monkeypatch):
    """A new tank of a fish stands where its first one stood."""
    asked, engine = [], LbmEpisodes(load_robot("fish"), "none", 1, device="cpu,cpu")
    assert engine.devices == ("cpu", "cpu")
    engine.devices, engine.flows = ("first", "second"), [engine.kind] * 3

    def stage(**given):
        asked.append(given["device"])
        raise LeftDomain("no water here")

    monkeypatch.setattr(lbm, "SwimSetup", stage)
    params = nominal_params(engine.robot, 3)
    for fish in (0, 1, 2, 1):
        with pytest.raises(LeftDomain):
            engine.tank(fish, np.zeros(6), params)
    assert asked == ["first", "second", "first", "second"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--engine lbm --preset quick", "needs too many tanks, one a fish"),
        ("--engine lbm --together --seeds 0,1", "--together: not supported in the flow solver"),
        ("--engine lbm --algo sb3-ppo", "--algo sb3-ppo: not supported in the flow solver"),
        ("--engine lbm --ray local:2", "--ray: not supported in the flow solver"),
        ("--engine lbm --water swift", "water 'swift' with --engine lbm"),
        ("--slip 0.98", "--slip: needs --engine lbm or --correct"),
        ("--correct --resume", "--correct with --resume"),
        ("--correct --ray local:2", "--correct with --ray"),
        ("--correct --devices 2", "--correct with --devices"),
        ("--correct --engine lbm", "--correct with --engine lbm"),
        ("--correct --device cpu --water family", "a family has several waters"),
    ],
)
def test_what_the_solver_cannot_do_is_refused(words, said, capsys):
    assert console.run(main, words.split()) == console.BAD_INPUT
    assert said in capsys.readouterr().err


@pytest.mark.slow
def test_an_episode_in_a_learner_s_tank_is_the_swim_of_the_judge_s(monkeypatch):
    monkeypatch.setattr(lbm, "preset", lambda name: TINY)
    settings = tiny_run()
    env = environment(settings)
    state = env.reset(jax.random.key(3), 1)
    judge = lbm.LbmEngine(env.robot, [], slip=0.97, device="cpu")
    fish, params = (jax.tree.map(lambda a: np.asarray(a, float), tree) for tree in (state.fish, state.params))
    for k in range(2):
        action = jnp.full((1, 3), 0.4 * (-1) ** k)
        command = np.asarray(station_hold.chunk(jnp, env.robot, state.command, action), float)
        state = env.step(state, action)
        judge.flows = list(env.engine.flows)
        fish, trace = judge.advance(fish, command, params, None, np.array([k * TICKS]))
        np.testing.assert_allclose(state.fish.q, fish.q, atol=2e-6)
        assert np.abs(fish.q[0, 3:]).max() > 0.01 and not env.engine.failed


class Training:
    """A training of no step: its policy is `station`."""

    calls: list = []
    stops = False

    def __init__(self, settings, folder, *, resume, command, begin):
        self.calls.append((settings, folder, resume, begin))

    def go(self):
        policy = self.calls[-1][1] / "best.safetensors"
        Policy.load("station").save(policy)
        return {"stopped": self.stops, "policy": str(policy)}


@pytest.fixture
def rounds(monkeypatch):
    """Rounds without trainings, swims and fits: the returns agree in the second."""
    Training.calls, Training.stops = [], False
    swum = []
    monkeypatch.setattr(correct_water, "TrainingRun", Training)

    def swim(policy, robot, model, solver, setup, pool, *, seed, **_):
        swum.append((policy, model.slip))
        row = {"n": 4, "solver": 0.4, "surrogate": 0.41 + 0.2 * (seed == 1), "low": 0.0, "high": 0.1}
        return row | {"rmse_solver": 0.2, "rmse_surrogate": 0.1, "gap": abs(row["surrogate"] / 0.4 - 1)}

    monkeypatch.setattr(dagger, "_round", swim)
    monkeypatch.setattr(dagger, "refitted", lambda robot, model, *_: model)
    return swum


def test_trainings_and_fits_take_turns_until_the_returns_agree(rounds, tmp_path):
    settings = change(preset("quick"), engine="compiled", water="swift")
    given = {"begin": "station", "slip": 0.98, "device": "cpu", "steps": 1000}
    found = correct_water.train_and_correct(settings, tmp_path, **given)
    assert found["agreed"] and [row["round"] for row in found["rounds"]] == [1, 2]
    first, second = (tmp_path / f"round-{n}" / "train" / "best.safetensors" for n in (1, 2))
    assert rounds == [(str(first), 0.98), (str(second), 0.98)] and found["policy"] == str(second)
    waters = [settings.water for settings, *_ in Training.calls]
    assert waters == [str(tmp_path / f"round-{n}" / "water.toml") for n in (0, 1)] and found["water"] == waters[1]
    assert all(call[3] is not None and call[0].steps == 1000 for call in Training.calls)
    assert "+0.210 (+0.000 +0.100)" in correct_water.table(found["rounds"])
    again = correct_water.train_and_correct(settings, tmp_path, **given)
    assert again["rounds"] == found["rounds"] and len(Training.calls) == len(rounds) == 2, "what is there is not done again"
    with pytest.raises(ConfigError, match=r"begun with settings\.seed 0, got 1; slip 0\.98, got 0\.95; repeat the options"):
        correct_water.train_and_correct(change(settings, seed=1), tmp_path, **given | {"slip": 0.95})


def test_a_training_that_was_stopped_ends_the_rounds_and_goes_on(rounds, tmp_path):
    settings = change(preset("quick"), engine="compiled", water="structured")
    Training.stops = True
    with pytest.raises(KeyboardInterrupt):
        correct_water.train_and_correct(settings, tmp_path, begin="station", device="cpu")
    (tmp_path / "round-1" / "train" / "checkpoints").mkdir(parents=True)
    (tmp_path / "round-1" / "train" / "checkpoints" / "step_1").touch()
    Training.stops = False
    assert correct_water.train_and_correct(settings, tmp_path, begin="station", device="cpu")["agreed"]
    assert [(resume, begin is None) for *_, resume, begin in Training.calls[:2]] == [(False, False), (True, True)]
    assert Training.calls[0][0].steps == correct_water.AGAIN
