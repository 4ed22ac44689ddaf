"""Boxes in boxes of finer cells, and every kind of run that swims in them: judged, recorded, with effects, with hidden ones."""

from collections import deque
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fishmj import engines
from fishmj.base.errors import ConfigError
from fishmj.engines import lbm
from fishmj.hydro_fit.campaign.data import run_segments
from fishmj.hydro_fit.campaign.data.segment import Segment
from fishmj.lbm_oracle.immersed import snapshot
from fishmj.lbm_oracle.run import domain as domains
from fishmj.lbm_oracle.run.domain import EVERY, REFINED, Domain, preset
from fishmj.lbm_oracle.run.run import ConcurrentRuns, Run
from fishmj.lbm_oracle.run.setup import DomainWatch, Gait, SwimSetup
from fishmj.lbm_oracle.run.solver_water import BOUNDARIES
from fishmj.lbm_oracle.run.swim import LastGood
from fishmj.mjcf import load_robot
from fishmj.water.flow import Flow

FISH = load_robot("fish")
POOL = Domain(name="pool", shape=(36, 24, 16), dx=0.04, dt=0.01, sponge=4, fine=(0.72, 0.44, 0.32))
DEEP = Domain(name="deep", shape=(40, 24, 18), dx=0.04, dt=0.01, sponge=4, fine=(0.8, 0.44, 0.36), finer=((0.68, 0.32, 0.24),))
QUICK = Gait(frequency=2.0, ramp=0.1)


def deep(domain: Domain = DEEP) -> Run:
    return SwimSetup(domain=domain, flow=Flow(speed=0.1, direction=3.0), slip=0.98).run(latency=0.0)


def test_boxes_by_name_halve_the_cell_once_or_twice():
    assert [level.dx for level in preset("paper_refined").levels] == [0.02, 0.01]
    levels = preset("paper_refined_twice").levels
    assert [(level.dx, level.dt) for level in levels] == [(0.02, 0.004), (0.01, 0.002), (0.005, 0.001)]
    assert levels[0] == replace(preset("paper"), name="paper_refined_twice")
    assert set(REFINED) < set(EVERY) and all(preset(name).name == name for name in EVERY)
    assert all(preset(name).changed() == preset(name) for name in EVERY)
    assert preset("window_coarse_refined_twice").changed(dx=0.01).body_level.dx == 0.0025
    for name in REFINED:  # every box lies in the one before with the room that it needs
        for outer, size in zip(preset(name).levels, preset(name).boxes, strict=False):
            assert all(n + 6 <= m for n, m in zip(size, outer.shape, strict=True)), name


def test_three_levels_follow_the_fish():
    coupled = SwimSetup(domain=DEEP).coupled()
    body, finest, edge = coupled.body, coupled.fluid, DomainWatch(DEEP)
    assert [level.lattice.dx for level in finest.levels] == [0.01, 0.02, 0.04] and edge.every == 4
    middle = lambda: 0.5 * np.sum(body.bounds(coupled.boundary.corners), 0)
    q = body.data.qpos.copy()
    q[0] -= 0.09
    body.place(q)
    assert edge.follow(coupled) and not edge.follow(coupled)
    assert all(np.abs(box._offset_of(middle())).max() <= 1.0 for box in finest.levels[:-1])


def test_a_tick_is_done_again_on_three_levels():
    """As if the tick had ended too fast: the swim is that of half the time step."""
    half, again = deep(replace(DEEP, dt=0.005)), deep()
    again.fastest = 10.0
    again.tick(QUICK(again.time)), half.tick(QUICK(half.time))
    water = again.coupled.fluid
    assert again.refined == 1 and [level.steps for level in water.levels] == [8, 4, 2]
    assert [int(level.clock.numpy()[0]) for level in water.levels] == [8, 4, 2]
    assert again.angles() == pytest.approx(half.angles(), abs=2e-4) and again.pose[:3] == pytest.approx(half.pose[:3], abs=1e-5)
    for a, b in zip(water.levels, half.coupled.fluid.levels, strict=True):
        assert np.abs(a.velocity() - b.velocity()).max() < 2e-3


def test_a_saved_state_of_three_levels_goes_on_to_the_bit(tmp_path):
    run, same = deep(), deep()
    run.tick(QUICK(0.0))
    snapshot.save(tmp_path / "at.safetensors", run.coupled)
    snapshot.load(tmp_path / "at.safetensors", same.coupled)
    same.begin()
    same.commands, same.ticks = list(run.commands), run.ticks
    run.tick(QUICK(0.02)), same.tick(QUICK(0.02))
    assert same.angles().tolist() == run.angles().tolist()
    for a, b in zip(run.coupled.fluid.levels, same.coupled.fluid.levels, strict=True):
        np.testing.assert_array_equal(a.velocity(), b.velocity())


def test_the_last_good_state_has_all_levels(monkeypatch):
    monkeypatch.setattr(snapshot, "save", lambda path, coupled, **notes: "kept")
    run = deep()
    kept = LastGood()
    kept.update(run)
    kept.good, before = kept.candidate, [level.velocity() for level in run.coupled.fluid.levels]
    run.tick(QUICK(0.0))
    run.coupled.fluid.levels[-1].f.fill_(np.nan)
    assert kept.save(None, SimpleNamespace(coupled=run.coupled, robot=FISH, stopped="")) == "kept"
    for level, velocity in zip(run.coupled.fluid.levels, before, strict=True):
        np.testing.assert_array_equal(level.velocity(), velocity)
    assert [level.steps for level in run.coupled.fluid.levels] == [0, 0, 0]


def test_a_tick_of_part_of_a_coarse_step_is_refused():
    with pytest.raises(ConfigError, match="no multiple of the coarse dt = 0.008"):
        deep(replace(DEEP, dt=0.008))


def test_finer_water_has_all_levels_at_their_present_place():
    box = SwimSetup(domain=DEEP).coupled().fluid
    box.move((1, 0, 0))
    fine = box.finer(2)
    assert [level.lattice.dt for level in fine.levels] == [0.5 * level.lattice.dt for level in box.levels]
    assert all(np.array_equal(a.origin_lu, b.origin_lu) for a, b in zip(fine.levels, box.levels, strict=True))


def test_the_judge_fills_a_tank_with_a_finer_box(monkeypatch):
    monkeypatch.setattr(lbm, "preset", lambda name: replace(POOL, dt=0.005))
    monkeypatch.setattr(lbm, "HELD", 0.04)
    engine = lbm.LbmEngine(FISH, [Flow(speed=0.2, turbulence="default", intensity=0.1)], domain="x", slip=0.98, device="cpu")
    state, params = engines.at_rest(FISH, np.zeros((1, 3))), engines.nominal_params(FISH, 1)
    after, trace = engine.advance(state, np.zeros((1, 1, 3)), params, None, 0)
    (run,) = engine.tanks.runs
    assert len(run.coupled.fluid.levels) == 2 and engine.ticks == [1] and engine.stopped == [""]
    assert run.coupled.fluid.steps == 2 * run.coupled.fluid.outer.steps == 8  # the water's clock is at the trial's
    assert np.isfinite(trace.pose).all() and 0 < np.abs(after.v[0, :3]).max() < 0.2


def test_a_segment_of_the_campaign_is_solved_in_a_finer_box():
    setup = run_segments.Setup(domain=POOL, device="cpu")
    gait = {"kind": "gait", "frequency": 1.5, "amplitude": 0.4, "lag": 1.0, "bias": 0.3, "ramp": 0.1}
    swim = Segment(id="swim", episode="swim", block="gait", split="train", seconds=0.2, drive=gait, slip=0.98)
    ((_, meta, arrays),) = run_segments.on_device(deque([swim]), setup.device, setup=setup)
    assert meta["stopped"] == "" and len(arrays["q"]) == 10
    assert (meta["grid"]["dx"], meta["grid"]["dt"]) == (0.04, 0.01)
    assert [(level["dx"], level["shape"]) for level in meta["grid"]["fine"]] == [(0.02, [36, 22, 16])]
    assert "fine" not in run_segments.Setup(device="cpu").about["grid"]


def test_a_fish_with_the_second_robots_servos_swims_in_a_finer_box():
    pytest.importorskip("numba")
    from fishmj.gap.laboratory.hidden_lbm import hidden

    (job,) = hidden.jobs({}, ["gait"], 3, domain=replace(POOL, follows=True))
    run = hidden.HiddenRun(job, "cpu")
    assert len(run.coupled.fluid.levels) == 2 and not run.stopped
    for _ in range(3):
        run.tick(np.zeros(3))
    assert run.coupled.fluid.steps == 12 and run.recording().t[-1] == pytest.approx(0.059)


def test_the_slip_table_can_be_made_on_any_box(monkeypatch, tmp_path):
    from fishmj.gap.calibrate import slip
    from fishmj.gap.laboratory.hidden_lbm import hidden

    names = []
    monkeypatch.setattr(hidden, "run_jobs", lambda jobs, device, tanks: names.extend(job.domain.name for job in jobs) or iter(()))
    monkeypatch.setattr(slip.PartialResults, "find", lambda self, name: [1.0] if names else None)
    entry = slip.recompute("window_coarse_refined", [0.98], "cpu", 1, tmp_path)
    assert set(names) == {"window_coarse_refined"} and entry["grid"] == "window_coarse_refined"
    assert domains.preset(entry["grid"]).fine is not None


def test_collect_takes_a_finer_box_and_finds_it_again(tmp_path):
    from fishmj.base.store import write_json
    from fishmj.hydro_fit.campaign.data import collect

    grid = run_segments.Setup(domain=preset("window_coarse_refined"), device="cpu").about["grid"]
    write_json(tmp_path / collect.SPLIT, {"grid": grid})
    found = collect.domain_of(SimpleNamespace(domain=None, dt=None, preview=False), tmp_path)
    assert found == preset("window_coarse_refined")


@pytest.mark.parametrize("boundary", ["rims", "wall_stress"])
def test_a_fish_that_is_carried_to_a_face_has_left_the_domain_before_its_kernel_or_law_reaches_past_the_box(boundary):
    tank = Domain(name="tank", shape=(50, 30, 16), dx=0.04, dt=0.004, sponge=4, fine=(0.8, 0.64, 0.4))
    stage = SwimSetup(domain=tank, sharpness=BOUNDARIES[boundary], flow=Flow(speed=0.5), pose=(0.62, 0.0, 0.0))
    tanks = ConcurrentRuns([stage.run()])
    while not tanks.runs[0].stopped and tanks.runs[0].time < 1.0:
        tanks.tick(np.zeros((1, 3)))
    assert tanks.runs[0].stopped.startswith("left_domain")
