"""The bare `fishmj hydro_fit`: what it solves, what it goes on with, what it says of a preview. All is synthetic."""

import json
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import hidden_water as hidden
import pytest
from ray_toys import toy

from fishmj.base import calib, console
from fishmj.base.errors import ConfigError
from fishmj.base.store import Manifest, read_json, write_json
from fishmj.base.store.manifest import MANIFEST
from fishmj.hydro_fit import __main__ as verb
from fishmj.hydro_fit.campaign.data import default_dataset, plan
from fishmj.hydro_fit.campaign.data.collect import collect, default_folder
from fishmj.hydro_fit.campaign.data.run_segments import Finished
from fishmj.hydro_fit.fit import fit_pipeline, gauss_newton
from fishmj.hydro_fit.segment_dataset import SEGMENTS, SPLIT, open_dataset
from fishmj.lbm_oracle.run import domain, solver_cost
from fishmj.lbm_oracle.run.domain import preset
from fishmj.mjcf import load_robot
from fishmj.mjcf.new.__main__ import main as describe
from fishmj.water.choice import chosen
from fishmj.water.hydro_model import FOLDERS, HydroModel

ROOT = Path(__file__).parent.parent
FISH = hidden.ROBOT
FREE = ("gait", "straight", "turning", "random", "manoeuvre", "uneven", "policy")


class Toys:
    """A pool without water; `seen` are the setups and the segments that it was given."""

    seen: list = []

    def run(self, waiting, setup, go_on):
        self.seen.append((setup, [segment.id for segment in waiting]))
        for segment in list(waiting):
            yield toy(segment, setup)
            if not go_on(0.0):
                return


@pytest.fixture(scope="module")
def swims():
    """Free swims in a water that the model does not know."""
    return hidden.swim(hidden.gaits(24, 4.0, 1))


@pytest.fixture
def home(tmp_path, monkeypatch):
    """Two cores, no accelerator, own folders for data and waters, a pool of toys in place of the solver."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(default_dataset, "accelerator", lambda: False)
    monkeypatch.setattr(default_dataset, "usable_cores", lambda: 2)
    monkeypatch.setattr(solver_cost, "usable_cores", lambda: 2)
    monkeypatch.setattr(Toys, "seen", [])
    monkeypatch.setattr(default_dataset, "Local", lambda tanks, devices: Toys())
    monkeypatch.setattr(verb, "SHIPPED", ())
    return tmp_path


@pytest.fixture
def tenth(monkeypatch):
    """The whole plan with a tenth of its episodes."""
    real = plan.full
    small = lambda robot, *, seed=0, **rest: replace(real(robot, seed=seed, scale=0.1), label="full")
    monkeypatch.setattr(plan, "full", small)
    return len(small(FISH).segments)


def asked(**given) -> Path:
    return default_dataset.segments_at_hand(
        default_dataset.Request(**({"robot": FISH, "home": Path("data/hydro"), "quiet": True} | given))
    )


def test_verbs_write_where_one_stands_and_read_what_is_shipped(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    preview = plan.preview(FISH)
    assert [default_folder(preview).resolve(), FOLDERS[0].resolve()] == [
        tmp_path / "data" / "hydro" / "swift-preview",
        tmp_path / "data" / "water",
    ]
    args = verb.options("all").parse_args([])
    assert verb.data_of(FISH, args) == verb.gathered(FISH, args) == verb.SHIPPED[0] and not (tmp_path / "data").exists()
    assert "using the shipped" in (said := capsys.readouterr().out) and "complete by its plan" in said
    assert HydroModel.load("swift").name == "swift" and "swift" in calib.waters()


def test_hydro_fit_without_data_or_gpu_states_hours_and_solves_a_preview(home, capsys):
    folder = asked()
    said = capsys.readouterr().out
    whole = plan.full(FISH)
    hours = solver_cost.cpu_seconds([(preset("window"), whole.water)]) / 3600
    assert f"would take about {hours:.0f} hours on 2 cores" in said and hours > 48
    assert "--data DIR" in said and "--budget SECONDS" in said and "after Ctrl-C the same command goes on" in said
    data = open_dataset(folder)
    assert folder.name == "swift-preview" and data.preview and data.meta["missing"] == 0
    takes = solver_cost.cpu_seconds([(preset("laptop"), sum(s.water for s in planned(data).segments))], 2)
    assert 0.9 * default_dataset.PREVIEW_TIME < takes <= default_dataset.PREVIEW_TIME < 1800.0
    assert asked() == folder and len(Toys.seen) == 1, "complete: nothing is solved again"


@pytest.mark.parametrize("links", [2, 8])
def test_any_described_fish_has_its_preview(home, tenth, links):
    """Every block on as many joints; classical controllers steer the on-policy one."""
    assert console.run(describe, ["mine", "--links", str(links), "--yes"]) == console.OK
    data = open_dataset(asked(robot=load_robot("mine.toml")))
    assert data.folder.name == "mine-preview" and data.preview and data.robot["joints"] == links - 1
    assert {meta["block"] for meta in data.about.values()} == set(plan.BLOCKS)


def test_a_preview_that_is_interrupted_goes_on_where_it_was(home, tenth, monkeypatch):
    class Broken(Toys):
        def run(self, waiting, setup, go_on):
            for number, finished in enumerate(super().run(waiting, setup, go_on)):
                if number == 5:
                    raise KeyboardInterrupt
                yield finished

    monkeypatch.setattr(default_dataset, "Local", lambda tanks, devices: Broken())
    with pytest.raises(KeyboardInterrupt):
        asked()
    kept = {path.stem for path in (home / "data/hydro/swift-preview" / SEGMENTS).glob("*.json")}
    assert len(kept) == 5
    monkeypatch.setattr(default_dataset, "Local", lambda tanks, devices: Toys())
    data = open_dataset(asked())
    assert kept | set(Toys.seen[-1][1]) == set(data.about) and not kept & set(Toys.seen[-1][1]) and not data.meta["missing"]


def planned(data) -> plan.CampaignPlan:
    row = read_json(data.folder / SPLIT)["plans"][-1]
    return plan.planned(row["label"], FISH, row["seed"])


def test_a_larger_budget_makes_the_same_preview_larger(home):
    first = asked(budget=300.0)
    before = set(open_dataset(first).about)
    assert len(before) < 40 and asked(budget=300.0) == first
    assert asked(budget=900.0) == first
    after = set(open_dataset(first).about)
    assert before < after and not set(Toys.seen[-1][1]) & before, "what is there is not solved again"


def test_a_preview_of_another_slip(home):
    data = open_dataset(asked(slip=0.0))
    assert {meta["grid"]["slip"] for meta in data.about.values()} == {0.0} == {verb.slip_of(data, None)}
    with pytest.raises(ConfigError, match="slip = 0.3; expected of this plan's 0, 0.95, 1"):
        asked(slip=0.3, folder=home / "other")


def test_a_budget_that_the_whole_plan_fits_into_has_it_solved(home, tenth):
    folder = asked(budget=1e7)
    data = open_dataset(folder)
    assert folder.name == "swift" and not data.preview and len(data.about) == tenth
    assert Toys.seen[0][0].domain.name == "window"


def test_hydro_fit_with_gpu_solves_the_whole_plan_in_the_model_domain(home, tenth, monkeypatch):
    monkeypatch.setattr(default_dataset, "accelerator", lambda: True)
    monkeypatch.setattr(default_dataset, "devices_of", lambda name: ("cuda:0",))
    assert asked(grid="window_coarse").name == "swift"
    setup, ids = Toys.seen[0]
    assert setup.domain.name == "window_coarse" and setup.device == "cuda:0" and len(ids) == tenth


def test_hydro_fit_refuses_a_budget_below_the_smallest_fit(home):
    with pytest.raises(ConfigError, match="the least that a water can be fitted to, 12 segments, takes about 225 s"):
        asked(budget=60.0)
    assert not (home / "data").exists()


def test_partial_data_set_is_continued_in_its_own_domain_or_used_as_it_is(home, tenth, capsys):
    some = plan.full(FISH)
    folder = Path("data/hydro/swift")
    setup = default_dataset.Request(robot=FISH, home=folder).setup(preset("window_coarse"))
    collect(some, folder, setup, pool=Toys(), budget=1e-9, quiet=True)
    assert asked() == folder and len(Toys.seen) == 1
    assert f"1 of {tenth} segments are there; the rest would take about" in capsys.readouterr().out
    (folder / MANIFEST).unlink()  # as a campaign that was interrupted leaves it
    assert asked() == folder and open_dataset(folder).meta["missing"] == tenth - 1
    assert asked(budget=1000.0) == folder and open_dataset(folder).meta["missing"] == 0
    assert Toys.seen[-1][0].domain == preset("window_coarse")


def test_data_of_another_fish_of_the_same_name_are_refused(home):
    asked()
    other = replace(FISH, servo=replace(FISH.servo, kp=2 * FISH.servo.kp))
    with pytest.raises(ConfigError, match="another fish.*a name of its own"):
        asked(robot=other)


@pytest.mark.parametrize(("scale", "box"), [(1.0, "laptop"), (1.5, "window_coarse"), (4.0, "")])
def test_the_preview_box_holds_the_fish(scale, box):
    links = tuple(replace(link, length=scale * link.length) for link in FISH.links)
    if box:
        assert default_dataset.preview_box(replace(FISH, links=links)).name == box
        return
    with pytest.raises(ConfigError, match="fits none of the boxes"):
        default_dataset.preview_box(replace(FISH, links=links))


def test_every_beginning_of_the_order_spans_the_states():
    order = plan.spanning(plan.full(FISH).segments)
    assert sorted(s.id for s in order) == sorted(s.id for s in plan.full(FISH).segments)
    least = plan.least(order)
    assert order[: len(least)] == least and len(least) == sum(count for *_, count in plan.LEAST)
    assert {s.slip for s in order[:300]} == {1.0}
    blocks = {s.block for s in order}
    for count in (40, 80, 160):
        assert {s.block for s in order[:count]} == blocks and {s.split for s in order[:count]} == {"train", "val", "test"}
        share = sum(s.split == "train" for s in order[:count]) / count
        assert 0.5 < share < 0.85


@pytest.mark.parametrize(
    "label", ["full", "preview", "scale 0.5, slip 1", "full, slip 0, 1", "fresh test 7", "full, slip 1, first 9"]
)
def test_a_label_names_its_plan(label):
    made = plan.planned(label, FISH)
    assert made.label == label and made.segments
    with pytest.raises(ConfigError, match="no plan 'half'"):
        plan.planned("half", FISH)


class Recorded:
    """A pool that gives out made records in place of solving: swims in the hidden water for free fish, chirps for held ones."""

    def __init__(self, swims):
        self.free, self.held = swims, hidden.hold(hidden.chirps(6, 4.0, 1))

    def run(self, waiting, setup, go_on):
        for number, segment in enumerate(waiting):
            own = self.free if segment.block in FREE else self.held
            record = own[number % len(own)]
            named = {key: getattr(segment, key) for key in ("id", "episode", "block", "split", "replicate_of")}
            still = replace(segment, flow=replace(segment.flow, speed=0.0)).table()["flow"]
            about = setup.about | {"segment": segment.table() | {"flow": still}, "seconds": record.seconds, "settle": 0.0}
            about["grid"] = about["grid"] | {"slip": segment.slip}
            arrays = {key: getattr(record, key) for key in ("q", "v", "command", "wrench", "raw", "flow")}
            arrays |= {"power": record.power} if segment.block in FREE else {}
            yield Finished(segment, record.meta | named | about, arrays)
            if not go_on(0.0):
                return


@pytest.mark.part("the bare hydro_fit")
def test_the_bare_verb_from_nothing_to_a_report(home, swims, monkeypatch, capsys):
    """Preview solved, fitted, marked, checked and reported; the shipped water, fitted to a whole plan, stays."""
    monkeypatch.setattr(default_dataset, "Local", lambda tanks, devices: Recorded(swims))
    monkeypatch.setattr(fit_pipeline, "FitSettings", partial(fit_pipeline.FitSettings, members=2))
    monkeypatch.setattr(gauss_newton, "fit_rollout", partial(gauss_newton.fit_rollout, rounds=2))
    assert console.run(verb.main, ["--budget", "400", "--base", "--swims", "0", "--json"]) == console.OK
    out = capsys.readouterr().out
    found = json.loads(out.splitlines()[-1])
    assert "the preview is swift-preview" in out and "swift-preview is a preview, fitted to the first part of a plan" in out
    assert found["fit"]["preview"] and found["check"]["preview"] and found["check"]["figures"]["speed_error_mean"] < 0.3
    assert 0.2 < found["fit"]["fastest"] < 2.0 and f"fastest gait {found['fit']['fastest']:.2g} m/s (a family's" in out
    model = HydroModel.load(Path(found["fit"]["model"]))
    assert model.preview and model.name == "swift-preview" and model.base_only.preview and not HydroModel.load("swift").preview
    assert "a preview, not fitted to a whole plan" in chosen(FISH, found["fit"]["model"]).said, "whoever swims in it is told"
    assert "preview = true" in Path(found["fit"]["model"]).read_text(encoding="utf-8")
    page = Path(found["report"]).read_text(encoding="utf-8")
    assert found["report"].endswith("swift-preview-report/report.html") and "preview, fitted to the first part" in page


class Fitted:
    """In place of the pipeline: the shipped strips, worse than anything that stands."""

    seconds, notes = {}, []

    def __init__(self, *given, **more):
        pass

    def run(self) -> HydroModel:
        row = {"name": "alpha", "value": 0.5, "status": "not identified", "partner": "", "correlation": 0.0}
        row |= {"sd": 1.0, "prior": 0.5, "prior_sd": 1.0}
        found = dict.fromkeys(("linear", "rollout"), {"condition": 1.0, "parameters": {"alpha": row}})
        return replace(HydroModel.load("swift-base"), scores={"validation": 2.0}, found=found)

    def score(self, water, learnt) -> float:
        return 1.0

    def kept_so_far(self) -> str:
        return ""


def test_preview_never_replaces_a_whole_model_and_a_whole_replaces_preview(home, swims, monkeypatch, capsys):
    monkeypatch.setattr("fishmj.hydro_fit.fit.fit_pipeline.FitPipeline", Fitted)
    data = hidden.write_dataset(home / "set", swims)

    def fitted(missing, out, name) -> dict:
        Manifest.of(data, {"missing": missing}).write(data)
        asked = ["fit", "--data", str(data), "--name", name, "--json", *(["--out", str(out)] if out else [])]
        assert console.run(verb.main, asked) == console.OK
        out = capsys.readouterr().out
        stages = re.findall(r"stage (\w+): alpha = 0.5 is not identified: not quoted as calibrated", out)
        assert stages == ["linear", "rollout"] and out.count("not identified") == 2, "each with its stage"
        return json.loads(out.splitlines()[-1])

    # the shipped water stands in the default place: a preview goes beside it, a whole model that is worse is rejected
    first = fitted(3, None, "swift")
    assert first["taken"] and first["preview"] and Path(first["place"]).name == "swift-preview.toml" and first["standing"] is None
    worse = fitted(0, None, "swift")
    assert not worse["taken"] and worse["standing"] == 1.0 and Path(worse["place"]) == FOLDERS[1] / "swift.toml"
    # in a place of its own: a preview, a worse preview, then a whole model that takes its place unasked
    own = home / "own"
    assert fitted(3, own, "other")["taken"] and HydroModel.load(own / "other.toml").preview
    assert not fitted(3, own, "other")["taken"]
    assert fitted(0, own, "other")["taken"] and not HydroModel.load(own / "other.toml").preview


def test_lost_segments_are_told_and_fail_nothing(home, monkeypatch, capsys):
    """The shipped data set: its plan is complete, four flapping fish are lost; nothing is solved or written there."""
    shipped = ROOT / "data" / "hydro" / "swift"
    before = {path.name: path.stat().st_mtime_ns for path in (shipped / MANIFEST, shipped / SPLIT)}
    monkeypatch.setattr(verb, "fit", lambda robot, folder, args: {"place": "swift", "folder": str(folder), "preview": False})
    monkeypatch.setattr(verb, "check", lambda robot, folder, args: {"ok": True, "preview": False, "model": args.model})
    monkeypatch.setattr(verb, "report", lambda robot, folder, args: folder / "report.html")
    assert console.run(verb.main, ["--data", str(shipped), "--json"]) == console.OK
    out, err = capsys.readouterr()
    assert "4 of 492 segments (flapping) are lost" in out and "complete by its plan (full)" in out and not err
    found = json.loads(out.splitlines()[-1])
    assert found["fit"]["folder"] == str(shipped) and found["check"]["model"] == "swift" and not Toys.seen
    assert before == {path.name: path.stat().st_mtime_ns for path in (shipped / MANIFEST, shipped / SPLIT)}


def test_too_few_segments_are_one_clear_error(home, swims, capsys):
    """Of a data set that says it is complete: no test gait, then too few swims."""
    data = hidden.write_dataset(home / "set", swims[:3])
    assert console.run(verb.main, ["--data", str(data)]) == console.BAD_INPUT
    assert "no test swim of a gait at slip 1" in capsys.readouterr().err
    assert console.run(verb.main, ["fit", "--data", str(data), "--out", str(home / "out")]) == console.BAD_INPUT
    said = capsys.readouterr().err
    assert "2 free swims of 2 s or more to fit and 1 to validate at slip 1; expected 4 and 1 at least" in said


def test_the_slip_comes_from_the_data_or_the_model(home, swims):
    sticky = [replace(r, meta=r.meta | {"grid": {"slip": 0.0}}) for r in swims[:3]]
    one = hidden.write_dataset(home / "one", sticky)
    for path in (one / SEGMENTS).glob("*.json"):
        write_json(path, read_json(path) | {"grid": {"domain": "synthetic", "dx": 0.0, "dt": hidden.CHAIN.dt, "slip": 0.0}})
    Manifest.of(one).write(one)
    several = open_dataset(ROOT / "data" / "hydro" / "swift")
    assert verb.slip_of(open_dataset(one), None) == 0.0 and verb.slip_of(open_dataset(one), 1.0) == 1.0
    model = HydroModel.load("swift-noslip")
    assert verb.slip_of(several, None) == 1.0 and verb.slip_of(several, None, model) == model.slip == 0.0


@pytest.mark.slow
@pytest.mark.oracle
def test_the_bare_verb_end_to_end_in_the_flow_solver(tmp_path, monkeypatch, capsys):
    """A small two-link fish, described by `fishmj new`, segments of three seconds in a small box: solved, fitted and checked."""
    monkeypatch.chdir(tmp_path)
    assert console.run(describe, ["tiny", "--length", "0.3", "--links", "2", "--yes"]) == console.OK
    short = lambda parts, seconds: tuple(part._replace(seconds=seconds) for part in parts)
    monkeypatch.setattr(plan, "TRAINING", short(plan.TRAINING, 2.5))
    monkeypatch.setattr(plan, "TEST", short(plan.TEST, 3.2))
    monkeypatch.setattr(plan, "SETTLE", 0.4)
    boxes = domain._presets()
    small = boxes | {"laptop": replace(boxes["laptop"], shape=(42, 36, 14))}
    monkeypatch.setattr(domain, "_presets", lambda: small)
    monkeypatch.setattr(default_dataset, "CPU_TIME", 3600.0)
    monkeypatch.setattr(default_dataset, "PREVIEW_TIME", 9.5)
    given = ["--fish", "tiny.toml", "--device", "cpu", "--swims", "3", "--json"]
    assert console.run(verb.main, given) == console.OK
    out = capsys.readouterr().out
    found = json.loads(out.splitlines()[-1])
    assert found["data"] == "data/hydro/tiny-preview" and found["fit"]["preview"] and Path(found["report"]).is_file()
    assert {meta["grid"]["domain"] for meta in open_dataset(found["data"]).about.values()} == {"laptop"}
    model = HydroModel.load(Path("data/water/tiny.toml"))
    assert model.preview and model.swimmer(load_robot("tiny.toml")).water == model.base
