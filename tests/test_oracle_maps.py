"""Force maps and drifts of the flow solver: signs, symmetry, rows that are kept, tracers against fields with known answers."""

import json
from collections import deque

import numpy as np
import pytest

from fishmj.base import console
from fishmj.base.errors import ConfigError, OracleUnstable, UsageError
from fishmj.lbm_oracle.cases.maps import average
from fishmj.lbm_oracle.drifters import drift, tracers
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.force_maps import forcemap
from fishmj.lbm_oracle.force_maps.force_points import AveragingTimes, Point, loads, measure_points
from fishmj.lbm_oracle.run.domain import Domain
from fishmj.lbm_oracle.run.run import LeftDomain, Run
from fishmj.water.flow import Flow

TINY = Domain(name="tiny", shape=(56, 44, 16), dx=0.02, dt=0.004, sponge=4)
PLAN = AveragingTimes(settle=0.4, seconds=0.6, length=0.5)


def held(point):
    made = forcemap.stage(TINY, point, device="cpu")
    return made.run(tethered=True, prescribed=lambda t: point.joints(3))


def sweep(points, make=held, **options):
    """Rows by point."""
    return {point: row for point, row, _ in measure_points(deque(points), make, PLAN, tick=0.02, **options)}


# force maps ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_mirrored_fish_feels_mirrored_forces_and_drag_points_downstream():
    """F_x, F_y, M (-a, -theta) = F_x, -F_y, -M within 2 % of the peak; a current from the left pushes to the right."""
    one, two, straight = Point("aoa", 30.0, 60.0, 0.3), Point("aoa", -30.0, -60.0, 0.3), Point("joint", 0.0, 0.0, 0.3)
    broad = Point("aoa", 0.0, 70.0, 0.3)
    rows = sweep([one, two, straight, broad], tanks=2)
    assert all(row["status"] == "ok" and row["seconds"] == pytest.approx(0.6) for row in rows.values())
    peak = abs(rows[broad]["lateral_N"])
    for name, sign in (("drag_N", 1), ("lateral_N", -1), ("yaw_Nm", -1)):
        assert rows[two][name] == pytest.approx(sign * rows[one][name], abs=0.02 * (peak if name[-1] == "N" else 0.2 * peak))
    assert abs(rows[straight]["lateral_N"]) < 0.02 * peak and rows[straight]["drag_N"] > 0
    assert rows[broad]["lateral_N"] > 5 * rows[straight]["drag_N"]
    assert abs(rows[one]["lateral_N"]) > 0.05 * peak  # else the mirror would compare nothing


def test_the_fish_is_held_and_its_joints_keep_their_angle():
    run = held(Point("joint", 35.0, 0.0, 0.3))
    before = run.coupled.body.data.qpos.copy()
    for _ in range(10):
        run.tick()
    np.testing.assert_allclose(run.coupled.body.data.qpos, before, atol=1e-9)
    tail = run.coupled.body.data.xpos[-1]
    assert tail[0] < 0 and tail[1] < -0.01  # behind and, for a positive angle, to the right
    assert loads(run).shape == (10, 3) and loads(run, 20).shape == (0, 3)


def test_a_point_that_diverges_or_leaves_is_a_row_and_the_others_go_on():
    def make(point):
        run = held(point)

        def fence(coupled):
            if coupled.time > 0.5:
                raise LeftDomain("left_domain: test")

        run.follow = fence if point.aoa else run.follow
        return run

    good, bad = Point("joint", 0.0, 0.0, 0.3), Point("aoa", 0.0, 10.0, 0.3)
    rows = sweep([bad, good], make, tanks=2)
    assert rows[good]["status"] == "ok" and rows[bad]["status"] == "left_domain: test"
    assert 0 < rows[bad]["seconds"] < 0.2 and np.isfinite(rows[bad]["drag_N"])


def test_water_that_fails_leaves_the_forces_before_it_in_the_row():
    def make(point):
        run = held(point)

        def spoil(coupled):
            if coupled.steps == 180:
                values = coupled.fluid.f.numpy()
                values[:, 20:30, 20:30] = np.nan
                coupled.fluid.f.assign(values)

        run.follow = spoil
        return run

    point = Point("joint", 0.0, 0.0, 0.3)
    row, sound = sweep([point], make)[point], sweep([point])[point]
    assert row["status"] != "ok"
    assert 0 < row["seconds"] < 0.33
    assert row["drag_N"] == pytest.approx(sound["drag_N"], rel=0.5)


def test_the_command_keeps_its_rows_and_does_only_what_is_missing(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(forcemap, "preset", lambda name: TINY)
    started, run = [], Run.begin
    monkeypatch.setattr(Run, "begin", lambda self: (started.append(1), run(self))[1])
    base = ["--speeds", "0.2", "--settle", "0", "--seconds", "0.2", "--device", "cpu", "--out", str(tmp_path), "--what", "joint"]
    assert forcemap.main([*base, "--angles", "0", "--fields"]) == console.OK and len(started) == 1
    assert forcemap.main([*base, "--angles", "0", "20", "--json"]) == console.OK and len(started) == 2
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert [row["joint_deg"] for row in said["rows"]] == [0, 20] and said["stopped"] == 0
    assert (tmp_path / "forces_joint.png").exists() and (tmp_path / "fields" / "joint_joint0_aoa0.png").exists()
    assert len((tmp_path / "forcemap.csv").read_text().splitlines()) == 3
    with pytest.raises(ConfigError, match="slip = 1.0 .now 0.5."):
        forcemap.main([*base, "--slip", "0.5"])
    with pytest.raises(ConfigError, match="turn by 60 at most"):
        forcemap.main([*base, "--angles", "70"])
    with pytest.raises(UsageError, match="expected a number above 0"):
        forcemap.main(["--speeds", "0"])
    with pytest.raises(ConfigError, match="0.2 s or more"):
        forcemap.main(["--seconds", "0.1", "--device", "cpu", "--out", str(tmp_path)])


def test_standard_error_accounts_for_autocorrelation_of_samples():
    """An AR(1) record has T_c (1 + a) / (1 - a) / 2 steps: its error is sqrt(19) times that of white noise at a = 0.9."""
    rng = np.random.default_rng(1)
    errors, means = [], []
    for _ in range(40):
        x = np.zeros(4000)
        for i, kick in enumerate(rng.standard_normal(4000)):
            x[i] = 0.9 * x[i - 1] + kick
        found = average(x)
        errors.append(found.sem)
        means.append(found.mean)
    assert np.mean(errors) == pytest.approx(10 / np.sqrt(4000), rel=0.15)  # s sqrt(19 / n), s = 1 / sqrt(0.19)
    assert np.std(means) == pytest.approx(np.mean(errors), rel=0.35)
    assert average([3.0, 3.0, 3.0])[:3] == (3.0, 0.0, 0.0)
    assert np.isnan(average([]).mean)


# drifts -------------------------------------------------------------------------------------------------------------


def turning(points, rate=2.0):
    """Water in rigid rotation."""
    return rate * np.stack([-points[:, 1], points[:, 0], 0 * points[:, 0]], -1)


def test_a_marker_in_rigid_rotation_goes_round_and_turns_with_the_water():
    release = tracers.Release(times=(0.0, 1.0), start=(0.5, 0.0, 0.0), low=(-9, -9), high=(9, 9), longest=2 * np.pi, width=0.04)
    (one, two) = tracers.carry(((0.01 * i, turning) for i in range(800)), release)
    assert one[-1, 3] == pytest.approx(2 * one[-1, 0], rel=1e-6)  # heading = rate t
    np.testing.assert_allclose(np.hypot(one[:, 1], one[:, 2]), 0.5, rtol=2e-4)
    assert two[0, 0] == pytest.approx(1.0) and two[-1, 0] - two[0, 0] == pytest.approx(one[-1, 0], abs=0.011)
    assert tracers.figures([one, two])["turned"] == 2  # 4 pi each


def test_shear_turns_a_marker_with_half_its_vorticity():
    shear = lambda p: np.stack([0.3 - 0.4 * p[:, 1], 0 * p[:, 0], 0 * p[:, 0]], -1)
    assert tracers.spin(shear, np.array([[0.1, 0.2, 0.0]]), 0.05)[0] == pytest.approx(0.2)


def test_reading_between_nodes_is_exact_in_a_linear_field():
    lattice = Lattice(dx=0.1, dt=0.02, corner=(-0.4, -0.3, -0.2))
    nodes = np.stack(np.meshgrid(*map(np.arange, (9, 7, 5)), indexing="ij"), -1)
    matrix = np.array([[0.2, -1.0, 0.3], [0.5, 0.1, 0.0], [0.0, 0.7, -0.3]])
    water = tracers.trilinear(lattice.to_si(nodes + (2, 0, 0)) @ matrix.T, lattice, np.array([2, 0, 0]))
    points = np.random.default_rng(0).uniform((-0.2, -0.3, -0.2), (0.6, 0.3, 0.2), (50, 3))
    np.testing.assert_allclose(water(points), points @ matrix.T, atol=1e-12)


def test_solver_and_prescribed_flow_carry_tracers_alike_at_first():
    """In 0.6 s the eddies of the tank are still much those that were prescribed."""
    box = Domain(name="tiny", shape=(48, 40, 16), dx=0.04, dt=0.004, sponge=4)
    flow = Flow(speed=0.3, turbulence="default", seed=4)
    release = drift.release_markers(box, flow, n=3, seconds=0.6, interval=0.1, width=0.08)
    solver = tracers.carry(drift.in_solver(box, flow, settle=0.0, end=0.8), release)
    given = tracers.carry(drift.in_flow(flow, end=0.8), release)
    for one, two in zip(solver, given, strict=True):
        assert one[-1, 0] - one[0, 0] == pytest.approx(0.6)
        off, asked = (track[-1, 1:3] - track[0, 1:3] - (0.6 * 0.3, 0.0) for track in (one, two))
        assert np.hypot(*(off - asked)) < 0.3 * np.hypot(*asked)  # off the mean path, by the same eddies
    assert solver[0][-1, 3] == pytest.approx(given[0][-1, 3], rel=0.1) and abs(given[0][-1, 3]) > 0.01


def test_the_drift_command_answers_and_says_when_it_is_too_short(tmp_path, capsys):
    base = ["--water", "flow", "--n", "3", "--interval", "0.5", "--out", str(tmp_path), "--json"]
    assert drift.main([*base, "--turbulence", "gust", "--seconds", "1"]) == console.OK
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert said["markers"] == 3 and said["turned"] == 0  # a uniform gust has no vorticity
    assert said["greatest_span_rad"] == pytest.approx(0.0, abs=1e-9)
    assert (tmp_path / "drift_flow.png").exists() and (tmp_path / "drift_flow.csv").read_text().startswith("marker,t,x,y,heading")
    assert drift.main([*base, "--turbulence", "default", "--seconds", "0.5"]) == console.CANNOT_TELL
    for bad in (["--speed", "0"], ["--n", "0"], ["--spin-box", "0"]):
        with pytest.raises(UsageError, match=bad[0]):
            drift.main(bad)


def test_water_that_fails_on_the_way_keeps_the_drifts_until_then(tmp_path, monkeypatch):
    def failing(flow, *, end):
        for tick in range(20):
            yield 0.02 * tick, lambda p: np.tile([0.2, 0.0, 0.0], (len(p), 1))
        raise OracleUnstable("fluid: test")

    monkeypatch.setattr(drift, "in_flow", failing)
    assert drift.main(["--water", "flow", "--n", "2", "--interval", "0.1", "--out", str(tmp_path)]) == console.FAILED_CHECK
    assert json.loads((tmp_path / "drift_flow.json").read_text())["stopped"] == "fluid: test"
    assert len((tmp_path / "drift_flow.csv").read_text().splitlines()) > 5
