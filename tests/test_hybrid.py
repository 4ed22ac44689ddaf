"""A surrogate is corrected by stretches of a better water, and by rounds of what a policy does. That water is made up here."""

from types import SimpleNamespace

import numpy as np
import pytest

from fishmj.campaign.dagger import dagger
from fishmj.campaign.data import plan
from fishmj.campaign.data.run_segments import Finished, Setup
from fishmj.campaign.hybrid import hybrid_trial
from fishmj.campaign.hybrid.hybrid import CorrectionSegment, Hybrid, Path, Surrogate
from fishmj.dynamics import planar_chain
from fishmj.errors import ConfigError, MissingExtra
from fishmj.hydro_fit import online_correction
from fishmj.lbm_oracle.run.domain import preset
from fishmj.mjcf import load_robot
from fishmj.studies.water_ablation.ablation import unfitted

ROBOT = load_robot("fish")
CHAIN, TRUE = planar_chain.chain_of(ROBOT), planar_chain.nominal(ROBOT).water
WRONG = TRUE._replace(cf=3 * TRUE.cf, cn=[*TRUE.cn[:3], 0.5 * TRUE.cn[3]])
COMMANDS = [0.4 * min(1.0, k * 0.02) * np.sin(2 * np.pi * 0.02 * k - 1.0 * np.arange(3)) for k in range(300)]


class Made:
    """An oracle: the strip water with the true coefficients."""

    def __init__(self):
        self.asked = []

    def stretch(self, path, past, commands):
        fish = Surrogate(ROBOT, CHAIN, TRUE)
        fish.q, fish.v, fish.commands, fish.ticks = path.q[-1], path.v[-1], [np.array(c) for c in past], len(past) - 1
        states = [(fish.q, fish.v)]
        for command in commands:
            fish.tick(command)
            states.append((fish.q, fish.v))
        self.asked.append((len(path.q) - 1, len(commands)))
        return CorrectionSegment(*(np.array(column) for column in zip(*states, strict=True)))


def swum(water, commands=COMMANDS):
    fish = Surrogate(ROBOT, CHAIN, water)
    for command in commands:
        fish.tick(command)
    return fish.q


def run(oracle, **options):
    hybrid = Hybrid(
        Surrogate(ROBOT, CHAIN, WRONG), oracle, **{"own": 1.0, "first": 2.0, "every": 20.0, "lead": 0.1, "span": 0.5} | options
    )
    for command in COMMANDS:
        hybrid.tick(command)
    return hybrid


def test_stretches_of_a_better_water_halve_the_error_of_a_wrong_one():
    """Three times the friction, half the tail's cross-flow drag; a tenth of 6 s in the better water, under way."""
    oracle = Made()
    hybrid = run(oracle)
    found = hybrid.episode()
    truth = swum(TRUE)[:2]
    before, after = (np.linalg.norm(swum(water)[:2] - truth) for water in (WRONG, hybrid.surrogate.water))
    assert found["covered"] <= 0.1 + 1e-9 and oracle.asked == [(25, 25)] and not found["off"]
    assert before > 0.05 and after < 0.5 * before, (before, after, found["factors"])


def test_a_stretch_from_rest_has_no_lead():
    oracle = Made()
    hybrid = run(oracle, first=0.0, every=20.0)
    assert oracle.asked == [(0, 30)] and hybrid.episode()["covered"] == pytest.approx(0.1)


def test_a_right_surrogate_is_left_alone():
    hybrid = Hybrid(Surrogate(ROBOT, CHAIN, TRUE), Made(), first=0.0, every=6.0, lead=0.3, span=0.3)
    for command in COMMANDS:
        hybrid.tick(command)
    np.testing.assert_allclose(hybrid.state.factors, 1.0, atol=1e-9)


def test_a_surrogate_within_the_misses_of_a_right_one_stays_to_the_bit():
    """The same wrong surrogate, where right ones miss by as much and where they do not."""
    moved, kept = (run(Made(), own=own) for own in (1.0, 1000.0))
    assert np.abs(np.log(moved.state.factors)).max() > 0.5
    np.testing.assert_array_equal(kept.state.factors, 1.0)
    np.testing.assert_array_equal(kept.surrogate.q, swum(WRONG))
    before, after = kept.rows[0][1:3]
    assert 0 < before < 1 and after == before < moved.rows[0][1]


def linear(slopes, at):
    """Misses (R, B) that are linear in the logarithms of the free factors, none at `at`."""
    return lambda factors: slopes @ (np.log(factors[online_correction.FREE]) - np.asarray(at)[:, None])


@pytest.mark.parametrize(("size", "moves"), [(0.99, False), (1.01, True)])
def test_what_nine_of_ten_right_ones_stay_below_refutes_nothing(size, moves):
    """Twelve misses in the pattern of one factor, just within and just beyond those of a right surrogate."""
    slopes = np.zeros((12, 7))
    slopes[:, 2] = 2.0
    found = online_correction.matched(online_correction.fresh(), linear(slopes, size / 2.0 * np.eye(7)[2]))
    assert np.array_equal(found.factors, np.ones(10)) is not moves
    assert np.array_equal(found.information, online_correction.fresh().information) is not moves


@pytest.mark.parametrize(("gain", "moves"), [(0.9, False), (1.1, True)])
def test_factors_move_where_they_gain_more_than_by_chance(gain, moves):
    """Large misses, all but one of which no factor mends: that one against ln det(1 + J P J^T) of its factor."""
    slope, width = 3.0, online_correction.WRONG[1]
    spread = 1 + (slope * width) ** 2
    at = np.sqrt(gain * np.log(spread) * spread / (spread - 1)) / slope  # a^2 d^2 / (1 + d^2) = gain x ln(1 + d^2)
    mended = linear(slope * np.eye(7)[[1]], at * np.eye(7)[1])
    misses = lambda factors: np.concatenate([mended(factors), np.full((11, factors.shape[1]), 2.0)])
    found = online_correction.matched(online_correction.fresh(), misses)
    expected = at * (spread - 1) / spread if moves else 0.0
    np.testing.assert_allclose(np.log(found.factors[1]), expected, rtol=1e-9, atol=0)


def test_what_is_known_grows_by_every_stretch_that_moves_and_is_forgotten():
    """Two refuting stretches of a linear surrogate against recursive least squares; a third that refutes nothing forgets."""
    rng, free, prior = (
        np.random.default_rng(3),
        np.ix_(online_correction.FREE, online_correction.FREE),
        online_correction.fresh().information,
    )
    state, mean, known = online_correction.fresh(), np.zeros(7), prior[free]
    for idle in (0.0, 12.0):
        slopes, at = rng.normal(size=(12, 7)) * 10, rng.normal(size=7) * 0.2
        known = prior[free] + np.exp(-idle / online_correction.MEMORY) * (known - prior[free])
        cost = known @ mean + slopes.T @ slopes @ at
        known = known + slopes.T @ slopes
        mean = np.linalg.solve(known, cost)
        state = online_correction.matched(state, linear(slopes, at), idle=idle)
        np.testing.assert_allclose(np.log(state.factors)[online_correction.FREE], mean, rtol=1e-6)
        np.testing.assert_allclose(state.information[free], known, rtol=1e-6)
    last = online_correction.matched(state, linear(slopes, mean), idle=online_correction.MEMORY)
    np.testing.assert_array_equal(last.factors, state.factors)
    np.testing.assert_allclose(last.information, prior + (state.information - prior) / np.e, rtol=1e-12)


def test_a_path_is_followed_in_straight_lines():
    path = Path(np.array([[0.0] * 6, [1.0] * 6, [3.0] * 6]), np.zeros((3, 6)), 0.004)
    for t, at in ((-1.0, 0.0), (0.002, 0.5), (0.006, 2.0), (0.009, 3.0)):
        np.testing.assert_allclose(path.at(t), at)


def test_the_swim_itself_has_no_jumps():
    steps = np.linalg.norm(np.diff(np.array(run(Made()).path)[:, :2], axis=0), axis=-1)
    assert steps.max() < 0.02 * 1.0  # 1 m/s


def test_a_solver_that_is_missing_or_fails_is_switched_off_and_the_fish_swims_on(capsys):
    class Gone:
        def stretch(self, *_):
            raise MissingExtra("warp-lang", "oracle", "the flow solver")

    for oracle, why in ((None, "there is no solver"), (Gone(), "the flow solver needs warp-lang")):
        hybrid = run(oracle)
        assert why in hybrid.off and capsys.readouterr().err.count("goes on by itself") == 1
        np.testing.assert_array_equal(hybrid.surrogate.q, swum(WRONG))


def test_a_solver_that_is_too_slow_is_switched_off_and_what_was_learnt_stays():
    oracle = Made()
    hybrid = run(oracle, patience=1e-9, own=0.01, first=1.0, every=1.0, span=0.3)
    assert "a stretch took" in hybrid.off and len(oracle.asked) == 2  # the first one sets it up
    assert hybrid.surrogate.water != WRONG
    with pytest.raises(ConfigError, match="within"):
        run(oracle, every=0.1, span=0.1)


def test_the_shorter_tail_is_another_water_on_the_same_body():
    short = hybrid_trial.shorter_tail(ROBOT)
    assert short._replace(strips=CHAIN.strips) == CHAIN and short.strips.mu[-1][0] < 0.95 * CHAIN.strips.mu[-1][0]
    assert short.strips.mu[:-1] == CHAIN.strips.mu[:-1]


def model_in(water):
    from dataclasses import replace

    return replace(unfitted(ROBOT), base=water)


class Tanks:
    """A pool: every segment is run in the strip water with the true coefficients."""

    def __init__(self):
        self.starts = {}

    def run(self, waiting, setup, go_on):
        for segment in waiting:
            self.starts[segment.id] = segment
            q, v = dagger.roll_out(ROBOT, model_in(TRUE), segment)
            names = ("id", "block", "episode", "split", "replicate_of")
            meta = {name: getattr(segment, name) for name in names} | setup.about | {"segment": segment.table()}
            meta["grid"] = meta["grid"] | {"slip": segment.slip}
            meta |= {"start": {"q": q[0].tolist(), "v": v[0].tolist()}, "tick": 0.02, "seconds": len(q) * 0.02, "stopped": ""}
            none = np.zeros((len(q), 4, 3))
            arrays = {"q": q, "v": v, "command": q[:, 3:], "wrench": none, "raw": none, "flow": none[..., :2]}
            yield Finished(segment, meta, arrays | {"power": np.ones(len(q))})


def test_the_trial_places_its_stretch_where_it_is_told(monkeypatch):
    """A swim of 6 s in the true water in the solver's place; its stretch begins after 2 s: 0.3 s led, 0.3 s free."""
    segment = hybrid_trial.episodes_of(ROBOT, SimpleNamespace(episodes=1, seconds=6.0, seed=1))[0]
    truth = SimpleNamespace(q=dagger.roll_out(ROBOT, model_in(TRUE), segment)[0], meta={"wall_s": 0.0})
    oracle, setup = Made(), Setup(domain=preset("laptop"), device="cpu")
    monkeypatch.setattr(hybrid_trial, "Solver", lambda *_, **__: oracle)
    monkeypatch.setattr(hybrid_trial, "transient", lambda *_: np.zeros(1))
    when = {"first": 2.0, "every": 20.0, "lead": 0.3, "span": 0.3}
    row = hybrid_trial._one(ROBOT, model_in(WRONG), setup, segment, truth, when, "none", 1e-3)
    assert oracle.asked == [(75, 15)] and row["stretches"][0]["t"] == pytest.approx(2.0) and row["covered"] == pytest.approx(0.1)
    assert row["after_m"] < 0.5 * row["before_m"] and row["before_m"] > 0.05


@pytest.mark.slow
def test_rounds_end_when_the_returns_agree(tmp_path):
    """Ten times the friction: the first round disagrees, the refit is used, the second agrees; the data grow by both."""
    pool, asked = Tanks(), []

    def refit(model, solver):
        asked.append(len(list((solver / "segments").glob("*.npz"))))
        return model_in(TRUE)

    slow = model_in(TRUE._replace(cf=30 * TRUE.cf, ke=0.1 * TRUE.ke))
    setup = Setup(domain=preset("laptop"), device="cpu")
    given = dict(refit=refit, episodes=1, seconds=6.0, pool=pool)
    found = dagger.correct("dob", ROBOT, slow, tmp_path / "data", setup, **given)
    assert found["agreed"] and len(found["rounds"]) == 2 and asked == [2]
    assert found["rounds"][0]["gap"] > dagger.AGREED > 1e-3 > found["rounds"][1]["gap"]
    whole, part = (pool.starts[name] for name in list(pool.starts)[:2])
    half = dagger.roll_out(ROBOT, slow, whole)
    np.testing.assert_allclose(part.velocity, half.v[len(half.v) // 2])
    assert part.pose != whole.pose and part.seconds == dagger.SHORT
    given |= {"refit": lambda *_: pytest.fail("a round that was done is refitted again"), "pool": None}
    again = dagger.correct("dob", ROBOT, slow, tmp_path / "data", setup, **given)
    assert again["rounds"] == found["rounds"] and again["model"].base == model_in(TRUE).base


def test_rounds_that_never_agree_say_so(tmp_path):
    slow = model_in(TRUE._replace(cf=30 * TRUE.cf, ke=0.1 * TRUE.ke))
    setup = Setup(domain=preset("laptop"), device="cpu")
    given = dict(refit=lambda model, solver: slow, episodes=1, seconds=6.0, rounds=1, pool=Tanks())
    found = dagger.correct("dob", ROBOT, slow, tmp_path, setup, **given)
    assert not found["agreed"] and len(found["rounds"]) == 1 and found["model"] is slow


def test_the_last_of_several_episodes_of_a_round_validates():
    splits = lambda n: [s.split for s in plan.on_policy(ROBOT, "dob", episodes=n, seconds=2.0, seed=1).segments]
    assert splits(1) == ["train"] and splits(3) == ["train", "train", "val"]


def test_the_return_is_that_of_the_task():
    """At the target at rest: the whole of wG; further off or with moving joints: less."""
    segment = plan.on_policy(ROBOT, "dob", episodes=1, seconds=2.0, seed=3).segments[0]
    q, v = np.zeros((20, 6)), np.zeros((20, 6))
    q[:, :2] = segment.drive["target"]
    best = dagger.mean_return(ROBOT, segment, q, v)
    assert best > dagger.mean_return(ROBOT, segment, q + 0.1, v) and best > dagger.mean_return(ROBOT, segment, q, v + 1.0)
