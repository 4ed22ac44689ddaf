"""Judging in the flow solver, trial by trial: each is kept as it ends, its tank takes the next, a judgement that was cut goes on.

The tanks are replaced by a pond without water: a fish turns with its first joint, in a device that is slow where it flows fast.
"""

import csv
import io
from types import SimpleNamespace

import numpy as np
import pytest

from fishmj import control
from fishmj.base.ray_cluster import RayCluster
from fishmj.engines import FishState, Trace, drained, lbm
from fishmj.evaluate import metrics, run_trials, trial_logs, trial_report, trials
from fishmj.mjcf import load_robot

ROBOT = load_robot("fish")
PLAN = trials(speeds=[0.1, 0.3], los_deg=[0, 90], repeats=2, duration=1.0)
STEPS = round(PLAN.duration / ROBOT.timing.control_dt)


class Pond:
    """An engine of one fish; `made` are all that were ever made."""

    made: list["Pond"] = []

    def __init__(self, robot, flows, *, device, **box):
        assert len(flows) == 1
        self.robot, self.flow, self.box = robot, flows[0], box
        self.domain, self.stopped, self.ticks = SimpleNamespace(dx=0.02), [""], [0]
        self.made.append(self)

    def advancing(self, state, commands, params, current, tick):
        q, rows = np.array(state.q, float), []
        for command in commands[0]:
            for _ in range(5 if self.flow.speed > 0.2 else 1):
                yield
            q[0, 2] += 0.1 * command[0]
            q[0, :2] -= 0.01 * np.array([np.cos(q[0, 2]), np.sin(q[0, 2])])
            self.ticks[0] += 1
            rows.append((q[0, :3].copy(), command, np.zeros(3), np.zeros(3), 1.0))
        trace = Trace(*(np.stack(column)[None] for column in zip(*rows, strict=True)))
        return FishState(q, np.zeros((1, 6)), np.zeros(1), state.buffer, state.memory), trace

    def advance(self, *args):
        return drained(self.advancing(*args))


@pytest.fixture(autouse=True)
def ponds(monkeypatch):
    monkeypatch.setattr(lbm, "LbmEngine", Pond)
    monkeypatch.setattr(Pond, "made", [])
    return Pond.made


def judged(folder, brain="dob", **options):
    brain = control.make(brain, ROBOT) if isinstance(brain, str) else brain
    return run_trials.judge_in_solver(brain, ROBOT, PLAN, folder, device="cpu", **options)


def kept(folder):
    return sorted(path.name for path in (folder / run_trials.KEPT).glob("*.npz"))


def test_interrupted_tank_evaluation_resumes_with_the_missing_trials(tmp_path, ponds):
    class Cut(Exception):
        pass

    def cut(done):
        if kept(tmp_path) and done > 4.5 * STEPS:
            raise Cut

    with pytest.raises(Cut):
        judged(tmp_path, tanks=4, progress=cut)
    first = kept(tmp_path)
    assert 4 <= len(first) < 8, "the four slow ones are under way, the others are on disk"
    assert all("u0.1" in name for name in first[:4])
    before = len(ponds)
    again = judged(tmp_path, tanks=4)
    assert len(ponds) - before == 8 - len(first), "what was kept is not run again"
    whole = judged(None, tanks=1)
    for name in ("pose", "command", "obs", "distance", "left"):
        np.testing.assert_allclose(getattr(again, name), getattr(whole, name), rtol=1e-12, atol=1e-12)


def test_free_tank_takes_the_next_trial_within_the_tank_limit(ponds):
    seen = []
    judged(None, tanks=3, progress=lambda done: seen.append((done, sum(0 < pond.ticks[0] < 50 for pond in ponds))))
    assert max(busy for _, busy in seen) == 3 and seen[-1][0] == 8 * STEPS
    ends = [pond.ticks[0] for pond in ponds]
    assert ends == [50] * 8 and [done for done, _ in seen] == sorted(done for done, _ in seen)


def test_a_stopped_trial_is_kept_with_its_reason(tmp_path, monkeypatch, capsys):
    advancing = Pond.advancing

    def leaves(self, *args):
        found = yield from advancing(self, *args)
        self.stopped = ["left_domain at t = 0.2 s"] if self.flow.speed > 0.2 else [""]
        return found

    monkeypatch.setattr(Pond, "advancing", leaves)
    found = judged(tmp_path, tanks=3)
    assert (found.left[PLAN.speed > 0.2] == 51).all() and capsys.readouterr().err.count("truncated: left_domain") == 4
    assert (judged(tmp_path).left == found.left).all()


def test_figures_before_the_solver_fails_stand_and_the_report_counts_the_failures():
    whole = 3000  # ticks of a trial of a minute, at 2 cm from its target once it is there
    plan = trials(speeds=[0.2], los_deg=[0, 45, 90, 135, 180, 225], repeats=1)
    near = np.where(np.arange(whole + 1) < 250, 1.0, 0.02)
    rows = []
    for ticks in (2500, 1000, *[whole] * 4):  # the solver fails at 50 and at 20 s in two of six
        shape = lambda *n: np.zeros((whole, *n))
        row = {"pose": np.zeros((whole + 1, 3)), "velocity": np.zeros((whole + 1, 3)), "joint": np.zeros((whole + 1, 3))}
        row |= {"rate": np.zeros((whole + 1, 3)), "power": shape(), "command": shape(3), "obs": np.zeros((300, 11))}
        row |= {"distance": near, "left": np.array(whole + 1), "t": np.arange(whole + 1) * 0.02, "target": np.zeros(2)}
        rows.append(row if ticks == whole else run_trials.ended(row, "a marker moves at 9 m/s", ticks))
    found = run_trials.merged(control.make("dob", ROBOT), ROBOT, plan, "tanks, reference-2", rows)
    figures = metrics.figures(found)
    np.testing.assert_allclose(figures["rmse_after_arrival"], [0.02, np.nan, *[0.02] * 4])
    np.testing.assert_allclose(figures["rmse_last20"], [np.nan, np.nan, *[0.02] * 4])
    summed = metrics.summary(found)
    assert (summed["failed"], summed["left_domain"]) == (2, 0) and figures["arrival"].tolist() == [1.0] * 6
    (line,) = trial_report.failures([found])
    assert "failed in 2 of 6 trials, after 20.0 to 50.0 s" in line
    assert "arrives in 6 of 6 trials and holds station in 5" in trial_report.headline([found]) and trial_report.worst(found) == 1
    written = list(csv.DictReader(io.StringIO(trial_report.trials_csv([found]))))
    assert [row["solver_failed_at"] for row in written] == ["50.02", "20.02", *[""] * 4]


def test_a_controller_that_cannot_be_copied_judges_one_trial_after_another(ponds, capsys):
    class Odd:
        name = "odd"

        def __init__(self):
            self.inner = control.make("dob", ROBOT)
            self.lock = (part for part in ())  # no copy of a generator

        def reset(self, n):
            assert n == 1
            self.inner.reset(n)

        def __call__(self, obs):
            return self.inner(obs)

    one = judged(None, Odd(), tanks=4)
    assert "cannot be copied" in capsys.readouterr().err
    alone = judged(None, tanks=4)
    np.testing.assert_allclose(one.pose, alone.pose, rtol=1e-12, atol=1e-12)
    made = [control.make("dob", ROBOT), Odd(), control.make("dob", ROBOT)]
    for found in run_trials.judge_each_in_solver(made, ROBOT, PLAN, device="cpu", tanks=4):
        np.testing.assert_allclose(found.pose, alone.pose, rtol=1e-12, atol=1e-12)


def test_controllers_share_the_tanks_and_are_yielded_in_order(tmp_path, ponds):
    made = [control.make(name, ROBOT) for name in ("dob", "pd")]
    each = run_trials.judge_each_in_solver(made, ROBOT, PLAN, tmp_path, device="cpu", tanks=6)
    first = next(each)
    assert first.controller == "dob" and len(ponds) > 8, "free tanks have begun the next controller"
    second = next(each)
    assert second.controller == "pd" and len(kept(tmp_path)) == 16
    np.testing.assert_allclose(second.pose, judged(None, "pd").pose, rtol=1e-12, atol=1e-12)


def test_workers_of_a_cluster_get_what_is_not_kept(tmp_path, monkeypatch):
    """The cluster is replaced by this process, which takes groups of tasks and ends them in another order."""
    given = []

    def here(self, work, waiting, *, device, group, go_on):
        while waiting:
            tasks = [waiting.popleft() for _ in range(min(group, len(waiting)))]
            given.append([task.id for task in tasks])
            found = {task.id: task for task in tasks}
            yield from ((found[name], result) for name, result in reversed(list(work(tasks))))
            assert go_on(0.0)

    monkeypatch.setattr(RayCluster, "spread", here)
    whole = judged(None)
    found = judged(tmp_path, tanks=3, ray="auto")
    np.testing.assert_array_equal(found.pose, whole.pose)
    assert [len(names) for names in given] == [3, 3, 2] and given[0][0] == "dob_u0.1_los000_r0"
    (tmp_path / run_trials.KEPT / kept(tmp_path)[4]).unlink()
    given.clear()
    np.testing.assert_array_equal(judged(tmp_path, tanks=3, ray="auto").pose, whole.pose)
    assert given == [["dob_u0.3_los000_r0"]]


def test_trials_less_than_a_degree_apart_have_files_of_their_own(tmp_path):
    near = trials(speeds=[0.1], los_deg=[0, 0.25, 0.4], repeats=1, duration=1.0)
    names = [f"drift_{item.name}" for item in near.items]
    assert names == ["drift_u0.1_los000_r0", "drift_u0.1_los000.25_r0", "drift_u0.1_los000.40_r0"]
    result = run_trials.judge_in_solver(control.make("drift", ROBOT), ROBOT, near, tmp_path, device="cpu")
    assert len(kept(tmp_path)) == 3 == len({trial_logs.name_of(result, i) for i in range(3)})
