"""A water that the model does not know is fitted, checked, reported and corrected. Everything here is synthetic."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import hidden_water as hidden
import jax
import numpy as np
import pytest

from fishmj.base import calib, console
from fishmj.base.errors import ConfigError, DatasetError, UsageError
from fishmj.engines.hybrid import online_correction
from fishmj.hydro_fit import __main__ as verb
from fishmj.hydro_fit import free_swims
from fishmj.hydro_fit.campaign.dagger import dagger
from fishmj.hydro_fit.fit import (
    force_training,
    gauss_newton,
    linear_regression,
    prediction_interval,
    rollout_training,
    training_loop,
    training_windows,
)
from fishmj.hydro_fit.fit.fit_pipeline import STAGES, FitPipeline, FitSettings
from fishmj.hydro_fit.fit.incremental import Refit
from fishmj.hydro_fit.fit.regression_rows import rows_of
from fishmj.hydro_fit.fit.rollout import recorded
from fishmj.hydro_fit.fit.training_loop import Loop
from fishmj.hydro_fit.fit_report import check_rows
from fishmj.hydro_fit.segment_dataset import open_dataset, open_each
from fishmj.lbm_oracle.run.solver_water import BOUNDARIES
from fishmj.mjcf.reading import load_robot
from fishmj.water import residual_hooks, residual_network
from fishmj.water.dynamics import planar_chain
from fishmj.water.hydro_model import HydroModel, robot_hash
from fishmj.water.prior import flat, names_of, prior_of, unflat

ROBOT, CHAIN, TICK = hidden.ROBOT, hidden.CHAIN, hidden.TICK
SMALL = {"size": 0.34, "seconds": 5.0}  # one shape of every campaign: what makes it is compiled once
QUICK = FitSettings(steps=200, swim=40.0, swims=0)  # learning by swims is a slow test of its own
SMALLEST = replace(QUICK, steps=20, members=2, hidden=4)  # every stage, with a residual that is cheap to swim with


@pytest.fixture(scope="module")
def records():
    """Training, validation and test parts of one small campaign."""
    parts = {}
    for seed, split in enumerate(("train", "val", "test")):
        parts[split] = hidden.campaign(seed=seed, split=split, **SMALL)
    return parts


def fit_of(records, folder, settings):
    """(the fit, its model, the folder of its stages)."""
    fit = FitPipeline(ROBOT, records["train"], records["val"], dataset={"sha256": "made"}, settings=settings, folder=folder)
    return fit, fit.run(), folder


@pytest.fixture(scope="module")
def fitted(records, tmp_path_factory):
    """A fit of one round whose residual is as small as can be."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gauss_newton, "fit_rollout", partial(gauss_newton.fit_rollout, rounds=1))
        return fit_of(records, tmp_path_factory.mktemp("stages"), SMALLEST)


@pytest.fixture(scope="module")
def learnt(records, tmp_path_factory):
    """A fit whose residual has learnt from the forces; for slow tests."""
    return fit_of(records, tmp_path_factory.mktemp("learnt"), QUICK)


def test_coefficients_are_one_vector_with_names():
    c = planar_chain.nominal(ROBOT).water
    assert unflat(flat(c).tolist()) == c and len(names_of(4)) == len(flat(c))


def test_forces_of_the_strips_give_their_coefficients_back():
    """No hidden water, no noise: what is left is the 50 Hz of the record."""
    known = replace_stall(hidden.TRUE)
    robot = replace(ROBOT, water={**ROBOT.water, "stall_angle_deg": np.degrees(known.stall_angle), "stall_lag": known.stall_lag})
    made = hidden.campaign(hidden=0.0, noise=0.0, water=known, **SMALL)
    done = linear_regression.fit_linear(robot, CHAIN, rows_of(CHAIN, made), TICK, stall=False)
    for name, bound in (("k", 0.08), ("cn", 0.12)):
        np.testing.assert_allclose(getattr(done.water, name), getattr(known, name), rtol=bound)
    assert done.water.suction > 0.85
    drag = lambda c: c.cf * sum(map(sum, CHAIN.strips.p)) + c.ca_forward * CHAIN.strips.frontal
    assert drag(done.water) == pytest.approx(drag(known), rel=0.1)  # friction and form trade; their sum is told


def replace_stall(c):
    return c._replace(stall_angle=float(np.radians(35.0)), stall_lag=3.0)


@pytest.mark.part("fit")
def test_swims_decide_what_forces_leave_open(fitted):
    """The factors found by free swims bring the validation swims closer; what the data cannot tell is said."""
    fit, model, _ = fitted
    start = linear_regression.fit_linear(ROBOT, CHAIN, rows_of(CHAIN, fit.train), TICK)
    by_forces, by_swims = fit.score(flat(start.water), None), fit.score(model.alone[0], None)
    assert by_swims < 0.8 * by_forces
    assert {"linear", "rollout"} <= set(model.found)
    statuses = {row["status"] for row in model.found["rollout"]["parameters"].values()}
    assert statuses <= {"identified", "not identified", "on bound"} and "identified" in statuses


@pytest.mark.slow
def test_the_residual_learns_what_strips_cannot():
    """Normal forces on head and tail, from 170 s of water: wash and overshoot are found on episodes that were not trained on."""
    parts = {split: hidden.campaign(seed=seed, split=split, seconds=5.0) for seed, split in enumerate(("train", "test"))}
    water = linear_regression.fit_linear(ROBOT, CHAIN, rows_of(CHAIN, parts["train"]), TICK).water
    taught, seen = (training_windows.training_windows_of(CHAIN, parts[split], water) for split in ("train", "test"))
    net = force_training.learn(CHAIN, taught, residual_network.blank(CHAIN.n), steps=200).net

    def left(memory):
        z, _ = force_training.wakes(residual_network.without(net, memory=memory), seen.x, seen.speed, seen.step)
        force = np.asarray(force_training.forces(net, residual_network.panels(CHAIN), 1000.0, seen.x, seen.push, z)).mean(0)
        error = (seen.weight[:, None, None] * (force - seen.left) ** 2).sum((0, 3))
        return np.sqrt(error / (seen.weight[:, None, None] * np.asarray(seen.left) ** 2).sum((0, 3)))

    with_wake = left(True)
    assert with_wake[1, -1] < 0.85 and with_wake[1, 0] < 0.85
    assert with_wake[1].mean() < left(False)[1].mean()


def test_learning_that_is_broken_off_goes_on_to_the_same_bits(records, tmp_path):
    taught = training_windows.training_windows_of(CHAIN, records["train"], planar_chain.nominal(ROBOT).water)

    class Broken(Loop):
        def after(self, step, state):
            super().after(step, state)
            if step == 22:
                self.save()
                raise KeyboardInterrupt

    def learnt(loop):
        return force_training.learn(CHAIN, taught, residual_network.blank(CHAIN.n), steps=30, seed=3, loop=loop)

    with pytest.raises(KeyboardInterrupt):
        learnt(Broken(tmp_path / "loop", "key"))
    again, whole = learnt(Loop(tmp_path / "loop", "key")), learnt(None)
    assert [a.tobytes() for a in again.net] == [a.tobytes() for a in whole.net]
    np.testing.assert_array_equal(again.losses, whole.losses)


@pytest.mark.slow
def test_swims_teach_the_residual_what_forces_leave_open(learnt, records):
    """From the net that knows the forces: pieces of swims that were not trained on come closer."""
    fit, _, _ = learnt
    longer = FitPipeline(ROBOT, fit.train, fit.val, dataset={"sha256": "made"}, settings=replace(QUICK, swims=25))
    state = fit._read("residual")
    before, after = (residual_hooks.unpacked(given).net for given in (state, longer._swims(state)))
    water = unflat(fit._read("residual")["water"].tolist())
    seen = training_windows.training_windows_of(CHAIN, records["test"], water)
    apart = rollout_training.windows_of(CHAIN, ROBOT, records["test"], water)
    trainer = rollout_training.RolloutTrainer(
        ROBOT, fit.swim, apart, rollout_training.tethered_of(CHAIN, records["test"], water), seen, flat(water)
    )
    thrusts = lambda net: rollout_training.huber(trainer.thrust_errors(net, trainer.tethered))
    judge = jax.jit(
        lambda net: (trainer.swim_loss(net, trainer.pieces), thrusts(net)),
        compiler_options=training_loop.short_op_compiler_options("cpu"),
    )
    off, pushed = np.transpose([judge(net) for net in (before, after)])
    assert off[1] < 0.9 * off[0] and np.isfinite(pushed).all()
    rng, every = np.random.default_rng(0), set(trainer.tethered.recorded.tolist())
    drawn = [set(trainer.draw_tethered(rng, 2).recorded.tolist()) for _ in range(40)]
    assert {len(some) for some in drawn} == {min(2, len(every))} and set.union(*drawn) == every, "all of them in turn"


def test_a_piece_begins_with_the_wake_of_the_motion_before_it(records):
    """Features of the 1.2 s before the start; none where the record begins, and a wake that stays at rest there."""
    water = planar_chain.nominal(ROBOT).water
    made = rollout_training.windows_of(CHAIN, ROBOT, records["test"], water)
    first = np.array([a == 0 for _, a in made.fleet.source])
    assert first.any() and (~first).any()
    assert (made.speed[:, first] == 0).all() and (made.speed[-1, ~first] >= residual_network.FLOOR).all()
    net = residual_network.blank(CHAIN.n, seed=1)
    _, wake = force_training.wakes(net, made.x, made.speed, TICK)
    assert (np.asarray(wake)[:, first] == 0).all() and np.abs(np.asarray(wake)[:, ~first]).max() > 1e-3


def test_an_interrupted_fit_goes_on_where_it_was(fitted, records):
    fit, model, folder = fitted
    again = FitPipeline(ROBOT, records["train"], records["val"], dataset={"sha256": "made"}, settings=SMALLEST, folder=folder)
    for stage in STAGES:
        setattr(again, f"_{stage}", lambda state: pytest.fail("a stage that was done ran again"))
    again.score = lambda *_: model.scores["validation"]
    same = again.run()
    assert flat(same.base).tolist() == flat(model.base).tolist() and same.found == model.found
    other = FitPipeline(
        ROBOT, records["train"], records["val"], dataset={"sha256": "made"}, settings=replace(SMALLEST, seed=1), folder=folder
    )
    assert other._read("linear") is None  # another seed is another fit


@pytest.mark.slow
def test_a_fit_goes_on_from_a_model_with_more_swims(learnt, records, tmp_path, monkeypatch):
    """A water with half the thrust, fitted again: the swims of both parts of the validation come closer."""
    model = learnt[1].base_only
    worse = replace(model, base=model.base._replace(ke=0.5 * model.base.ke))
    given = {"dataset": {"sha256": "made"}, "folder": tmp_path}
    fit = Refit(ROBOT, worse, records["train"], (records["val"], records["test"][:4]), **given)
    better = fit.run()
    assert fit.score(flat(better.base), None) < 0.5 * fit.score(flat(worse.base), None)
    assert better.learnt is None and better.slip == model.slip
    same = Refit(ROBOT, worse, records["train"], (records["val"], records["test"][:4]), **given)
    monkeypatch.setattr(Refit, "_gauss_newton", lambda *_: pytest.fail("a stage that was finished is done again"))
    assert same.run().base == better.base
    with pytest.raises(pytest.fail.Exception):  # another model is another fit
        Refit(ROBOT, model, records["train"], (records["val"], records["test"][:4]), **given).run()


def test_training_records_validate_where_no_others_do(records, tmp_path):
    data = open_dataset(hidden.write_dataset(tmp_path / "set", records["train"]))
    train, val = verb.fitted_parts(data, ROBOT, 1.0)
    assert len(val) == len(train) // 4 and not {r.id for r in train} & {r.id for r in val}
    with pytest.raises(ConfigError, match="segments of another fish, 'swift' with another body"):
        verb.fitted_parts(data, replace(ROBOT, servo=replace(ROBOT.servo, range=0.8)), 1.0)


def test_further_data_of_the_same_water_are_fitted_beside_the_first(records, tmp_path, capsys):
    folder = hidden.write_dataset(tmp_path / "rounds", records["train"][:4])
    grid = open_dataset(folder)[records["train"][0].id].meta["grid"]
    train, val = verb.further_parts(open_dataset(folder), ROBOT, 1.0, grid)
    assert [r.id for r in train] == sorted(r.id for r in records["train"][:4]) and not val
    with pytest.raises(ConfigError, match="--also: .*, the rest in synthetic with boundary rims: two waters in one fit; name"):
        verb.further_parts(open_dataset(folder), ROBOT, 1.0, grid | {"boundary": "rims"})
    box = lambda domain: SimpleNamespace(domain=domain, sharpness=BOUNDARIES["plain"])
    dagger.warn_of_two_waters([open_dataset(folder)], box(grid["domain"]))
    assert capsys.readouterr().err == ""
    dagger.warn_of_two_waters([open_dataset(folder)], box("window"))
    assert f"was solved in {grid['domain']}, the rest in window: two waters in one fit" in capsys.readouterr().err
    (tmp_path / "link").symlink_to(folder)
    with pytest.raises(DatasetError, match="its swims would count twice"):
        open_each([folder, tmp_path / "link"])
    for other, why in ((tmp_path / "none", "no such folder"), (folder / "manifest.json", "it is a file")):
        with pytest.raises(DatasetError, match=why):
            open_dataset(other)


def test_a_better_model_is_never_overwritten(fitted, tmp_path):
    _, model, _ = fitted
    place, taken = verb.promote(model, tmp_path, score=1.0, standing=None)
    assert taken and HydroModel.load(place).band == model.band
    before = place.read_bytes()
    rejected, taken = verb.promote(replace(model, notes="worse"), tmp_path, score=2.0, standing=1.0)
    assert not taken and place.read_bytes() == before
    assert rejected.parent.name.startswith("rejected-") and HydroModel.load(rejected).notes == "worse"


@pytest.mark.slow
def test_the_verbs_fit_check_and_report_a_data_set(learnt, records, tmp_path, capsys):
    _, model, stages = learnt
    data = hidden.write_dataset(tmp_path / "set", [r for part in records.values() for r in part])
    assert len(open_dataset(data).names("train")) == len(records["train"])
    model.save(tmp_path)
    base = ["--data", str(data), "--out", str(tmp_path), "--json"]
    code = console.run(verb.main, ["check", *base])
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert code == (0 if found["ok"] else 1)
    assert set(found["figures"]) == {*free_swims.STATED, "coverage90"} and found["figures"]["speed_error_mean"] < 0.1
    assert found["figures"]["guard_rate"] < 0.05 and found["figures"]["power_error_mean"] < 0.1
    assert console.run(verb.main, ["report", *base]) == 0
    page = (tmp_path / "swift-report" / "report.html").read_text(encoding="utf-8")
    assert "flow solver" in page and page.count("data:image/png") == 3 and "not identified" in page
    assert json.loads((tmp_path / "swift-report" / "report.json").read_text())["forces"]


@pytest.mark.slow
def test_a_miss_is_exit_1(learnt, records, monkeypatch):
    """The tolerance is max(stated, twice the solver's own); a worse water misses it."""
    _, model, _ = learnt
    worse = replace(model, base=model.base._replace(ke=0.05, cf=0.1))
    repeats = [(r, r) for r in records["test"]]
    found = free_swims.judge(worse, ROBOT, records["test"], repeats)
    assert not found["ok"] and not found["passed"]["speed_error_mean"] and found["tolerances"]["speed_error_mean"] == 0.03
    assert found["repeatability"]["speed_error_mean"] == 0.0


def test_without_a_segment_no_factor_moves():
    state = online_correction.fresh()
    c = planar_chain.nominal(ROBOT).water
    assert flat(online_correction.applied(c, state.factors)).tolist() == flat(c).tolist()
    assert gauss_newton.scaled(flat(c), np.zeros(len(gauss_newton.groups(4))), 4, prior_of(ROBOT)).tolist() == flat(c).tolist()
    assert len(residual_hooks.at_rest()) == 18


def test_coverage_of_few_swims_cannot_be_told():
    """At a true 90 % all three swims lie inside seven times in ten, one of three once in 36; 130 of 160 hardly ever."""
    asked = {
        (3, 3): None,
        (2, 3): None,
        (1, 3): False,
        (9, 10): True,
        (10, 10): None,
        (145, 160): True,
        (130, 160): False,
        (158, 160): False,
    }
    assert {(k, n): free_swims.covers_as_stated(k / n, n) for k, n in asked} == asked
    figures = {"figures": {"coverage90": {"speed": 1.0, "power": 0.0}}, "tolerances": {"coverage90": [0.85, 0.95]}}
    rows = check_rows(figures | {"repeatability": {}, "n": {"coverage90": 3}, "passed": {"coverage90": False}})
    assert [row["passed"] for row in rows] == ["cannot tell", "no"]


def test_the_band_holds_nine_of_ten_swims_it_has_not_seen():
    """Errors that grow with the members' spread, and an offset: the parts come out and new draws are covered."""
    rng = np.random.default_rng(3)

    def drawn(count):
        spread, value = rng.gamma(2.0, 0.02, count), rng.uniform(-0.4, 0.4, count)
        error = np.hypot(0.01, 1.5 * spread) * rng.standard_normal(count)
        members = [prediction_interval.Means(*[value + sign * spread / np.sqrt(2)] * 3) for sign in (-1, 1)]
        return prediction_interval.Means(*[value] * 3), members, prediction_interval.Means(*[value + error] * 3)

    made = prediction_interval.fit_band(*drawn(400), np.arange(400) < 350)
    offset, share, spread = made["speed"]
    assert spread == pytest.approx(1.645 * 1.5, rel=0.2) and share < 0.1 and offset < 0.05
    assert all(0.87 < value < 0.93 for value in prediction_interval.covered(*drawn(4000), made).values())


def test_the_factors_of_members_are_found_again():
    water, links = flat(planar_chain.nominal(ROBOT).water), len(ROBOT.links)
    drawn = np.random.default_rng(1).normal(0, 0.1, (3, len(gauss_newton.groups(links))))
    members = [gauss_newton.scaled(water, row, links, prior_of(ROBOT)) for row in drawn]
    again = [gauss_newton.scaled(water, row, links, prior_of(ROBOT)) for row in gauss_newton.factors_of(water, members, links)]
    np.testing.assert_allclose(again, members, rtol=1e-12)
    assert np.ptp(members, axis=0).max() > 0.01 and gauss_newton.factors_of(water, [], links).shape == (0, drawn.shape[1])


def test_factors_that_are_not_taken_are_still_uncertain(monkeypatch):
    """Swims that hold the first factor fast and say nothing of the others, which keep the spread of the prior."""
    water = flat(planar_chain.nominal(ROBOT).water)
    fit = object.__new__(FitPipeline)
    vars(fit).update(
        robot=ROBOT, chain=planar_chain.chain_of(ROBOT), settings=FitSettings(members=400), notes=[], found={}, loop=Loop()
    )
    vars(fit).update(train=[], limits=prior_of(ROBOT), given=None)
    match = SimpleNamespace(residuals=lambda rows: 1.0 + 100.0 * (rows[:, :1] / water[0] - 1.0))
    scores = iter((1.0, 2.0))
    monkeypatch.setattr(FitPipeline, "_match", lambda self, records, learnt: match)
    monkeypatch.setattr(FitPipeline, "score", lambda self, water, learnt: next(scores))
    monkeypatch.setattr(FitPipeline, "_report", lambda self, *_, **figures: None)
    made = fit._gauss_newton({"water": water}, None, "rollout")
    assert (
        fit.notes == ["rollout: not taken, validation 1 -> 2"]
        and made["water"].tolist() == made["alone"].tolist() == water.tolist()
    )
    spread = made["factors"].std(0)
    assert spread[0] == pytest.approx(0.01, rel=0.15) and np.allclose(spread[1:], gauss_newton.SPREAD, rtol=0.15)


def test_a_refit_begins_with_the_members_of_its_model():
    model = HydroModel.load("swift")
    again = object.__new__(Refit)
    vars(again).update(model=model, chain=planar_chain.chain_of(ROBOT))
    state = again._first()
    made = [gauss_newton.scaled(flat(model.base), row, len(ROBOT.links), prior_of(ROBOT)) for row in state["factors"]]
    np.testing.assert_allclose(made, model.members, rtol=1e-5)


def test_a_refit_fades_its_residual_by_the_disagreement_of_its_own_members(records):
    """With that of the members before it, a refit whose members differ more was halved everywhere, and not taken."""
    model = HydroModel.load("swift")
    before, made = model.learnt.reach, []
    held = {"chain": planar_chain.chain_of(ROBOT), "force_records": records["train"][:2], "tick": records["train"][0].tick}
    net = model.learnt.net._replace(outer=3.0 * model.learnt.net.outer)
    for kind in (FitPipeline, Refit):
        fit = object.__new__(kind)
        vars(fit).update(held, model=model, notes=[], score=lambda *_: 1.0)
        made.append(fit._with_range(net, flat(model.base)).reach)
    assert made[1].spread == made[0].spread and made[1].spread > 1.5 * before.spread
    assert (made[1].limit >= before.limit).all() and (made[1].speed >= before.speed).all()


def test_members_that_are_equal_but_for_round_off_add_nothing_to_the_error_bar():
    rng = np.random.default_rng(0)
    value = rng.uniform(0.1, 0.4, 60)
    of = lambda a: prediction_interval.Means(*[a] * 3)
    members = [of(value * (1 + 1e-16 * k)) for k in range(4)]
    made = prediction_interval.fit_band(of(value), members, of(value + rng.normal(0, 0.02, 60)), np.arange(60) < 50)
    for offset, share, spread in made.values():
        assert spread == 0.0 and 0.0 < offset < 0.1 and share < 1.0


@pytest.mark.slow
def test_fresh_swims_make_a_band_of_any_width_hold_nine_of_ten(learnt, records, monkeypatch):
    _, model, _ = learnt
    narrow = replace(model, band={name: [0.1 * part for part in parts] for name, parts in model.band.items()})
    monkeypatch.setattr(prediction_interval, "FEWEST", 5)
    made = prediction_interval.calibrated(narrow, ROBOT, records["test"], {"sha256": "fresh"})
    swum = free_swims.FreeSwims(made, ROBOT, records["test"])
    seen, mean = prediction_interval.means(recorded(swum.fleet), swum.fleet), prediction_interval.means(swum.track, swum.fleet)
    hair = {name: [(1 + 1e-6) * part for part in parts] for name, parts in made.band.items()}  # the last one is at the edge
    inside = prediction_interval.covered(mean, swum.members, seen, hair)
    assert all(value >= 0.9 for value in inside.values()) and made.calibration["swims"] == len(swum.fleet.q)
    for name in prediction_interval.CHANNELS:  # one factor a channel: its form stays
        np.testing.assert_allclose(
            np.divide(made.band[name], max(made.band[name])), np.divide(model.band[name], max(model.band[name]))
        )
    with pytest.raises(DatasetError, match="fitted to"):
        prediction_interval.calibrated(model, ROBOT, records["test"], {"sha256": model.dataset["sha256"], "folder": "made"})
    monkeypatch.setattr(prediction_interval, "FEWEST", 1000)
    with pytest.raises(DatasetError, match="expected 1000 or more"):
        prediction_interval.calibrated(model, ROBOT, records["test"], {"sha256": "fresh"})


def test_the_conformal_factor_is_right_on_average_for_few_swims():
    rng = np.random.default_rng(5)
    inside = [
        np.mean(np.abs(rng.standard_cauchy(500)) <= prediction_interval.conformal(np.abs(rng.standard_cauchy(39))))
        for _ in range(400)
    ]
    assert np.mean(inside) == pytest.approx(0.9, abs=0.01)


def test_training_swims_that_are_easier_than_others_do_not_narrow_the_band():
    rng, trained = np.random.default_rng(4), np.arange(100) < 80
    needed = np.abs(rng.standard_normal(100))
    assert prediction_interval.easier(needed, trained) == 1.0
    assert prediction_interval.easier(np.where(trained, 0.3 * needed, needed), trained) > 2.0


def test_fit_lets_xla_fuse_operations_unless_xla_flags_say_otherwise():
    """In processes of their own: what JAX reads when it begins."""
    program = (
        "from fishmj.hydro_fit.fit.training_loop import use_cores_as_devices; use_cores_as_devices()\n"
        "import jax, jax.numpy as jnp\n"
        "both = lambda x: ((y := jnp.sin(x) * 2) + 1, y * jnp.cos(x), jnp.sum(y))\n"
        "print(jax.jit(both).lower(jnp.ones(1000)).compile().as_text().count(' fusion('))\n"
    )

    def fusions(flags):
        env = os.environ | {"XLA_FLAGS": flags}
        return int(subprocess.run([sys.executable, "-c", program], env=env, check=True, capture_output=True, text=True).stdout)

    assert fusions("") < fusions("--xla_backend_extra_options=xla_cpu_optimize_for_size")


def test_a_negative_number_of_steps_is_refused_before_anything_is_read():
    with pytest.raises(UsageError, match=r"--swims: got '-1', expected a whole number from 0"):
        verb.main(["fit", "--swims", "-1"])


def test_shipped_water_is_judged_with_a_note_where_none_is_fitted(tmp_path, monkeypatch, capsys):
    args = verb.options("check").parse_args([])
    verb.chosen(fish := load_robot("fish"), args)
    assert not capsys.readouterr().out
    monkeypatch.setattr(verb, "FOLDERS", (tmp_path, *verb.FOLDERS))
    assert verb.chosen(fish, args).name == "swift"
    assert f"no fitted water in {tmp_path}: using the shipped" in capsys.readouterr().out


def test_damaged_water_is_replaced_by_the_next_fit(tmp_path, capsys):
    fish = load_robot("fish")
    weights = HydroModel.load("swift").save(tmp_path).with_suffix(".safetensors")
    assert verb.standing_model(tmp_path, "swift", robot_hash(fish)) is not None
    weights.write_bytes(weights.read_bytes()[:-4] + b"0000")
    assert verb.standing_model(tmp_path, "swift", robot_hash(fish)) is None
    assert "cannot be compared and will be replaced" in capsys.readouterr().err


@pytest.mark.parametrize("name", [name for name in calib.waters() if name != "tendon_fish"])
def test_check_takes_test_swims_of_the_models_own_water(name):
    """Shipped segments are of three slip ratios in one box; a water of another is not compared with them in silence."""
    model, data = HydroModel.load(name), open_dataset(verb.SHIPPED[0], test=True)
    own = {(1.0, "window_coarse"), (0.95, "window_coarse"), (0.0, "window_coarse")}
    if (model.slip, model.dataset["grid"]) in own:
        assert verb.of_its_water(model, [data], None) == [data]
    else:
        told = f"{name} was fitted at slip {model.slip:g} .* fishmj hydro_fit collect .*--data runs/{name}-test"
        with pytest.raises(DatasetError, match=told):
            verb.of_its_water(model, [data], None)
        assert verb.of_its_water(model, [data], 0.95) == [data]  # another water on purpose
