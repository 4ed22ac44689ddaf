"""The flow solver as a family of the benchmark: what is planned, what of it shows, which data sets are made and scored."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba")

from fishmj.base import console
from fishmj.base.calib import calib_folder
from fishmj.base.errors import ConfigError, StoreError
from fishmj.gap.bench import bench_command, calibrated, families, family_command, family_score, solver_sets
from fishmj.gap.bench.bench_rows import read_rows
from fishmj.gap.bench.cases import KINDS
from fishmj.gap.bench.solver_plan import PLAN, PlanSettings, read
from fishmj.gap.records.records import record_of
from fishmj.gap.search.healthy_swims import HealthySwims
from fishmj.hydro_fit.record import KICK
from fishmj.log import Trial, excitation
from fishmj.log.dataset import read_bundle
from fishmj.log.excitation import Excitation
from fishmj.mjcf.reading import load_robot
from studies.solver_family import __main__ as verb
from studies.solver_family import family_plan, launches, solver_detectability, swims


@pytest.fixture
def seen_by_all(monkeypatch):
    """A forecast by which everything shows."""
    monkeypatch.setattr(families, "detectable", lambda *given: {"all": 9.0})


# ------------------------------------------------------------ what is planned
def test_a_plan_is_its_seed_and_its_folder(tmp_path, seen_by_all):
    asked = PlanSettings({"fish": "fish", "tendon_fish": "tendon_fish"}, robots=3, seed=4)
    made = family_plan.planned(asked)
    assert family_plan.planned(asked).robots == made.robots
    assert family_plan.planned(replace(asked, seed=5)).robots[0].cases[1].effects != made.robots[0].cases[1].effects
    family_plan.write(made, tmp_path)
    assert read(tmp_path).robots == made.robots and set(read(tmp_path).descriptions) == set(asked.models)
    assert len({one.seed for one in made.robots}) == 6 and len({case.id for one in made.robots for case in one.cases}) == 20
    kinds = [[case.kind for case in one.cases] for one in made.robots if one.model == "fish"]
    assert kinds == [["none", "single", "single"], ["none", "single", "single", "off"], ["none", "single", "single"]]


def test_half_of_the_healthy_robots_swim_each_experiment(seen_by_all):
    made = family_plan.planned(PlanSettings({"fish": "fish"}, robots=8)).robots
    swum = [name for one in made for name in one.experiments]
    assert {swum.count(name) for name in excitation.DESIGNED} == {4} and all(len(one.experiments) == 6 for one in made)
    assert made[0].experiments == made[2].experiments and not set(made[0].experiments) & set(made[1].experiments)


def test_what_nobody_could_see_is_drawn_again(monkeypatch):
    told = iter([0.1, family_plan.LIKELY - 0.1, 7.0, 0.2] + [0.3] * 20)
    monkeypatch.setattr(families, "detectable", lambda *given: {"all": next(told)})
    one = family_plan.planned(PlanSettings({"fish": "fish"}, robots=1)).robots[0]
    assert one.forecasts[:2] == (None, 7.0) and one.forecasts[2] < family_plan.LIKELY  # after `DRAWS` of them it stays as it is
    assert len(list(told)) == 24 - 3 - family_plan.DRAWS


def test_a_description_that_is_a_file_goes_with_the_plan(tmp_path, seen_by_all):
    own = tmp_path / "mine.toml"
    own.write_text((calib_folder() / "tendon_fish.toml").read_text())
    family_plan.write(family_plan.planned(PlanSettings({"mine": str(own)}, robots=1)), tmp_path / "out")
    own.unlink()
    assert read(tmp_path / "out").descriptions["mine"].n_joints == load_robot("tendon_fish").n_joints
    (tmp_path / "none").mkdir()
    (tmp_path / "none" / PLAN).write_text("{}")
    with pytest.raises(StoreError, match="expected 'fishmj.solver_family/1'"):
        read(tmp_path / "none")


# ------------------------------------------------------------ what is swum
@pytest.fixture(scope="module")
def small():
    """Two robots of one model, a single each, and a fault outside the catalogue in the second."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(families, "detectable", lambda *given: {"all": 9.0})
        return family_plan.planned(
            PlanSettings({"fish": "fish"}, robots=5, singles=1, seed=2, seconds=1.5, calibration=3.0, domain="laptop")
        )


def test_processes_share_all_swims_and_finish_the_same_robots_first(small):
    whole, parts = swims.all_swims(small), [swims.all_swims(small, (i, 3)) for i in range(3)]
    names = lambda some: {(one.set, one.job.name) for one in some}
    assert len(names(whole)) == len(whole) == sum(map(len, parts)) and set.union(*map(names, parts)) == names(whole)
    assert all(part[0].set == f"{small.robots[0].id}-free" for part in parts)
    off = [
        one.set for one in whole if one.set in {case.id for robot in small.robots for case in robot.cases if case.kind == "off"}
    ]
    assert len(off) == 12 and [one.set for one in whole][-12:] == off  # last, for they may be left out


def test_solver_swims_share_their_placing_and_draw_their_own_sensor_noise(small):
    gait = [one for one in swims.all_swims(small) if one.job.what.id == small.robots[0].experiments[0]]
    assert len({(one.job.index, one.job.placing) for one in gait}) == 1 and len({one.job.seed for one in gait}) > 1
    mine = [one.draw for one in swims.all_swims(small) if one.set.startswith(small.robots[0].id)]
    assert len(set(mine)) == len(mine) == 10 + 2 * 6
    assert {one.job.what.seconds for one in gait} == {1.5}
    free = [one for one in swims.all_swims(small) if one.set == f"{small.robots[0].id}-free"]
    assert [one.job.what.id for one in free] == [run.id for run in families.runs_of(calibrated.SWIMS, load_robot("fish"))]


class Done:
    """A run of the solver that the second robot swam."""

    def __init__(self, job):
        self.job = job

    def trial(self, noise: float, draw: int) -> Trial:
        """As its sensors saw it."""
        from fishmj.gap.laboratory.virtual_robot.trials import trial_of

        job = self.job
        return trial_of(job.made, job.what, job.seed, draw, noise, job.name, "", (0.0, 0.0))


def emptied(waiting):
    while waiting:
        yield waiting.popleft()


@pytest.fixture(scope="module")
def sets(small, tmp_path_factory):
    """Folder of its data sets, as the second robot swam them; one swim of the last robot is missing."""
    folder = tmp_path_factory.mktemp("solver")
    family_plan.write(small, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(swims, "run_jobs", lambda waiting, device, tanks: map(Done, emptied(waiting)))
        seen = lambda run, noise=1.0, draw=0: run.trial(noise, draw)
        patch.setattr(swims, "trial_of", seen)
        assert swims.swum_all(small, folder, "cpu") == sum(one.job.steps for one in swims.all_swims(small))
        next(folder.glob(f"swims/{small.robots[-1].cases[0].id}/*.npz")).unlink()
    assert verb.main(["--finish", "--out", str(folder)]) == console.FAILED_CHECK  # not all of them
    return folder


def test_what_was_swum_is_not_swum_again(small, sets, monkeypatch):
    asked = []
    monkeypatch.setattr(swims, "run_jobs", lambda waiting, device, tanks: asked.extend(emptied(waiting)) or ())
    swims.swum_all(small, sets, "cpu")
    assert len(asked) == 1


def test_robots_that_are_complete_are_data_sets(small, sets):
    found = solver_sets.robots(sets, KINDS)
    assert [one.id for one in found] == [one.id for one in small.robots[:-1]]  # the last lacks a swim
    assert [case.kind for case in found[1].cases] == ["none", "single", "off"] and not any(one.drawn for one in found)
    case = found[0].cases[0]
    trials = read_bundle(sets / "sets" / f"{case.id}.npz")
    assert [str(trial.value("excitation")) for trial in trials] == list(case.logs)
    assert len(read_bundle(sets / "sets" / f"{found[0].id}-free.npz")) == len(calibrated.SWIMS)
    truth = json.loads((sets / "truth.json").read_text())["cases"]
    assert truth[case.id]["detectable"]["all"] == 0.0
    single = truth[found[0].cases[1].id]
    assert single["detectable"]["healthy"] == 2 and 0.0 < single["detectable"]["all"] <= single["detectable"]["noise_only"]
    assert [one.id for one in solver_sets.robots(sets, {"off": 1.0})] == [small.robots[1].id, small.robots[3].id]
    assert sum(len(one.cases) for one in solver_sets.robots(sets, KINDS, 3)) == 3


# ------------------------------------------------------------ launches
LATE = 0.065  # s, of the camera


def coasting(push=(0.35, 0.1, 0.0), noise=0.0, seed=1) -> Trial:
    """A fish that slows down for 3 s, as a camera sees it that is `LATE`; joints still."""
    t = np.arange(0.0, 3.0, 0.02)
    gone = np.maximum(t - LATE, 0.0)
    far = (gone - 0.1 * gone**2) * np.array(push)[:, None]
    seen = far + noise * np.random.default_rng(seed).standard_normal(far.shape)
    tables = {
        "cmd": {"t": t, "c1": 0 * t},
        "joint": {"t": t, "j1": 0 * t},
        "pose": {"t": t, "x": seen[0], "y": seen[1], "yaw": seen[2]},
    }
    sigma = {"x": noise, "y": noise, "yaw": noise}
    return Trial({"push": list(push), "start": [0.0, 0.0, 0.0], "sigma": sigma}, tables, name="tow")


def test_a_launch_begins_after_its_first_moments_with_the_velocity_of_then():
    whole = coasting(push=(0.35, 0.0, 0.0))
    part = launches.steadied(whole, LATE)
    assert part.table("cmd")["t"][0] == part.table("joint")["t"][0] == pytest.approx(KICK)
    assert part.meta["push"] == pytest.approx([0.35 * (1 - 0.2 * KICK), 0.0, 0.0], abs=1e-9)
    record = record_of(part, 0.004)
    where = 0.35 * (KICK - 0.1 * KICK**2)
    assert record.start[0] == pytest.approx(where, abs=3e-3) and record.seconds == pytest.approx(2.98 - KICK)
    assert launches.steadied(part, LATE) is part  # once


def test_the_velocity_is_in_the_axes_of_the_fish():
    turned = coasting(push=(0.0, 0.3, 0.0))
    turned.tables["pose"]["yaw"] = np.full_like(turned.tables["pose"]["t"], np.pi / 2)
    assert launches.steadied(turned, LATE).meta["push"] == pytest.approx([0.3 * (1 - 0.2 * KICK), 0.0, 0.0], abs=1e-9)


def test_a_velocity_that_is_read_off_the_camera_says_how_wrong_it_may_be():
    bare = launches.steadied(coasting(noise=0.002), LATE, coasting()).meta
    tries = [launches.steadied(coasting(noise=0.002, seed=seed), LATE).meta for seed in range(60)]
    sigma = tries[0]["push_sigma"]
    assert "push_sigma" not in bare and np.std([one["push"] for one in tries], axis=0) == pytest.approx(sigma, rel=0.3)
    assert record_of(launches.steadied(coasting(noise=0.002), LATE), 0.004).push_sigma == tuple(sigma)


def test_a_fish_at_rest_keeps_its_beginning():
    still = coasting(push=(0.0, 0.0, 0.0))
    assert launches.steadied(still, LATE) is still


# ------------------------------------------------------------ how much shows
def seen(x, end=2.0, power=3.0) -> Trial:
    """A swim of one joint: x is how far ahead the fish is [m]."""
    t = np.arange(0.0, end, 0.02)
    flat = np.zeros_like(t)
    tables = {"joint": {"t": t, "j1": flat}, "pose": {"t": t, "x": flat + x, "y": flat, "yaw": flat}}
    return Trial({}, tables | {"power": {"t": t, "V": flat + 1.0, "I": flat + power}}, name="gait")


SIGMA = {"j1": 0.002, "x": 0.002, "y": 0.002, "yaw": 0.01, "V": 0.01, "I": 0.02}


def shown(hidden, plain, healthy) -> dict:
    drag = {"quadratic_drag": {"coefficient": 1.0}}
    return solver_detectability.detectable(drag, {"gait": hidden}, {"gait": plain}, {"gait": healthy}, SIGMA)


def test_an_effect_shows_beyond_noise_and_what_healthy_robots_differ_by():
    alike = shown(seen(0.02), seen(0.0), [seen(0.0)] * 4)
    assert alike["all"] == alike["noise_only"] == pytest.approx(100.0 / 5)  # one of five channels, ten times its noise
    apart = shown(seen(0.02), seen(0.0), [seen(0.0), seen(0.02)])
    assert apart["all"] == pytest.approx(0.02**2 / (0.002**2 + 0.0002) / 5) and apart["noise_only"] == alike["all"]
    assert apart["each"] == {"quadratic_drag": apart["all"]} and apart["healthy"] == 2


def test_what_a_swim_did_after_the_other_had_ended_does_not_count():
    assert shown(seen(0.0, end=1.0), seen(0.0), [seen(0.0)] * 3)["all"] == 0.0
    drifting = seen(0.0)
    drifting.tables["pose"]["x"] = np.where(drifting.tables["pose"]["t"] < 1.0, 0.0, 5.0)
    assert shown(seen(0.0, end=0.98), drifting, [seen(0.0)] * 3)["all"] == pytest.approx(0.0)
    early = shown(seen(0.02), seen(0.0), [seen(0.0), seen(0.0), seen(9.0, end=0.5)])
    assert early["all"] == pytest.approx(20.0)  # a healthy robot that stopped early says nothing of the rest


def test_nothing_hidden_and_nothing_swum_show_nothing():
    assert solver_detectability.detectable({}, {}, {}, {}, SIGMA)["all"] == 0.0
    assert solver_detectability.detectable({"swirl": {"rate": 0.1}}, {"gait": seen(1.0)}, {}, {}, SIGMA)["all"] == 0.0


# ------------------------------------------------------------ the score
@pytest.mark.slow
def test_solver_models_use_own_calibration_swims_and_null_without_solver(sets, tmp_path, monkeypatch):
    asked, fitted = [], []

    def found(path, family, robot, trials):
        fitted.append((path, family, [str(trial.value("excitation")) for trial in trials()]))
        return calibrated.CalibratedRobot(robot, {"value": 0.02, "low": 0.0, "high": 0.1})

    def search(model, trials, *, null, seed, healthy, **given):
        asked.append((null.without, len(trials), seed, healthy.swims))
        raise ConfigError("a search that is not made here")

    from fishmj.gap.bench import family_rows

    monkeypatch.setattr(solver_sets.calibrated, "read_or_calibrate", found)
    monkeypatch.setattr(
        calibrated.healthy_swims, "read_healthy_swims", lambda model, swims, null: HealthySwims(1.2, (len(swims), null.without))
    )
    monkeypatch.setattr(family_rows, "investigate", search)
    monkeypatch.setattr(family_command, "precompile", lambda names: None)
    argv = ["--generator", "solver", "--sets", str(sets), "--kinds", "none,off", "--out", str(tmp_path / "rows")]
    bench_command.main(argv)
    rows = read_rows(tmp_path / "rows" / "rows.jsonl")
    assert [row["kind"] for row in rows] == ["none", "none", "off", "none", "none", "off"]
    assert {row["answer"] for row in rows} == {"REFUSED"} and {row["family"] for row in rows} == {"solver"}
    assert {one[0] for one in asked} == {"solver"} and {one[1] for one in asked} == {6}
    assert {one[3] for one in asked} == {(len(calibrated.SWIMS), "solver")}  # what it leaves of the swims of its calibration
    assert len({path for path, _, _ in fitted}) == 4 and all(len(names) == len(calibrated.SWIMS) for _, _, names in fitted)
    assert rows[0]["calibrated"]["value"] == 0.02 and rows[0]["described"] == "fish" and rows[0]["domain"] == "laptop"
    bench_command.main([*argv, "--shard", "0/2"])
    assert len(asked) == 6  # what is done is not done again
    result = family_command.family_score.score(rows)
    assert result["families"]["solver"]["agrees"]["n"] == 4


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["--generator", "solver"], "--generator solver and --sets DIR go together"),
        (["--generator", "foil", "--sets", "x"], "go together, alone"),
        (["--generator", "solver,foil", "--sets", "x"], "scored together by --score"),
        (["--generator", "solver", "--sets", "x", "--weighed"], "--weighed does not go with"),
        (["--generator", "solver", "--sets", "x", "--logs", "5"], "--logs does not go with"),
    ],
)
def test_what_does_not_go_with_the_solver_is_refused(argv, words):
    with pytest.raises(ConfigError, match=words):
        bench_command.main(argv)


def test_a_plan_is_drawn_once_and_says_its_cost(tmp_path, capsys, seen_by_all):
    argv = ["--plan", "--robots", "1", "--singles", "0", "--domain", "laptop", "--out", str(tmp_path), "--json"]
    assert verb.main(argv) == console.OK
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["robots"] == 1 and told["sets"] == 2 and told["swims"] == 16
    assert told["steps"] == pytest.approx(told["water_s"] / 0.004)
    with pytest.raises(ConfigError, match="has a plan"):
        verb.main(argv)
    with pytest.raises(ConfigError, match="two of one name"):
        verb.main(["--plan", "--models", "fish", "a/fish.toml", "--out", str(tmp_path / "b")])
    with pytest.raises(ConfigError, match="no data set is complete"):
        swims.finished(read(tmp_path), tmp_path)
        solver_sets.robots(tmp_path, KINDS)


def test_a_cut_experiment_keeps_its_beginning():
    whole = excitation.get("gait")
    part = family_plan.cut(whole, 3.0)
    assert isinstance(part, Excitation) and part.seconds == 3.0 and np.array_equal(part.commands, whole.commands[:150])
    assert family_plan.cut(whole, 100.0).seconds == whole.seconds


def test_the_page_says_what_the_shipped_rows_say():
    root = Path(__file__).resolve().parent.parent
    folder, rows = root / "docs", read_rows(root / "studies" / "gap_benchmark" / "rows" / "solver_21.jsonl")
    found = {name: family_score.figures([row for row in rows if row["described"] == name]) for name in ("fish", "five_link")}
    page = (folder / "search" / "results.md").read_text(encoding="utf-8")
    of = lambda name, key: f"{found[name][key]['hits']} of {found[name][key]['n']}"
    for key in ("false_alarms", "agrees", "precision", "coverage", "misnamed_off_catalogue", "intervals_hold"):
        assert f"| {of('fish', key)} | {of('five_link', key)} |" in page, key
    assert {row["family"] for row in rows} == {"solver"} and len(rows) == 90
