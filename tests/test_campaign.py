"""The campaign: what it plans, what a segment of the flow solver holds, and that collecting goes on where it was stopped."""

import json
import re
from argparse import ArgumentTypeError, Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ray_toys import toy

from fishmj.base import console
from fishmj.base.errors import ConfigError, DatasetError, OracleUnstable
from fishmj.base.store import write_json
from fishmj.hydro_fit import segment_dataset
from fishmj.hydro_fit.campaign.data import plan, run_segments, solver_hash
from fishmj.hydro_fit.campaign.data.collect import Collected, collect, domain_of, main, warn_of_cells
from fishmj.hydro_fit.campaign.data.segment import Segment, drive
from fishmj.hydro_fit.campaign.data.solver_hash import code_of, solver_sha256
from fishmj.hydro_fit.record import HALF, narrow, read_record
from fishmj.hydro_fit.segment_dataset import SEGMENTS, SPLIT, open_dataset
from fishmj.lbm_oracle.immersed.markers import EDGES, WALL_STRESS
from fishmj.lbm_oracle.run.domain import preset
from fishmj.mjcf import load_robot

FISH, SECOND = load_robot("fish"), load_robot("tendon_fish")
SETUP = run_segments.Setup(domain=preset("laptop"), device="cpu")
SMALL = replace(SETUP, domain=replace(SETUP.domain, shape=(60, 36, 16)))
FULL = plan.full(FISH)
SHIPPED = Path(__file__).parent.parent / "data" / "hydro" / "swift"


class Toys:
    """A pool without water; stops after `most` segments."""

    def __init__(self, most=10**6, error=None):
        self.most, self.error, self.ran = most, error, []

    def run(self, waiting, setup, go_on):
        for segment in list(waiting)[: self.most]:
            self.ran.append(segment.id)
            yield toy(segment, setup)
            if not go_on(0.0):
                return
        if self.error:
            raise self.error


def some(number=6):
    """A small plan of one-second segments, the last of them a test."""
    segments = tuple(replace(s, seconds=1.0, settle=0.0) for s in FULL.segments if s.block == "gait")[:number]
    return plan.CampaignPlan(label="small", robot=FISH, seed=0, segments=segments)


def test_a_policy_that_has_changed_since_is_refused():
    segment = next(s for s in FULL.segments if s.drive.get("controller") == "paper")
    drive(segment, FISH)
    other = replace(segment, drive=segment.drive | {"sha256": "0" * 64})
    with pytest.raises(ConfigError, match="policy paper: expected sha256 0000"):
        drive(other, FISH)


def test_a_segment_survives_json():
    for segment in FULL.segments[::7]:
        back = Segment.of(json.loads(json.dumps(segment.table())))
        assert back.sha256 == segment.sha256 and back.flow == segment.flow and back.pose == segment.pose
    changed = replace(FULL.segments[0], slip=0.5)
    assert changed.sha256 != FULL.segments[0].sha256


def test_fingerprint_of_a_fish_depends_on_mass_not_on_colour_or_water():
    water = replace(FISH, title="another", water=FISH.water | {"cf": 0.5})
    painted = replace(FISH, links=(replace(FISH.links[0], colour=(0.0, 0.0, 0.0)), *FISH.links[1:]))
    heavier = replace(FISH, links=(replace(FISH.links[0], mass=0.8), *FISH.links[1:]))
    assert (
        segment_dataset.fingerprint(FISH)
        == segment_dataset.fingerprint(water)
        == segment_dataset.fingerprint(painted)
        != segment_dataset.fingerprint(heavier)
    )


# on disk


def test_narrow_keeps_every_channel_within_a_thousandth_of_its_range():
    rng = np.random.default_rng(0)
    for scale, offset in ((1.0, 0.0), (1e-3, 1.0), (1e6, 0.0), (1e-9, 0.0), (1.0, 300.0)):
        values = offset + scale * rng.standard_normal((200, 4, 3))
        error = np.abs(narrow(values).astype(float) - values).max(0)
        assert (error <= HALF * np.ptp(values, 0)).all()
    assert narrow(rng.standard_normal((200, 3))).dtype == np.float16
    assert narrow(1.0 + 1e-3 * rng.standard_normal((200, 3))).dtype == np.float32


def test_an_interrupted_campaign_goes_on_with_what_is_missing(tmp_path):
    small = some()
    ids = [s.id for s in small.segments]
    with pytest.raises(KeyboardInterrupt):
        collect(small, tmp_path, SETUP, pool=Toys(2, KeyboardInterrupt()), quiet=True)
    rest = Toys()
    found = collect(small, tmp_path, SETUP, pool=rest, quiet=True)
    assert rest.ran == ids[2:] and found.there == 2 and found.complete
    data = open_dataset(tmp_path, test=True)
    assert sorted(data.about) == sorted(ids) and data.meta["complete"]
    for split in ("train", "val", "test"):
        assert all(record.seconds == 1.0 for record in data.records(split))
    nothing = Toys()
    collect(small, tmp_path, SETUP, pool=nothing, quiet=True)
    assert nothing.ran == []


def test_a_damaged_or_differently_made_segment_is_run_again(tmp_path):
    small = some()
    collect(small, tmp_path, SETUP, pool=Toys(), quiet=True)
    damaged, other = small.segments[1], small.segments[3]
    path = tmp_path / SEGMENTS / f"{damaged.id}.npz"
    path.write_bytes(path.read_bytes()[:-7])
    changed = replace(small, segments=tuple(replace(s, seconds=1.2) if s.id == other.id else s for s in small.segments))
    again = Toys()
    collect(changed, tmp_path, SETUP, pool=again, quiet=True)
    assert sorted(again.ran) == sorted([damaged.id, other.id])
    assert read_record(tmp_path / SEGMENTS, other.id).seconds == pytest.approx(1.2)


def test_a_budget_stops_with_what_is_finished(tmp_path):
    small = some()
    found = collect(small, tmp_path, SETUP, pool=Toys(), budget=1e-9, quiet=True)
    assert found.run == 1 and found.missing == 5 and not found.complete
    data = open_dataset(tmp_path)
    assert len(data.about) == 1 and data.meta["missing"] == 5


def test_what_a_budget_leaves_is_a_mixture_of_the_blocks(tmp_path):
    class Look(Toys):
        def run(self, waiting, setup, go_on):
            self.blocks = [segment.block for segment in waiting]
            return iter(())

    plain, cut = Look(), Look()
    collect(FULL, tmp_path, SETUP, pool=plain, quiet=True)
    collect(FULL, tmp_path, SETUP, pool=cut, budget=100.0, quiet=True)
    assert len(set(plain.blocks[:20])) == 1 and len(set(cut.blocks[:20])) >= 5


def test_the_split_is_on_disk_before_the_first_segment_and_cannot_change(tmp_path):
    small = some()

    class Look:
        def run(self, waiting, setup, go_on):
            stated = json.loads((tmp_path / "split.json").read_text())
            assert stated["episodes"] == dict(sorted(small.episodes.items())) and stated["sha256"] == small.split_sha256
            assert not (tmp_path / SEGMENTS).exists()
            return iter(())

    collect(small, tmp_path, SETUP, pool=Look(), quiet=True)
    first = small.segments[0]
    other = "val" if first.split != "val" else "train"
    moved = replace(small, segments=[replace(s, split=other) if s.episode == first.episode else s for s in small.segments])
    with pytest.raises(DatasetError, match="would change their split"):
        collect(moved, tmp_path, SETUP, pool=Toys(), quiet=True)
    with pytest.raises(ConfigError, match="another grid"):
        collect(small, tmp_path, replace(SETUP, domain=preset("window")), pool=Toys(), quiet=True)


def test_complete_data_set_stays_but_refuses_segments_of_another_solver(tmp_path, monkeypatch):
    collect(some(), tmp_path, SETUP, pool=Toys(), quiet=True)
    monkeypatch.setattr(run_segments, "solver_sha256", lambda domain, sharpness: "0" * 64)
    assert collect(some(), tmp_path, SETUP, pool=Toys(), quiet=True).complete
    assert open_dataset(tmp_path).meta["solver"] == {"sha256": solver_sha256()}
    with pytest.raises(ConfigError, match="another solver"):
        collect(some(7), tmp_path, SETUP, pool=Toys(), quiet=True)


def test_a_solver_is_its_code_not_its_comments():
    plain = code_of('"""One."""\ndef f(x):\n    return 2 * x\n')
    assert plain == code_of('"""Two."""\n\n\ndef f(x):\n    "double"\n    return 2 * x  # said\n')
    assert plain != code_of("def f(x):\n    return 3 * x\n")


def test_shipped_segments_are_those_of_this_solver():
    """Code of the physics that changes no bit belongs into `solver_hash.SAME`; other code needs new segments."""
    assert open_dataset(SHIPPED).meta["solver"]["sha256"] == solver_sha256()


def test_segments_of_another_law_of_the_wall_are_of_another_solver():
    plain, law = SETUP.about["solver"], replace(SETUP, sharpness=WALL_STRESS).about["solver"]
    assert plain == replace(SETUP, sharpness=EDGES).about["solver"] == {"sha256": solver_hash.SHIPPED} != law
    finer = replace(SETUP, domain=preset("window_coarse_refined")).about["solver"]
    assert finer["sha256"] not in (solver_hash.SHIPPED, law["sha256"])  # whose repeated ticks missed the place of a moved box
    assert law["sha256"] == solver_hash.SPREAD  # before it, all of the stress was at the wall


def test_a_round_of_correction_adds_to_a_data_set(tmp_path):
    collect(some(), tmp_path, SETUP, pool=Toys(), quiet=True)
    more = plan.on_policy(FISH, "dob", episodes=2, seconds=3.0, seed=1)
    found = collect(more, tmp_path, SETUP, pool=Toys(), quiet=True)
    assert found.complete and [len(open_dataset(tmp_path).names(part, block="policy")) for part in ("train", "val")] == [1, 1]
    assert len(open_dataset(tmp_path).about) == 8


def test_hours_on_a_cpu_are_not_begun_unasked(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("fishmj.lbm_oracle.run.solver_cost.accelerator", lambda need: False)
    monkeypatch.setattr("fishmj.hydro_fit.campaign.data.collect.devices_of", lambda name: ("cpu",))
    assert console.run(main, ["--out", str(tmp_path / "no")]) == console.BAD_INPUT
    assert "s of water in boxes of up to 1.97 M cells" in capsys.readouterr().err and not (tmp_path / "no").exists()
    asked = []
    noted = lambda plan, out, setup, **rest: asked.append(rest["budget"]) or collected(out)
    monkeypatch.setattr("fishmj.hydro_fit.campaign.data.collect.collect", noted)
    assert console.run(main, ["--out", str(tmp_path / "no"), "--budget", "60"]) == console.OK and asked == [60.0]


def collected(folder):
    """What collecting everything gives back."""
    return Collected(
        folder, segments=1, there=0, run=1, missing=0, stopped={}, lost=[], recorded_s=1, water_s=1, wall_s=1, bytes=1
    )


def test_a_hull_that_is_narrow_for_the_cells_is_noted(capsys):
    half = lambda link: replace(link, sections=tuple((x, high, wide / 2) for x, high, wide in link.sections))
    small = replace(FISH, links=tuple(map(half, FISH.links)))
    for robot, box in ((FISH, "laptop"), (SECOND, "window_coarse"), (small, "window"), (small, "laptop_refined")):
        warn_of_cells(robot, preset(box))
    assert not capsys.readouterr().err
    warn_of_cells(small, preset("laptop"))
    assert "swift is 1.6 cells of 0.02 m wide in laptop, expected 2.5 or more" in capsys.readouterr().err


def test_the_command_prints_a_plan_and_refuses_two(capsys, tmp_path):
    asked = ["--preview", "--dry-run", "--json", "--device", "cuda", "--out", str(tmp_path / "no")]  # also for another machine
    assert console.run(main, asked) == console.OK
    *lines, last = capsys.readouterr().out.splitlines()
    said = json.loads(last)
    assert "idle cores without a GPU" in lines[-1]
    assert (
        said["plan"] == "preview"
        and 80 < said["water_s"] < 130
        and said["left_s"] == said["water_s"]
        and said["domain"] == "laptop"
        and not (tmp_path / "no").exists()
    )
    assert console.run(main, ["--preview", "--fresh-test", "2"]) == console.BAD_INPUT
    assert console.run(main, ["--scale", "0", "--dry-run"]) == console.BAD_INPUT
    table = {"episodes": {}, "plans": [], **SETUP.about} | {"robot": SETUP.about["robot"] | {"sha256": "0" * 64}}
    write_json(tmp_path / "other" / "split.json", table)
    assert console.run(main, ["--preview", "--dry-run", "--out", str(tmp_path / "other")]) == console.BAD_INPUT
    assert "holds segments of another fish" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("dt", "why"),
    [("0.003", "no multiple of dt = 0.003 s of laptop; take --dt 0.00285714286"), ("0.02", "laptop: Mach 0.53 at 0.3041")],
)
def test_a_time_step_that_no_run_takes_is_refused_before_anything_is_written(dt, why, capsys, tmp_path):
    asked = ["--preview", "--out", str(tmp_path / "no"), "--dt", dt, "--device", "cpu"]
    for more in (["--dry-run"], []):
        assert console.run(main, asked + more) != console.OK and why in capsys.readouterr().err
    with pytest.raises((ConfigError, OracleUnstable), match=re.escape(why)):
        collect(plan.preview(FISH), tmp_path / "no", replace(SETUP, domain=SETUP.domain.changed(dt=float(dt))), pool=Toys())
    assert not (tmp_path / "no").exists()


def test_a_data_set_is_continued_in_its_own_box(tmp_path):
    """Without this, to go on with the shipped segments was refused: they are of another box than a new data set's."""
    asked = Namespace(domain=None, dt=None, preview=False)
    own = domain_of(asked, SHIPPED)
    assert run_segments.Setup(domain=own, device="cpu").about["grid"] == open_dataset(SHIPPED).meta["grid"]
    assert domain_of(asked, tmp_path).name == "window"
    assert domain_of(Namespace(domain=None, dt=None, preview=True), tmp_path).name == "laptop"
    other = domain_of(Namespace(domain="laptop", dt=0.001, preview=False), SHIPPED)
    assert (other.name, other.dt) == ("laptop", 0.001)
    (tmp_path / SPLIT).write_text('{"grid": {"domain": "window"}}')
    with pytest.raises(DatasetError, match="grid with domain and dt"):
        domain_of(asked, tmp_path)


def test_the_shipped_data_are_what_their_command_makes():
    data = open_dataset(SHIPPED)
    wanted = {segment.id: segment.sha256 for segment in plan.full(FISH).segments}
    made = {name: Segment.of(meta["segment"]).sha256 for name, meta in data.about.items()}
    assert made == wanted and data.meta["missing"] == 0
    assert data.meta["origin"] == "synthetic" and not data.meta["grid"]["preview"]
    stopped = [data.about[name] for name in data.lost()]  # held fish whose tail, to the letter, is too fast for the grid
    assert len(stopped) < 0.05 * len(made) and all(meta["prescribed"]["joints"] for meta in stopped)
    assert sum("file" not in meta for meta in stopped) <= 10
    assert sum(path.stat().st_size for path in SHIPPED.rglob("*") if path.is_file()) < 40e6
    assert sum(meta["seconds"] for meta in data.about.values() if meta["split"] == "train") > 2900


def test_collect_checks_its_default_folder_before_it_solves(tmp_path, monkeypatch):
    monkeypatch.setattr("fishmj.hydro_fit.campaign.data.collect.OWN", tmp_path / "data")
    (tmp_path / "data").write_text("a file in the place of the folder")
    with pytest.raises(ArgumentTypeError, match="nothing can be written below it"):
        main(["--preview", "--device", "cpu"])
