"""Faults 8 to 10 of tests/FAULTS.md as a user meets them: the flow solver refuses, stops, and loses nothing."""

import json

import numpy as np
import pytest

wp = pytest.importorskip("warp")

from fishmj import control
from fishmj.base import console
from fishmj.engines import lbm
from fishmj.evaluate import run_trials, trials
from fishmj.evaluate.metrics import figures
from fishmj.lbm_oracle.fluid import guard
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.immersed import snapshot
from fishmj.lbm_oracle.run import solver_water, stability, swim
from fishmj.lbm_oracle.run.domain import Domain, margin
from fishmj.lbm_oracle.run.setup import SwimSetup
from fishmj.log import read_trial
from fishmj.mjcf import load_robot

pytestmark = pytest.mark.oracle
wp.config.quiet = True
TINY = Domain(name="tiny", shape=(48, 30, 16), dx=0.02, dt=0.004, sponge=4)
CPU = ["--device", "cpu", "--latency", "0"]


def test_fault_8_the_command_refuses_an_unstable_set_up_before_step_one(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(Fluid, "stream_collide", lambda self: pytest.fail("a step was taken"))
    out = tmp_path / "trial"
    too_fast = ["--preset", "laptop", "--dt", "0.01", *CPU, "--speed", "0.5", "--out", str(out)]
    assert console.run(swim.main, too_fast) == console.BAD_INPUT
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert "Mach 0.43 at 0.5 m/s" in said and "dt = 0.006667 s would give 0.29" in said
    faster = ["--preset", "laptop", "--dt", "0.02", *CPU, "--fields", str(tmp_path / "fields")]
    assert console.run(swim.main, faster) == console.BAD_INPUT
    assert not list(tmp_path.iterdir())


class Spoiled(SwimSetup):
    """Water in which an instability grows by half a step, from a step on."""

    step, growth = 260, 1.5

    def run(self, **options):
        made = super().run(**options)

        def spoil(coupled):
            if coupled.steps >= self.step:
                f = coupled.fluid.f.numpy()
                f[:, 38:44, 5:11, 4:10] *= self.growth
                coupled.fluid.f.assign(f)

        made.follow = spoil
        return made


def test_fault_9_diverging_run_stops_and_keeps_rows_and_last_good_state(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(swim, "_stage", lambda args: Spoiled(domain=TINY, device="cpu"))
    out = tmp_path / "trial"
    assert swim.main([*CPU, "--seconds", "3", "--out", str(out), "--json"]) == console.FAILED_CHECK
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert found["stopped"].startswith("diverged: ") and "m/s" in found["stopped"]
    kept = read_trial(out)
    t = kept.table("truth")["t"]
    assert Spoiled.step * 0.004 - 0.021 <= t[-1] <= (Spoiled.step + guard.EVERY) * 0.004 + 1e-9  # found within 50 steps
    assert kept.value("oracle.stopped") == found["stopped"]
    assert all(np.isfinite(column).all() for table in kept.tables.values() for column in table.values())
    again = SwimSetup(domain=TINY, device="cpu").run()
    notes = snapshot.load(found["last_good"], again.coupled)
    assert notes["last_good"] and notes["stopped"] == found["stopped"]
    assert Spoiled.step - 2 * guard.EVERY - 5 <= again.coupled.steps < Spoiled.step  # before the fault, two looks at most
    again.begin()
    for _ in range(20):  # past the step that failed
        again.tick(np.zeros(3))
    again.watch.check(again.coupled.fluid)


def test_fault_9_immediate_divergence_leaves_no_last_good_state_to_save(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(swim, "_stage", lambda args: Spoiled(domain=TINY, device="cpu"))
    monkeypatch.setattr(Spoiled, "step", 20)
    monkeypatch.setattr(Spoiled, "growth", 10.0)
    assert swim.main([*CPU, "--seconds", "1", "--save", str(tmp_path / "end"), "--json"]) == console.FAILED_CHECK
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["last_good"] == "" and not list(tmp_path.iterdir())


def test_fault_10_fish_at_the_domain_edge_ends_its_run_kept_and_flagged(tmp_path, monkeypatch, capsys):
    """A real fish, carried to the face by a real current."""
    monkeypatch.setattr(swim, "preset", lambda name: TINY)
    out = tmp_path / "trial"
    drifting = ["--amplitude", "0", "--speed", "0.5", "--seconds", "4", "--pose", "0.05", "0", "0"]
    assert swim.main([*CPU, *drifting, "--out", str(out), "--save", str(tmp_path / "end.safetensors"), "--json"]) == console.OK
    spoken = capsys.readouterr()
    assert "everything before is kept" in spoken.err
    found, kept = json.loads(spoken.out.splitlines()[-1]), read_trial(out)
    assert found["stopped"] == kept.value("oracle.stopped") and found["stopped"].startswith("left_domain at t = ")
    truth = kept.table("truth")
    assert 0.2 < truth["t"][-1] < 3.9 and np.isfinite(truth["x"]).all() and truth["x"][-1] < -0.02
    end = SwimSetup(domain=TINY, device="cpu").run()
    snapshot.load(tmp_path / "end.safetensors", end.coupled)
    room = margin(end.coupled.fluid, *end.coupled.body.bounds(end.coupled.boundary.corners))
    assert stability.CLEARANCE - 1 < room < stability.CLEARANCE  # it stopped there, not at the wall and not before


@pytest.mark.slow
def test_fault_10_trial_leaving_its_tank_is_flagged_failed_water_unscored(tmp_path, monkeypatch, capsys):
    robot = load_robot("fish")
    plan = trials(speeds=[0.4], los_deg=[0], repeats=1, duration=1.0)
    box = Domain(name="narrow", shape=(116, 28, 16), dx=0.02, dt=0.004, sponge=4)  # half a length of room behind the fish
    for module in (lbm, solver_water):
        monkeypatch.setattr(module, "preset", lambda name: box)
    judge = lambda folder: run_trials.judge_in_solver(control.make("drift", robot), robot, plan, folder, domain="x", device="cpu")
    left = judge(tmp_path)
    tick = int(left.left[0])
    assert 5 < tick < 51 and np.ptp(left.pose[0, tick:], axis=0).max() == 0, "the fish stays where it was"
    assert "truncated: left_domain at t = " in capsys.readouterr().err
    assert left.pose[0, tick - 2, 0] < left.pose[0, tick - 1, 0] and np.isfinite(left.distance).all()
    np.testing.assert_array_equal(judge(tmp_path).left, left.left)  # kept, with its flag
    assert figures(left)["power"] > 0

    row = {"left": np.array(51), "distance": np.full(51, 0.02)}
    failed = run_trials.ended(row, "water: 1.9 m/s is Mach 0.66", 30)
    assert failed["left"] == 31 and np.isnan(failed["distance"][31:]).all() and (failed["distance"][:31] == 0.02).all()
