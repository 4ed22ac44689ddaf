"""The model-based baselines and the tuner of gains, against known answers."""

import warnings

import numpy as np
import pytest

from fishmj import control
from fishmj.base import console
from fishmj.base.calib import calib_folder
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.control import koopman
from fishmj.control.observer import FlowEstimate, forward
from fishmj.evaluate import tune_gains
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import in_water

ROBOT = load_robot("fish")


def test_edmd_recovers_a_linear_system():
    rng = np.random.default_rng(0)
    a, b = 0.4 * rng.normal(size=(4, 4)), rng.normal(size=(4, 2))
    x, u = rng.normal(size=(200, 4)), rng.normal(size=(200, 2))
    found = koopman.edmd(x, u, x @ a.T + u @ b.T)
    assert found[0] == pytest.approx(a, abs=1e-6) and found[1] == pytest.approx(b, abs=1e-6)


def test_the_regulator_of_an_integrator_is_the_golden_ratio():
    """x+ = x + u with unit weights: P^2 = P + 1."""
    one = np.eye(1)
    gain, p = koopman.lqr(one, one, one, one)
    golden = (1 + np.sqrt(5)) / 2
    assert (gain[0, 0], p[0, 0]) == pytest.approx((1 / golden, golden))


def test_a_model_that_nothing_controls_has_no_regulator():
    with pytest.raises(ConfigError, match="Riccati"):
        koopman.lqr(2 * np.eye(1), np.zeros((1, 1)), np.eye(1), np.eye(1))


@pytest.fixture(scope="module")
def brain():
    return control.make("koopman-rls", ROBOT, prior=0.01)


def test_the_koopman_model_knows_what_speed_and_bias_do(brain):
    """Swims of the surrogate: its model predicts the next surge and turn, and a positive bias turns to the right."""
    z = np.linalg.solve(np.eye(11) - brain.model.rows[1:, :11], brain.model.rows[1:, 11:])
    assert z[0, 0] > 0.2, "drive swims forward"
    assert z[2, 1] < -0.5, "bias turns to the right"


def test_the_regulator_knows_its_recursion(brain):
    """The Riccati recursion of the adaptive regulator stays at SciPy's solution while the model stays."""
    a, b = koopman.of_state(brain.model.rows, brain.p)
    gain, p = brain.first
    assert np.linalg.solve(brain.r + b.T @ p @ b, b.T @ p @ a) == pytest.approx(gain)
    assert brain.q + a.T @ p @ (a - b @ gain) == pytest.approx(p, rel=1e-6, abs=1e-6)
    assert np.abs(np.linalg.eigvals(a - b @ gain)).max() < 1


def test_recursive_least_squares_finds_another_fish(brain):
    """A fish that turns half as well: after a minute its model is known, and the other fish keeps the model of the swims."""
    brain.reset(2)
    rng, truth = np.random.default_rng(0), brain.model.rows.copy()
    truth[0, 12] *= 0.5
    z, heading = rng.normal(0, 0.2, (2, 11)), np.zeros(2)
    for _ in range(300):
        u = rng.normal(0, 0.3, (2, 2))
        brain.before = z, u, heading
        both = np.concatenate([z, u], 1)
        result = np.stack([brain.model.rows @ both[0], truth @ both[1]])
        heading, z = heading + result[:, 0], result[:, 1:] + rng.normal(0, 0.2, (2, 11))
        brain._adapt(result[:, 1:], heading)
    assert brain.rows[0] == pytest.approx(brain.model.rows, abs=1e-6)
    assert brain.rows[1, 0, 12] == pytest.approx(truth[0, 12], rel=0.05)
    assert not np.allclose(brain.gain[1], brain.gain[0], rtol=0.05)


def test_the_flow_estimate_converges_and_starts_fast():
    estimate = FlowEstimate(2.0, 0.2)
    estimate.reset(1)
    truth = np.array([[-0.2, 0.1]])
    assert estimate(truth, np.zeros((1, 2))) == pytest.approx(truth), "the first rest is believed"
    for _ in range(60):
        flow = estimate(2 * truth, np.zeros((1, 2)))
    assert flow == pytest.approx(2 * truth, rel=0.01)


@pytest.mark.parametrize(("name", "stream"), [("mpc", 0.0), ("mpc-flow", 0.15)])
def test_mpc_reaches_the_target_in_its_own_model(name, stream):
    """The plant is the averaged model itself, met through exact observations that are not late."""
    brain = control.make(name, ROBOT, ahead=0.01)
    brain.navigator.pose_age = brain.navigator.rate_age = 0.0
    brain.reset(2)
    model, flow = brain.model, np.array([[-stream, 0.0]] * 2)
    place, psi, w = np.zeros((2, 2)), np.zeros(2), np.zeros(2)
    target, nearest, turn = np.array([[1.0, 0.0], [0.7, 0.7]]), np.full(2, np.inf), np.zeros(2)
    for _ in range(100):
        c, s = np.cos(psi), np.sin(psi)
        body = lambda v, c=c, s=s: np.stack([c * v[:, 0] + s * v[:, 1], c * v[:, 1] - s * v[:, 0]], -1)
        obs = np.concatenate([body(target - place), body(forward(w, psi) + flow), turn[:, None], np.zeros((2, 6))], 1)
        brain(obs)
        steady = model.speed(np.stack([brain.cpg.frequency, brain.cpg.amplitude, brain.cpg.bias], -1).clip(model.low, model.high))
        turn = model.turn * brain.cpg.bias * steady
        psi, w = psi + 0.2 * turn, w + 0.2 * (steady**2 - w**2) / model.glide
        place = place + 0.2 * (forward(w, psi) + flow)
        nearest = np.minimum(nearest, np.linalg.norm(target - place, axis=-1))
    assert np.all(nearest < 0.1)
    if stream:
        assert np.all(np.linalg.norm(target - place, axis=-1) < 0.3), "and stays"


def test_a_straight_plan_swims_at_the_measured_speed():
    model = control.make("mpc", ROBOT).model
    control_of = np.array([model.high[0], model.high[1], 0.0])
    steady = float(model.speed(control_of))
    x, y = model.path(np.full(1, steady), np.full(1, np.pi / 2), np.array([[0.1, 0.0]]), np.tile(control_of, (1, 1, 12, 1)))
    time = 12 * model.step
    assert (x[0, 0, -1], y[0, 0, -1]) == pytest.approx((0.1 * time, steady * time))


@pytest.fixture
def bowl(monkeypatch):
    """Score with its minimum where every gain is 1.5 times its first value."""
    calls = []

    def score(search, point, robot, engine, *sets):
        calls.append(len(sets))
        return float(np.sum((point - search.point() - np.log(1.5)) ** 2))

    monkeypatch.setattr(tune_gains, "score", score)
    return calls


def tuned(search, kept=None, budget=640):
    with console.Progress(budget, "test") as bar:
        return tune_gains.tune(search, ROBOT, budget, 0, kept, bar)


def test_the_tuner_finds_the_minimum(bowl):
    search = tune_gains.GainSearch.of("pnl", None)
    found = tuned(search)
    assert found.score < 0.02 < found.first_score and found.candidates == 640
    for key, value in search.first.items():
        assert found.gains[key] == pytest.approx(1.5 * np.asarray(value), rel=0.1), key


def test_an_interrupted_tuning_continues_to_the_same_gains(bowl, tmp_path, monkeypatch):
    search, kept = tune_gains.GainSearch.of("pnl", None), tmp_path / "kept.json"
    whole = tuned(search, budget=96)
    count, score = len(bowl), tune_gains.score

    def stops(*args):
        if len(bowl) == count + 40:
            raise KeyboardInterrupt
        return score(*args)

    monkeypatch.setattr(tune_gains, "score", stops)
    with pytest.raises(KeyboardInterrupt):
        tuned(search, kept, budget=96)
    monkeypatch.setattr(tune_gains, "score", score)
    before = len(bowl)
    assert tuned(search, kept, budget=96) == whole
    assert len(bowl) - before == 96 - 32 + 2, "two generations were kept"


def test_worse_gains_are_not_kept(monkeypatch):
    monkeypatch.setattr(tune_gains, "score", lambda search, point, *rest: float(np.sum((point - search.point()) ** 2)))
    search = tune_gains.GainSearch.of("pnl", None)
    found = tuned(search, budget=16)
    assert found.gains == search.first and found.score == found.first_score == 0.0


def test_a_file_of_gains_steers_and_names_its_mistakes(tmp_path):
    file = tmp_path / "mine.toml"
    text = tune_gains.with_gains('schema = "fishmj.controllers/1"\n', "pi", {"position": 0.25}, "tuned: here")
    text = tune_gains.with_gains(text, "pd", {"position": 0.75}, "tuned: here")
    file.write_text(tune_gains.with_gains(text, "pi", {"position": 0.5}, "tuned: again"))
    mine, other = (control.chosen(f"{file}:{name}", ROBOT) for name in ("pi", "pd"))
    assert (mine.k["position"], other.k["position"]) == (0.5, 0.75)
    assert mine.k["integral"] == control.make("pi", ROBOT).k["integral"]
    assert mine.name == "pi" and mine.sha256 != other.sha256
    both = control.several([f"{file}:pi", "pi", f"{file}:pd"], ROBOT)
    assert [getattr(one, "notes", ()) for one in both] == [(f"pi is {file}:pi",), ("pi-2 is pi",), ()]
    with pytest.raises(ConfigError, match=r"no section \[dob\]"):
        control.make(f"{file}:dob", ROBOT)
    with pytest.raises(UnknownName, match="pii"):
        control.make(f"{file}:pii", ROBOT)
    file.write_text('[pi]\nfrequency = { value = 1.0, unit = "1/s", source = "tuned: x" }\n')
    with pytest.raises(ConfigError, match=r"gain frequency of pi: got 1.0, expected a value such as \["):
        control.make(f"{file}:pi", ROBOT)


@pytest.mark.parametrize(
    ("gain", "value", "expected"),
    [
        ("heading", float("nan"), "a number from 0 to 50 1/s"), ("observer_time", 0.0, "a number above 0 to 1000 s"),
        ("frequency", [-1.0, 2.0], "a number above 0 to 50 1/s"), ("amplitude_deg", [5.0, 1e6], "a number above 0 to 1500 deg"),
    ],
)  # fmt: skip
def test_gains_out_of_range_are_refused(gain, value, expected):
    with pytest.raises(ConfigError, match=f"gain {gain} of dob: got .*, expected {expected}$"):
        control.gains_of("dob", {gain: value})
    with pytest.raises(ConfigError, match="gain samples of mpc: got 2.5, expected a whole number from 2 to 10000$"):
        control.gains_of("mpc", {"samples": 2.5})


def test_every_shipped_gain_may_be_searched_by_the_tuner():
    for name in control.tuned_names():
        search = tune_gains.GainSearch.of(name, None)
        for point in search.reach().T:
            control.gains_of(name, search.gains(point))


def test_warnings_of_candidates_do_not_stand_amid_the_tuning(bowl, tmp_path, capsys, monkeypatch):
    plain = tune_gains.score
    monkeypatch.setattr(tune_gains, "score", lambda *given: (console.warn("a beat is too fast"), plain(*given))[1])
    words = ["pnl", "--budget", "32", "--water", "structured", "--out", str(tmp_path / "gains.toml")]
    assert tune_gains.main(words) == console.OK
    said = capsys.readouterr().err.splitlines()
    assert said.count("fishmj: a beat is too fast") == 1 and "100 %" in said[-2] and said[-1].endswith("too fast")


def test_the_tuner_says_where_it_found_nothing_better(tmp_path, capsys, monkeypatch):
    """Gains that were kept were written as those of the last search, with its budget for their source."""
    monkeypatch.setattr(tune_gains, "score", lambda *_: 1.0)
    words = ["pnl", "--budget", "16", "--water", "structured", "--out", str(tmp_path / "gains.toml")]
    assert tune_gains.main(words) == console.OK and "1.000 now" in (said := capsys.readouterr().out)
    assert tune_gains.KEPT in said and "--seed 0; no candidate was better" in (tmp_path / "gains.toml").read_text()
    assert tune_gains.main(words) == console.OK and "was tuned by this command before" in capsys.readouterr().err


def test_the_tuner_writes_gains_that_are_read(bowl, tmp_path, capsys):
    file = tmp_path / "gains.toml"
    assert tune_gains.main(["pnl", "--budget", "16", "--water", "structured", "--out", str(file)]) == console.OK
    assert f"{file}:pnl" in capsys.readouterr().out and list(tmp_path.iterdir()) == [file]
    assert control.make(f"{file}:pnl", in_water(ROBOT, "structured")).name == "pnl"
    assert "tuned: fishmj tune pnl --water structured --budget 16 --seed 0" in file.read_text()
    before, text = len(bowl), file.read_text()
    assert tune_gains.main(["pnl", "--budget", "16", "--water", "structured", "--out", str(file)]) == console.OK
    assert len(bowl) == before and file.read_text() == text, "an interrupted command goes on with the controllers that are left"
    own, fish = tmp_path / "my fish.toml", (calib_folder() / "fish.toml").read_text(encoding="utf-8")
    own.write_text(fish.replace('name = "swift"', 'name = "other"'), encoding="utf-8")
    assert (
        tune_gains.main(["pnl", "--budget", "16", "--water", "structured", "--robot", str(own), "--out", str(file)]) == console.OK
    )
    assert len(bowl) > before and "--seed 0, of robot other (" in file.read_text(), "gains of another fish are not these"
    assert f"fishmj evaluate {file}:pnl --robot '{own}' --water structured" in capsys.readouterr().out


def test_the_score_of_gains_that_cannot_be_is_a_bound():
    search, drawn = tune_gains.GainSearch.of("koopman", None), tune_gains.tuning_trials(0, gust=True)
    with np.errstate(all="ignore"), warnings.catch_warnings(action="ignore"):
        assert tune_gains.score(search, search.point() + 300.0, ROBOT, "compiled", drawn) == tune_gains.LOST
