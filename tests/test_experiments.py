"""The paper's experiments: known answers of each, kept rows, and the command from end to end."""

import json
import re
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from policy_files import header, stored
from scipy.stats import spearmanr
from test_evaluate import hand_made
from test_evaluate_tasks import on_path, swim

from fishmj import control, evaluate
from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.control.policy import Policy
from fishmj.evaluate import metrics
from fishmj.evaluate.experiments import (
    MODULES,
    controller_comparison,
    experiment_of,
    experiment_training,
    experiments_report,
    initial_angle,
    input_ablation,
    input_saliency,
    learning_stages,
    path_tracking,
    rheotaxis_index,
    unsteady_flows,
)
from fishmj.evaluate.experiments import __main__ as command
from fishmj.evaluate.experiments.experiment_figures import compared, counted, read, rounded, series_row
from fishmj.evaluate.experiments.experiment_rows import ExperimentRows, identity_of
from fishmj.evaluate.experiments.paper_experiment import PAPER, ExperimentSetup
from fishmj.evaluate.run_trials import fingerprint, judge_in_solver
from fishmj.lbm_oracle.run.solver_water import PLAIN
from fishmj.mjcf.identity import robot_names, structure_of
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import in_water
from fishmj.water.flow import sample, stack

ROBOT = in_water(load_robot("fish"), "structured")
SECONDS = {"approach": 21, "figure_eight": 21, "rheotaxis": 90}  # that an experiment needs for its figures
JUDGED = tuple(name for name in MODULES if name not in ("stages", "ablations"))  # without a training


@dataclass(kw_only=True)
class BriefSetup(ExperimentSetup):
    """Setting whose trials last a few seconds, one of each condition."""

    seconds: float = 3.0

    def trials(self, **options):
        """Trials as asked, but brief."""
        return super().trials(**options | {"duration": self.seconds, "repeats": 1})


def setup_of(tmp_path, kind=BriefSetup, **changes) -> ExperimentSetup:
    return kind(**{"robot": ROBOT, "policy": "station", "seed": 0, "quick": True, "out": tmp_path} | changes)


def linear_policy(weight, memory: int = 1) -> Policy:
    """Policy of one layer, tanh(W obs / scale)."""
    weight = np.asarray(weight, np.float32)
    meta = {"scale": [2.0, 4.0], "activation": "tanh", "memory": memory}
    return Policy([(weight, np.zeros(len(weight), np.float32))], meta)


@pytest.mark.parametrize("name", JUDGED)
def test_experiment_runs_on_brief_trials_and_reports(name, tmp_path, monkeypatch):
    monkeypatch.setattr(unsteady_flows, "BEGINS", 1.0)
    setup, one = setup_of(tmp_path, seconds=SECONDS.get(name, 3)), experiment_of(name)
    parts = one.parts(setup)
    assert one.name == name and len({part.key for part in parts}) == len(parts)
    rows = {part.key: json.loads(json.dumps(part.run(lambda seconds: None), allow_nan=False)) for part in parts}
    found = one.findings(setup, rows)
    assert found.compared and found.pictures and all(picture.startswith(b"\x89PNG") for picture, _ in found.pictures)
    finished = experiments_report.FinishedExperiment(one, found, 1.0)
    alone, page = (experiments_report.page([finished] * n, "station", ["here"]) for n in (1, 2))
    assert alone.count("<th>the paper reports</th>") == 1, "one experiment has one table"
    assert page.count("<th>the paper reports</th>") == 3 and "Needs the real robot: " in page
    assert re.search(r"Figure of the paper: (\d+[^_]*|none[^_]*)\.", alone) and PAPER in alone
    used = set(re.findall(r'class="(left[2-9])', page))
    assert "left4" in used and all(f".{name} td" in page for name in used), "columns of words stand to the left"


def test_holm_adjusts_p_values_as_by_hand():
    """Sorted 0.01, 0.02, 0.04 times 3, 2, 1, and never below the one before."""
    assert metrics.holm([0.04, 0.01, 0.02]) == pytest.approx([0.04, 0.03, 0.04])
    assert metrics.holm([0.9, 0.6]) == pytest.approx([1.0, 1.0])
    assert metrics.holm([np.nan, 0.03]) == pytest.approx([np.nan, 0.03], nan_ok=True)


@pytest.mark.parametrize("angle", [0.0, 0.6, np.pi / 2, np.pi])
def test_rheotactic_index_of_a_fixed_heading_is_its_cosine(angle):
    pose = np.tile([0.0, 0.0, np.pi + angle], (1, 4501, 1))
    row = rheotaxis_index.index_row(hand_made(pose), bounded=True)
    assert row["cosine"] == pytest.approx([np.cos(angle)], abs=1e-4)
    assert row["linear"] == pytest.approx([1 - angle / (np.pi / 2)], abs=1e-4)


def test_random_gait_is_renewed_and_the_same_alone_and_in_a_batch():
    obs = np.random.default_rng(0).normal(size=(3, 11))

    def swim_of(seed: int, seen) -> np.ndarray:
        brain = rheotaxis_index.RandomGait(ROBOT, seed)
        brain.reset(len(seen))
        return np.stack([brain(seen) for _ in range(60)], 1)

    every = swim_of(1, obs)
    assert np.array_equal(swim_of(1, obs[1:2]), every[1:2]) and not np.array_equal(swim_of(2, obs), every)
    assert not np.array_equal(every[0], every[1]) and np.abs(every).max() < np.radians(50)
    assert np.ptp(every, axis=(1, 2, 3)).min() > 0.1


def test_saliency_of_a_linear_policy_is_its_weight():
    weight = np.array([[0.3, -0.8], [0.0, 0.5]])
    policy = linear_policy(weight)
    at_rest = policy.inputs(np.zeros((1, 2)))
    assert input_saliency.slopes(policy, at_rest)[0] == pytest.approx(weight / [2.0, 4.0], abs=1e-7)
    obs = np.array([[0.02, -0.04]])
    small = input_saliency.integrated(policy, policy.inputs(obs))[0]
    assert small == pytest.approx(weight * [0.01, -0.01], rel=1e-3)


@pytest.mark.parametrize("memory", [1, 3])
def test_integrated_gradients_sum_to_the_change_of_the_action(memory):
    policy, random = Policy.load("station"), np.random.default_rng(0)
    if memory > 1:
        policy = linear_policy(random.normal(size=(2, 2 * memory + 2 * (memory - 1))), memory)
    policy.reset()
    obs = random.normal(size=(5, policy.n_obs)) * policy.meta["scale"]
    inputs = policy.inputs(obs)
    action, slope = policy.jacobian(inputs.astype(float))
    assert action == pytest.approx(policy(obs), abs=1e-5)
    step = 1e-6 * random.normal(size=inputs.shape)
    assert policy.jacobian(inputs + step)[0] - action == pytest.approx(np.sum(slope * step[:, None], -1), abs=1e-9)
    if memory == 1:  # a share of the actions that a policy remembers belongs to no observation
        change = action - policy.jacobian(np.zeros_like(inputs))[0]
        assert input_saliency.integrated(policy, inputs).sum(-1) == pytest.approx(change, abs=0.05)


def test_saliency_counts_all_remembered_values_of_an_input():
    policy = linear_policy([[1.0, 2.0, 9.0, 9.0, 10.0, 20.0], [0.0] * 6], memory=2)
    found = input_saliency.slopes(policy, policy.inputs(np.zeros((1, 2))))
    assert found[0, 0] == pytest.approx([11 / 2, 22 / 4])


def test_rank_correlation_is_spearmans():
    one, other = np.random.default_rng(3).random((2, 4, 11))
    expected = [spearmanr(a, b).statistic for a, b in zip(one, other, strict=True)]
    assert input_saliency.rank_correlation(one, other) == pytest.approx(expected)
    assert input_saliency.rank_correlation(one, -one) == pytest.approx(-1)


def test_a_policy_of_another_fish_is_refused_with_the_robot_that_it_swims(tmp_path, capsys):
    policy = stored(tmp_path, header(robot="mine", structure=structure_of(ROBOT) | {"lengths": [0.2, 0.1, 0.1, 0.1]}))
    assert console.run(command.main, ["approach", "--policy", str(policy), "--out", str(tmp_path / "out")]) == console.BAD_INPUT
    assert "it was trained for 'mine': name that robot, --robot FILE" in capsys.readouterr().err


def test_the_experiments_swim_the_robot_that_is_named(tmp_path, capsys):
    setup = command.setup_of(command.options().parse_args(["--robot", "tendon_fish", "--policy", "pi", "--out", str(tmp_path)]))
    assert setup.robot.name == "tendon_fish" and setup.brain.name == "pi"
    assert experiment_training.settings_of(setup).robot == "tendon_fish"
    assert console.run(command.main, ["approach", "--robot", "tendon_fish", "--out", str(tmp_path / "out")]) == console.BAD_INPUT
    assert "it was trained for 'swift': name that robot, --robot fish" in capsys.readouterr().err


def test_saliency_needs_a_policy(tmp_path):
    setup = setup_of(tmp_path, policy="dob")
    with pytest.raises(ConfigError, match="dob is not a policy"):
        input_saliency.parts(setup)
    assert command.possible(setup) == [name for name in MODULES if name != "saliency"]


def test_mirrored_trials_give_mirrored_swims_of_a_symmetric_controller(tmp_path):
    setup = setup_of(tmp_path)
    some = setup.trials(task="angle_of_attack", turbulence="none")
    rows = [series_row(setup.judge("drift", trials, lambda s: None)) for trials in (some, initial_angle.MirroredTrials.of(some))]
    assert np.abs(read(rows[0]["side"])).max() > 0.01, "joint zeros and starts turn the fish"
    assert initial_angle.asymmetry(*rows) == pytest.approx(0, abs=2e-3)
    assert initial_angle.asymmetry(rows[0], rows[0])[1] > 0.01, "a swim is not its own mirror image"


@pytest.mark.filterwarnings("error")
def test_fish_that_all_leave_give_no_warning_and_no_figure():
    holes = np.full((2, 4, 3), np.nan)
    holes[:, 0] = 0.1
    rows = [dict.fromkeys(("upstream", "side"), rounded(one, 3)) for one in holes]
    assert initial_angle.asymmetry(*rows)[0] == pytest.approx(0.2) and np.isnan(initial_angle.asymmetry(*rows)[1:]).all()
    median = initial_angle.over_known(np.nanmedian, np.array([[1.0, np.nan], [3.0, np.nan]]))
    assert median[0] == 2 and np.isnan(median[1])


def test_fish_on_the_figure_eight_has_no_error_at_any_arc_length():
    row = path_tracking.path_row(swim(on_path(), "figure_eight"))
    assert len(row["by_arc"]["0.2"]) == path_tracking.BINS and max(row["by_arc"]["0.2"]) < 5e-4
    aside = path_tracking.path_row(swim(on_path(aside=0.05), "figure_eight"))
    assert np.median(aside["by_arc"]["0.2"]) == pytest.approx(0.05, abs=1e-3)


def test_stream_changes_within_a_trial_and_carries_a_passive_fish(tmp_path):
    setup = setup_of(tmp_path, kind=ExperimentSetup)
    plain = setup.trials(speeds=[0.2], los_deg=[0], repeats=1, duration=40, turbulence="none")
    changed = unsteady_flows.ChangingTrials.of(plain, 0.3, np.radians(90))
    assert changed.mean(30.0)[0] == pytest.approx([0.2, 0.0]) and changed.mean(32.5)[0] == pytest.approx([0.1, 0.15])
    before, after = (setup.judge("drift", trials, lambda s: None) for trials in (plain, changed))
    same = before.t <= 30
    assert np.array_equal(before.pose[:, same], after.pose[:, same])
    assert after.velocity[0, -1, 1] > 0.1 > abs(before.velocity[0, -1, 1]) + 0.05
    with pytest.raises(ConfigError, match="the solver's stream is steady"):
        judge_in_solver(control.make("drift", ROBOT), ROBOT, changed)


def test_eddies_keep_their_places_when_the_stream_changes(tmp_path):
    some = unsteady_flows.ChangingTrials.of(evaluate.trials(speeds=[0.2], los_deg=[0], repeats=1, intensity=0.3), 0.4, 0.5)
    points, tick, old = np.random.default_rng(0).normal(size=(1, 9, 2)), np.array([1600]), stack(some.flows())
    new = some.stream(old, 32.0)
    by = sample(np, new, points, tick)[0] - sample(np, old, points, tick)[0]
    assert by == pytest.approx(np.tile(some.mean(32.0) - some.mean(0.0), (9, 1))[None], abs=1e-6)


def test_mirrored_trial_has_a_file_name_of_its_own_in_the_solver(tmp_path):
    some = setup_of(tmp_path).trials(task="angle_of_attack")
    brain = control.make("drift", ROBOT)
    assert fingerprint(brain, ROBOT, some, PLAIN) != fingerprint(brain, ROBOT, initial_angle.MirroredTrials.of(some), PLAIN)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["approach", "figure_eight", "flows", "saliency"])
def test_experiment_runs_in_the_flow_solver(name, tmp_path):
    """Other starts do not fit into the smallest box: the fish would touch its walls."""
    solver = PLAIN._replace(domain="laptop", dx=0.04)
    setup = setup_of(tmp_path, seconds=1.0, solver=solver, device="cpu")
    row = experiment_of(name).parts(setup)[0].run(lambda seconds: None)
    json.dumps(row, allow_nan=False)
    assert list((tmp_path / "lbm").glob("*.npz"))
    if name == "approach":
        assert len(row["t"]) == 6 and row["distance"][0][0] == pytest.approx(1.4, abs=1e-3)


def test_solver_without_a_gpu_is_asked_for_first(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("fishmj.lbm_oracle.run.solver_cost.accelerator", lambda need: False)
    code, _, err = run_command(capsys, "approach", "--water", "lbm", "--out", str(tmp_path))
    assert code == 2 and "no accelerator was found" in err and not list(tmp_path.iterdir())


def test_return_of_a_fish_at_rest_on_its_target_is_one_a_step():
    pose = np.zeros((2, 1501, 3))
    result = hand_made(pose)
    assert experiment_training.returns(result) == pytest.approx([150, 150])
    left = experiment_training.returns(result._replace(left=np.array([1000, 1502])))
    assert left == pytest.approx([99, 150]), "no reward after leaving"


def test_training_of_a_variant_has_the_settings_of_the_command(tmp_path):
    setup = setup_of(tmp_path, quick=False)
    every = {name: experiment_training.settings_of(setup, **changes) for name, changes in input_ablation.VARIANTS.items()}
    assert every["complete"].preset == "quick" and every["complete"].water == "structured"
    assert every["no self-velocity"].task["hide"] == ("velocity", "yaw_rate")
    assert every["no self-velocity"].task["turbulence"] == every["complete"].task["turbulence"]
    assert len(experiment_of("ablations").parts(setup)) == 3 * 4 and len(experiment_of("stages").parts(setup)) == 3


def test_ablation_gathers_all_trainings_of_a_variant(tmp_path):
    figures = {"arrival": [1.0] * 6, "rmse_after_arrival": [0.1, 0.2] * 3}
    place = lambda x: {"return": [x, x + 2.0] * 3, "figures": figures}
    rows = {
        f"{name}, run {k}": {"trained": place(10.0 * i + k), "judged": place(5.0 * i)}
        for i, name in enumerate(input_ablation.VARIANTS)
        for k in (1, 2)
    }
    assert input_ablation.gathered(rows, "complete", "trained", "return").mean() == pytest.approx(2.5)
    found = input_ablation.findings(setup_of(tmp_path), rows)
    assert found.compared[0].n == 12 and found.tables[0][1][0]["return"].startswith("+10.0")


def variant_file(folder, name: str, hide=(), water: str = "structured") -> None:
    """Policy file of a variant with weights that differ by name."""
    random = np.random.default_rng(len(name))
    layer = 0.3 * random.normal(size=(3, 11)), np.zeros(3)
    Policy.of(in_water(load_robot("fish"), water), [layer], hide=hide).save(folder / f"{name}.safetensors")


def test_ablation_judges_policies_of_a_folder_in_both_waters(tmp_path):
    for name, changes in input_ablation.VARIANTS.items():
        hide = changes.get("task", {}).get("hide", ())
        water = "none" if name == "no friction calibration" else "structured"
        variant_file(tmp_path, name.replace(" ", "-"), hide, water)
    setup = setup_of(tmp_path, trained=tmp_path, seconds=30)
    parts = input_ablation.parts(setup)
    assert [part.key.split(",")[0] for part in parts] == list(input_ablation.VARIANTS)
    row = parts[0].run(lambda seconds: None)
    assert row["trained"] == row["judged"] and len(row["judged"]["return"]) == 8
    other = parts[1].run(lambda seconds: None)
    assert other["trained"]["return"] != other["judged"]["return"]
    variant_file(tmp_path, "complete-1")
    with pytest.raises(ConfigError, match="complete 2, no friction calibration 1"):
        input_ablation.parts(setup)


def test_ablation_refuses_a_policy_with_other_inputs(tmp_path):
    setup = setup_of(tmp_path, trained=tmp_path)
    with pytest.raises(ConfigError, match="no policy of the variant 'complete'"):
        input_ablation.parts(setup)
    variant_file(tmp_path, "complete", hide=("velocity",))
    with pytest.raises(ConfigError, match="--hide velocity; expected nothing hidden"):
        input_ablation.parts(setup)


@pytest.mark.slow
def test_stages_are_trained_kept_and_not_trained_again(tmp_path, monkeypatch):
    monkeypatch.setattr(experiment_training, "QUICK", {"steps": 4096, "algorithm": {"envs": 16, "hidden": (8,)}})
    monkeypatch.setattr(learning_stages, "STAGES", {"S1": 1024, "S2": 2048})
    setup = setup_of(tmp_path)
    (part,) = learning_stages.parts(setup)
    row = part.run(lambda seconds: None)
    assert [one["steps"] for one in row["stages"].values()] == [1024, 2048, 4096]
    one, two = (Policy.load(next(tmp_path.glob(f"training/*/stage-{k}.safetensors"))) for k in (1, 3))
    assert not np.array_equal(one.weights[0][0], two.weights[0][0]) and row["curve"]["step"][-1] >= 4096
    monkeypatch.setattr("fishmj.train.training_run.TrainingRun", None)  # another training would fail
    assert part.run(lambda seconds: None)["stages"] == row["stages"]
    assert learning_stages.findings(setup, {"run 1": row}).pictures


def test_comparison_with_itself_finds_no_difference(tmp_path):
    setup = setup_of(tmp_path)
    row = controller_comparison.comparison_row(setup.judge("pd", setup.trials(), lambda s: None))
    (same,) = controller_comparison.tested({"one": row, "other": row, "privileged": row, "drift": row})["power"]
    assert same["difference (95 %)"] == "+0.000 (+0.000 +0.000)" and same["Welch p, Holm"] == 1.0 and same["pairs"] == 24
    assert same["paired p, Holm"] == 1.0 and same["policy is"] == "not told apart"
    assert controller_comparison.paper_count("adrc-c2") == "70 of 72" and controller_comparison.paper_count("pd") == ""
    assert controller_comparison.paper_count("koopman") == "6 of 72" and controller_comparison.paper_count("koopman-flow") == ""


def errors_row(**figures) -> dict:
    """Row of a controller with figures of 8 trials; others do not vary."""
    plain = dict.fromkeys(("rmse_after_arrival", "rmse_last20", "approach_time", "power"), [1.0] * 8)
    return {"figures": plain | {key: list(values) for key, values in figures.items()}, "los": [0] * 8}


SIGNS = np.array([1, -1] * 4)


def test_policy_is_better_only_where_pairs_are_told_apart():
    """Differences 0.01 to 0.08 exclude 0; signs that alternate do not; both rivals of a test count for Holm."""
    steps = np.arange(1, 9) / 100
    rows = {
        "policy": errors_row(),
        "worse": errors_row(rmse_after_arrival=1 + steps),
        "less": errors_row(rmse_after_arrival=1 - steps),
        "alike": errors_row(rmse_after_arrival=1 + steps * SIGNS),
    }
    found = controller_comparison.tested(rows)["rmse_after_arrival"]
    assert [row["policy is"] for row in found] == ["better", "worse", "not told apart"]
    least = 2 / (metrics.RESAMPLES + 1)
    assert metrics.paired_p([1.0] * 8, 1 + steps) == pytest.approx(least), "no draw of one sign has another mean"
    assert found[0]["paired p, Holm"] == pytest.approx(3 * least, rel=0.05)
    assert np.isnan(metrics.paired_p([1.0] * 5, [2.0] * 5)), "five pairs never tell apart"
    few = metrics.paired_p(np.zeros(8), steps * SIGNS)
    assert (few < 0.05) == metrics.difference("rmse_after_arrival", np.zeros(8), steps * SIGNS).apart


def test_gap_to_a_bound_is_closed_by_the_share_between():
    errors = {"p": 0.3, "a": 0.5, "b": 0.7, "privileged": 0.1, "drift": 0.2}
    rows = {name: errors_row(rmse_after_arrival=[x] * 8, rmse_last20=[2 * x] * 8) for name, x in errors.items()}
    for key in controller_comparison.DECIDING:
        found = controller_comparison.gap_closed(rows, key)
        assert (found.value, found.low, found.high, found.n) == pytest.approx((0.5, 0.5, 0.5, 8)) and " a " in found.what
    for name in ("a", "b"):
        rows[name]["figures"]["rmse_after_arrival"] = [0.0, 0.2] * 4  # no worse than the bound
    assert controller_comparison.gap_closed(rows, "rmse_after_arrival").measured.startswith("no gap")


def test_findings_have_value_interval_and_number_of_trials():
    assert compared("x", "1 m", [1.0, 1.0, 1.0, 1.0, 1.0], "m") == ("x", "1 m", "1.000 (1.000 1.000) m", 1.0, 1.0, 1.0, 5)
    assert compared("x", "", [1.0, 1.0, 1.0, 1.0, 1.0, None], "m").measured == "1.000 (1.000 1.000) m, 5 of 6 trials"
    assert compared("x", "", [None]).measured == "none of 1 trials"
    all_of_them = counted("x", "all", [1, 1, 1, 1])
    assert all_of_them.measured == "4 of 4" and all_of_them.low == pytest.approx(0.510, abs=1e-3), "Wilson's interval"
    assert read(rounded([[1.23456, np.nan]], 2)) == pytest.approx(np.array([[1.23, np.nan]]), nan_ok=True)


def test_rows_of_other_conditions_and_broken_lines_are_not_used(tmp_path):
    rows = ExperimentRows(tmp_path, "approach", "here")
    rows.add("one", {"x": [1.0]}, 0.5)
    rows.add("two", {"x": [2.0]}, 0.5)
    rows.path.write_text(rows.path.read_text() + '{"key": "three", "identity": "here", "ro')
    assert set(ExperimentRows(tmp_path, "approach", "here").rows) == {"one", "two"}
    other = ExperimentRows(tmp_path, "approach", "there")
    assert not other.rows
    other.add("one", {"x": [3.0]}, 0.1)
    assert len(rows.path.read_text().splitlines()) == 1
    with pytest.raises(ValueError, match="Out of range"):
        other.add("bad", {"x": float("nan")}, 0.1)


def test_identity_changes_with_what_changes_a_row(tmp_path):
    base = {"policy": "station", "seed": 0, "quick": True, "robot": ROBOT}
    changes = ({"policy": "dob"}, {"seed": 1}, {"quick": False}, {"robot": in_water(load_robot("fish"))})
    assert len({identity_of(setup_of(tmp_path, **base | one)) for one in ({}, *changes)}) == 5


def run_command(capsys, *argv) -> tuple[int, str, str]:
    code = console.run(command.main, list(argv))
    out = capsys.readouterr()
    return code, out.out, out.err


def test_command_reports_and_continues_with_the_parts_that_are_there(tmp_path, capsys):
    line = ["approach", "--quick", "--policy", "dob", "--water", "structured", "--out", str(tmp_path), "--json"]
    code, out, err = run_command(capsys, *line)
    told = json.loads(out.splitlines()[-1])
    assert code == 0 and "run before" not in err and told["policy"] == "dob"
    first = told["experiments"]["approach"]["compared"][0]
    assert first["what"] == "approach time, downstream" and first["paper"] == "at most 5 s" and first["n"] == 8
    page, robot = (tmp_path / "report.html").read_text(), told["robot"]
    assert "at most 5 s" in page and f"Robot swift, shipped as fish, sha256 {robot['sha256'][:12]}<" in page.split("</header>")[0]
    assert robot == robot_names(ROBOT) | {"file": "fish"}
    path = tmp_path / "approach.jsonl"
    whole = path.read_text()
    path.write_text(whole.splitlines()[0] + "\n")  # interrupted after the first part
    code, out, err = run_command(capsys, *line)
    again = json.loads(out.splitlines()[-1])
    assert code == 0 and "1 of 2 parts" in err
    assert again["experiments"]["approach"]["compared"] == told["experiments"]["approach"]["compared"]
    kept = {file: file.read_bytes() for file in tmp_path.glob("*.*")}
    others = {
        "seed 0, got 1": [*line, "--seed", "1"],
        "policy.name dob, got pi": ["pi" if word == "dob" else word for word in line],
    }
    for what, other in others.items():
        code, _, err = run_command(capsys, *other)
        assert code == 2 and f"was begun with {what}; repeat the options to go on, or take another --out" in err
    assert {file: file.read_bytes() for file in tmp_path.glob("*.*")} == kept, "rows and report stay"


def test_policy_of_another_water_is_said_on_the_page(tmp_path, capsys):
    code, _, err = run_command(capsys, "approach", "--water", "structured", "--out", str(tmp_path))
    assert code == 0 and "not as trained" in err and "not as trained" in (tmp_path / "report.html").read_text()


def test_command_lists_all_experiments_with_their_cost(capsys):
    code, out, _ = run_command(capsys)
    assert code == 0 and all(name in out for name in MODULES) and "CPU time" in out


def test_list_of_experiments_loads_none_of_the_heavy_packages():
    code = "import sys; from fishmj.evaluate.experiments import __main__ as verb; verb.main([]); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy = {"jax", "mujoco", "scipy", "matplotlib", "numba", "warp"}
    assert "fishmj.evaluate.experiments.input_saliency" in done.stdout and heavy.isdisjoint(done.stdout.split())


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (["aproach"], "Did you mean 'approach'"),
        (["approach", "--reference"], "needs --water lbm"),
        (["approach", "--trained", "runs/a"], "--trained has an effect with ablations only"),
        (["--quick"], "--quick without a NAME"),
        (["--out", "runs/a"], "--out without a NAME"),
        (["ablations", "--trained", "no_such_folder"], "no policy of the variant 'complete'"),
        (["approach", "--water", "hybrid"], "experiments supports"),
        (["approach", "--policy", "statoin"], "station"),
    ],
)
def test_wrong_command_is_one_clear_line(line, said, capsys):
    code, _, err = run_command(capsys, *line)
    assert code == 2 and said in err
