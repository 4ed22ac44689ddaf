"""Work of days and memory that is not there is said with an estimate before it begins: refused, or asked on a terminal."""

import io
import json
import os
from argparse import Namespace

import pytest
from bad_commands import HOPELESS, prepare, without_progress

from fishmj import cli
from fishmj.base import console, cost
from fishmj.base.errors import TooMuch
from fishmj.gap.bench import bench_command as bench
from fishmj.gap.bench import bench_rows
from fishmj.lbm_oracle.run import solver_cost as solver
from fishmj.lbm_oracle.run.domain import preset
from fishmj.train import training_cost as training
from fishmj.train.build import settled
from fishmj.train.settings import PRESETS, change


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def without_an_accelerator(monkeypatch):
    monkeypatch.setattr(solver, "accelerator", lambda need: False)
    monkeypatch.setattr(solver, "usable_cores", lambda: 2)
    monkeypatch.setattr(training, "_kind", lambda: training.CPU)
    monkeypatch.setattr(training, "usable_cores", lambda: 2)
    monkeypatch.setattr(bench_rows, "usable_cores", lambda: 2)
    monkeypatch.setattr(cost, "memory_bytes", lambda: 16 * 2**30)


def listing(folder):
    return sorted(os.path.join(root, name) for root, folders, files in os.walk(folder) for name in (*folders, *files))


@pytest.mark.parametrize("name", sorted(HOPELESS))
def test_infeasible_command_is_refused_with_an_estimate_before_it_starts(name, tmp_path, monkeypatch, capsys):
    prepare(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", io.StringIO())  # nobody answers
    before = listing(tmp_path)
    code = console.run(cli.dispatch, [*HOPELESS[name], "--json"])
    out, err = capsys.readouterr()
    assert code == console.BAD_INPUT and len(without_progress(err)) == 1 and "nothing was begun" in err, err
    assert any(unit in err for unit in (" h ", " days", " years", " GB")), err
    assert "begins all the same" in err or "memory" in err, err
    assert json.loads(out)["kind"] == "TooMuch" and listing(tmp_path) == before


@pytest.mark.parametrize(("answer", "goes_on"), [("y\n", True), ("\n", False), ("", False)])
def test_on_a_terminal_it_is_a_question(answer, goes_on, monkeypatch):
    asked = Terminal()
    monkeypatch.setattr("sys.stdin", Terminal(answer))
    monkeypatch.setattr("sys.stderr", asked)
    ask = lambda: cost.time("train", 10 * cost.LONG, "much", instead="take less", flag="--yes")
    if goes_on:
        ask()
    else:
        pytest.raises(TooMuch, ask)
    assert "train: much would take about 70 days; take less. Begin all the same? [y/N]" in asked.getvalue()


def test_what_was_agreed_to_and_what_is_short_is_not_asked():
    cost.time("x", 10 * cost.LONG, "much", instead="-", flag="--yes", agreed=True)
    cost.time("x", cost.LONG, "enough", instead="-", flag="--yes")
    cost.memory("x", 12 * 2**30, "much", instead="-")
    with pytest.raises(TooMuch, match=r"would need about 14 GB of memory, there are 16 GB; nothing was begun: take less$"):
        cost.memory("x", 14 * 2**30, "much", instead="take less")


def test_the_estimate_of_the_solver_is_that_of_the_measured_swim():
    """The laptop preset swims at 0.60 times real time on two idle cores (docs/solver/results.md)."""
    assert solver.cpu_seconds([(preset("laptop"), 60.0)]) == pytest.approx(60.0 / 0.60, rel=0.1)
    fine = preset("laptop").changed(dx=0.01)
    assert solver.cpu_seconds([(fine, 1.0)]) == pytest.approx(16 * solver.cpu_seconds([(preset("laptop"), 1.0)]))
    solver.agree("x", "auto", [(preset("laptop"), 1800.0)], instead="-")
    solver.agree("x", "cpu", [(preset("paper"), 1e6)], instead="-")
    solver.agree("x", "cuda", [(preset("paper"), 1e6)], instead="-", tanks=256)
    with pytest.raises(TooMuch, match="memory"):
        solver.agree("x", "cpu", [(preset("paper"), 1.0)], instead="-", tanks=256)


@pytest.mark.parametrize(
    ("settings", "kind", "measured"),  # s, of docs/train/results.md and README: learning alone
    [
        (PRESETS["quick"], training.CPU, 170.0),
        (change(PRESETS["quick"], water="structured", steps=13_000_000), training.CPU, 87.0),
        (change(PRESETS["paper"], engine="planar"), training.GPU, 150.0),
        (change(PRESETS["paper"], engine="planar", water="structured"), training.GPU, 45.0),
        (change(PRESETS["paper"], engine="mjx", algorithm={"envs": 16384}), training.GPU, 237.0),
        (change(PRESETS["paper"], engine="mjx", water="structured", algorithm={"envs": 16384}), training.GPU, 223.0),
        (change(PRESETS["paper-sac"], engine="planar", water="structured"), training.GPU, 183.0 / 3),
        (change(PRESETS["paper-sac"], algo="sb3-sac", water="structured"), training.CPU, 1e6 / 114),
    ],
)
def test_training_time_estimate_is_within_a_factor_of_two_of_measured(settings, kind, measured, monkeypatch):
    monkeypatch.setattr(training, "_kind", lambda: kind)
    assert 0.5 < training.seconds(settings) / measured < 2.0


@pytest.mark.parametrize("name", [name for name in PRESETS if name != "lbm"])
def test_a_preset_goes_on_without_a_question(name):
    training.agree([PRESETS[name]] * 3, together=True, yes=False)


def test_a_training_in_the_flow_solver_asks_where_there_is_no_gpu(monkeypatch):
    monkeypatch.setattr(training.solver_cost, "accelerator", lambda need: None)
    with pytest.raises(TooMuch, match="train: 20000 s of water in boxes of up to 2 M cells would take about"):
        training.agree([settled(PRESETS["lbm"])], together=False, yes=False)
    training.agree([settled(change(PRESETS["lbm"], steps=10, solver={"domain": "laptop"}))], together=False, yes=False)


@pytest.mark.parametrize("name", ["laptop", "laptop_refined", "window_refined_twice"])
def test_one_estimate_of_the_solver_counts_the_finer_boxes_once(name):
    box = preset(name)
    each = [solver.cpu_seconds([(level, 10.0)], 2) for level in box.levels]
    assert solver.cpu_seconds([(box, 10.0)], 2) == pytest.approx(sum(each)) and len(each) == name.count("_") + 1
    with pytest.raises(TooMuch, match="100000 s of water"):
        solver.agree("a", "auto", [(preset("laptop_refined"), 1e5)], instead="less")


def test_the_memory_of_a_training_is_that_of_its_arrays():
    """What the program allocates for one iteration, as its compiler counts."""
    from fishmj.train.training_run import learner_of

    small = change(PRESETS["quick"], engine="planar", task={"memory": 40}, algorithm={"envs": 1024})
    import jax

    _, learner, _ = learner_of(small)
    state = jax.eval_shape(learner.init, jax.random.key(0))
    # machine code that nobody runs need not be fast: arrays are laid out before it is made
    options = {"xla_backend_optimization_level": 0}
    used = learner.iterate.lower(learner, state).compile(compiler_options=options).memory_analysis()
    counted = used.temp_size_in_bytes + used.argument_size_in_bytes
    config, width = training.config_of(small), training.widths(small)
    assert 0.5 < config.bytes(width, small.steps) / counted < 2.0


def test_bench_of_days_needs_confirmation_and_published_bench_does_not():
    asked = {"generator": "second", "small": False, "out": None, "yes": False}
    bench.agree(Namespace(**asked), 720, 1)
    with pytest.raises(TooMuch, match="33000 cases would take about 11 days"):
        bench.agree(Namespace(**asked), 33000, 1)
    for more in ({"yes": True}, {"small": True}, {"generator": "lbm"}):
        bench.agree(Namespace(**asked | more), 33000, 2)
