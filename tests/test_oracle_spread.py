"""Independent waters over several devices: a process each, the same results as on one, errors that name the device."""

import ast
import os
import signal
import subprocess
import sys
import time
from collections import deque
from dataclasses import replace
from functools import partial
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from spread_toys import fails, squared, steered

import studies.benchmarks as bench
from fishmj import cli, control, lbm_oracle
from fishmj.base import console, plugins
from fishmj.base.cores import usable_cores
from fishmj.base.errors import ConfigError, LogError, UnknownName
from fishmj.evaluate import trials
from fishmj.evaluate.run_trials import judge_in_solver
from fishmj.gap.calibrate import slip
from fishmj.gap.laboratory.hidden_lbm import hidden
from fishmj.gap.laboratory.hidden_lbm import hidden_lbm_command as hidden_command
from fishmj.hydro_fit.campaign.data import collect
from fishmj.hydro_fit.campaign.data.collect import Local
from fishmj.hydro_fit.campaign.data.run_segments import Setup
from fishmj.hydro_fit.campaign.data.segment import Segment
from fishmj.lbm_oracle.fluid.device import device_of, devices_of
from fishmj.lbm_oracle.force_maps import forcemap
from fishmj.lbm_oracle.force_maps.force_points import AveragingTimes, Point
from fishmj.lbm_oracle.run import finished_rows
from fishmj.lbm_oracle.run.domain import Domain, preset
from fishmj.lbm_oracle.run.solver_water import BOUNDARIES
from fishmj.lbm_oracle.run.spread import _KeyRequests, _Process, _ProgressReports, _send_key, ray_device, spread
from fishmj.mjcf import load_robot
from studies.benchmarks import devices
from studies.grid_studies import converge_fish, real_fish, speeds
from studies.solver_family import swims

TWO = ("cpu", "cpu")


@pytest.fixture(autouse=True)
def nothing_loaded(monkeypatch):
    """Other tests of this process have loaded code of their own, some of it from files that are only right there."""
    monkeypatch.setattr(plugins, "_LOADED", {kind: {} for kind in plugins.KINDS})


def test_one_device_works_in_this_process():
    found = list(spread(squared, [3, 1, 2], ("cpu",)))
    assert [(key, value) for key, value, *_ in found] == [(3, 9), (1, 1), (2, 4)]
    assert {pid for *_, pid, _, _ in found} == {os.getpid()} and list(spread(squared, [], TWO)) == []


def test_two_devices_have_a_process_each_and_share_keys_and_cores(tmp_path):
    found = list(spread(partial(squared, room=9, meet=tmp_path), range(12), TWO))
    assert sorted((key, value) for key, value, *_ in found) == [(n, n**2) for n in range(12)]
    pids = {pid for *_, pid, _, _ in found}
    assert len(pids) == 2 and os.getpid() not in pids
    assert max(most for *_, most in found) <= 6  # half of what there is, whoever comes first
    assert all(cores == max(1, usable_cores() // 2) for *_, cores, _ in found) or usable_cores() % 2


def test_what_goes_on_is_summed_and_no_ends_it_all():
    told = []
    found = []
    for row in spread(partial(squared, room=2), range(400), TWO, lambda done: bool(told.append(done)) or len(found) < 20):
        found.append(row)
    assert 20 <= len(found) <= 22 and all(0.0 <= done <= 4.0 for done in told)


@pytest.mark.parametrize(
    ("how", "error", "words"),
    [
        ("error", LogError, "key .: no swim"),
        ("fault", RuntimeError, "on device cpu:\n(.|\n)*ZeroDivisionError: a fault"),
        ("dies", ConfigError, "device cpu: its process ended with exit code 3; the same command goes on"),
    ],
)
def test_what_goes_wrong_in_a_process_is_raised_here(how, error, words):
    with pytest.raises(error, match=words):
        list(spread(partial(fails, how=how), [1, 2], TWO))


def test_ctrl_c_ends_the_processes_too(tmp_path):
    script = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from functools import partial
from pathlib import Path
from fishmj.lbm_oracle.run.spread import spread
from spread_toys import rests
if __name__ == "__main__":
    list(spread(partial(rests, diary=Path({str(tmp_path)!r})), [1, 2], ("cpu", "cpu")))
"""
    (file := tmp_path / "begin.py").write_text(script)
    begun = subprocess.Popen([sys.executable, str(file)], start_new_session=True, stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 600
    while len(pids := [int(path.stem) for path in tmp_path.glob("*.pid")]) < 2 and time.monotonic() < until:
        time.sleep(0.05)
    os.killpg(begun.pid, signal.SIGINT)
    assert "KeyboardInterrupt" in begun.communicate(timeout=600)[1] and len(pids) == 2
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_work_that_cannot_be_sent_is_named_before_a_process_begins():
    with pytest.raises(ConfigError, match="device cpu: the work cannot be sent to a process: .*; use one device"):
        list(spread(lambda waiting, device, go_on: iter(()), [1, 2], TWO))


def test_code_of_the_users_own_goes_along(tmp_path):
    """Without this, a controller from a file would be unknown to the processes."""
    (tmp_path / "my_brain.py").write_text("class Brain:\n    gain = 3\n")
    brain = plugins.load("controller", f"{tmp_path / 'my_brain.py'}:Brain")()
    assert sorted(spread(partial(steered, brain=brain), [1, 2], TWO)) == [3, 6]


class Pipe:
    """The end of a pipe that is here: what was sent, and prepared answers."""

    def __init__(self, *answers):
        self.sent, self.answers = [], list(answers)

    def send(self, what):
        self.sent.append(what)

    def recv(self):
        return self.answers.pop(0)


def test_a_process_asks_again_only_after_it_has_finished_one():
    pipe = Pipe((True, "a"), (False, True), (True, "b"), (False, False))
    asked = _KeyRequests(pipe)
    assert asked and asked and asked.popleft() == "a" and len(pipe.sent) == 1
    assert not asked and not asked and len(pipe.sent) == 2
    asked.full = False  # as after a result
    assert asked.popleft() == "b" and not asked and len(pipe.sent) == 4
    asked.full = False
    assert not asked and len(pipe.sent) == 4  # nothing will come any more
    with pytest.raises(IndexError):
        asked.popleft()


def test_no_process_takes_more_than_its_part_of_what_is_left():
    one, other = (_Process(Pipe(), None, "cpu") for _ in range(2))
    todo = deque("abc")
    for _ in range(3):
        _send_key(one, [one, other], todo)
    assert one.pipe.sent == [(True, "a"), (True, "b"), (False, True)] and one.held == 2
    _send_key(other, [one, other], todo)
    _send_key(other, [one, other], todo)
    assert other.pipe.sent == [(True, "c"), (False, False)]


def test_progress_is_reported_now_and_then():
    now, pipe = [0.0], Pipe()
    told = _ProgressReports(pipe, lambda: now[0])
    for now[0] in (0.1, 0.3, 0.4, 0.6):
        assert told(now[0])
    assert [said.value for said in pipe.sent] == [0.3, 0.6]


# names of devices -----------------------------------------------------------------------------------------------------


@pytest.fixture
def gpus(monkeypatch):
    """Two accelerators, the second with little room."""

    class Gpu(SimpleNamespace):
        def __str__(self):
            return self.alias

    made = [Gpu(alias=f"cuda:{n}", free_memory=room * 2**20) for n, room in enumerate((400, 300))]
    monkeypatch.setattr(wp, "get_cuda_devices", lambda: made)


def test_names_become_devices(gpus):
    assert devices_of("cpu") == ("cpu",) and devices_of("cpu,cpu") == TWO
    assert devices_of("cuda") == devices_of("auto") == ("cuda:0",) and devices_of("cuda:1") == ("cuda:1",)
    assert devices_of("cuda:all") == devices_of("cuda:0,cuda:1") == ("cuda:0", "cuda:1")
    assert devices_of("cuda:0,cuda:0") == ("cuda:0", "cuda:0")


def test_devices_that_are_not_there_are_named(gpus, monkeypatch):
    with pytest.raises(ConfigError, match=r"cuda:7 was asked for; this machine has cuda:0 to cuda:1"):
        devices_of("cuda:0,cuda:7")
    with pytest.raises(ConfigError, match=r"device: cuda:1 has 300 MB free, the fluid needs 359 MB"):
        devices_of("cuda:all", 359 * 2**20)
    for mixed in ("cuda,cpu", "auto,auto", "cpu,auto"):
        with pytest.raises(ConfigError, match="mixes kinds; expected one kind, as cuda:0,cuda:1"):
            devices_of(mixed)
    for wrong in ("gpu", "cuda:x", "cuda:", "cpu,gpu"):
        with pytest.raises((UnknownName, ConfigError)):
            devices_of(wrong)
    monkeypatch.setattr(wp, "get_cuda_devices", list)
    with pytest.raises(ConfigError, match="no usable accelerator was found; use --device cpu"):
        devices_of("cuda:all")


def test_one_water_runs_on_one_device(gpus):
    for several in ("cuda:all", "cpu,cpu"):
        with pytest.raises(ConfigError, match=f"device: {several} names several, one water runs on one"):
            device_of(several)


def test_options_take_one_device_or_several():
    for word in ("auto", "cpu", "cuda", "cuda:1", "cuda:all", "cuda:0,cuda:1", "cuda,cuda", "cpu,cpu"):
        assert console.devices(word) == word
    for word in ("", "gpu", "cpu,", "cpu,cuda", "auto,cpu", "cuda:all,cpu", "cuda:x", "CPU"):
        with pytest.raises(console.argparse.ArgumentTypeError, match="Known: .*cuda:all"):
            console.devices(word)
    with pytest.raises(console.argparse.ArgumentTypeError, match="got 'cuda:all', several devices; expected one"):
        console.device("cuda:all")


def test_a_worker_of_a_cluster_has_one_device():
    assert [ray_device(asked) for asked in ("auto", "cpu", "cuda", "cuda:1")] == ["auto", "cpu", "cuda", "cuda"]
    with pytest.raises(ConfigError, match="--device cuda:all with --ray: .*use --device cuda"):
        ray_device("cuda:all")


# waters ---------------------------------------------------------------------------------------------------------------

SMALL = Setup(domain=replace(preset("laptop"), shape=(60, 36, 16)), device="cpu")


@pytest.mark.slow
@pytest.mark.oracle
def test_segments_on_two_devices_are_those_of_one_to_the_bit():
    gait = {"kind": "gait", "frequency": 1.5, "amplitude": 0.4, "lag": 1.0, "bias": 0.3, "ramp": 0.1}
    plain = {"block": "any", "split": "train", "seconds": 0.24}
    some = [Segment(id=f"s{n}", episode=f"s{n}", drive=gait | {"bias": 0.1 * n}, **plain) for n in range(3)]
    one, two = ({f.segment.id: f for f in pool.run(deque(some), SMALL, lambda water: True)} for pool in (Local(), Local(1, TWO)))
    assert one.keys() == two.keys() == {"s0", "s1", "s2"}
    for name, found in one.items():
        assert found.arrays.keys() == two[name].arrays.keys()
        for key, values in found.arrays.items():
            np.testing.assert_array_equal(values, two[name].arrays[key])
    assert np.abs(one["s0"].arrays["q"] - one["s2"].arrays["q"]).max() > 1e-3


@pytest.mark.slow
@pytest.mark.oracle
def test_points_of_a_map_on_two_devices_are_those_of_one_to_the_bit():
    domain = Domain(name="tiny", shape=(56, 44, 16), dx=0.02, dt=0.004, sponge=4)
    options = {"robot": "fish", "slip": 1.0, "sharpness": BOUNDARIES["plain"]}
    whole = {"domain": domain, "plan": AveragingTimes(settle=0.1, seconds=0.2, length=0.5), "tanks": 1, "options": options}
    work = partial(forcemap.on_device, **whole, pictured={"points": []})
    points = [Point("joint", angle, 0.0, 0.3) for angle in (0.0, 30.0)]
    one, two = (dict(spread(work, points, devices)) for devices in (("cpu",), TWO))
    assert one == two and set(one) == set(points) and one[points[0]]["drag_N"] != one[points[1]]["drag_N"]


@pytest.mark.slow
@pytest.mark.oracle
def test_trials_on_two_devices_are_those_of_one_to_the_bit():
    """A policy in batches of one and of two differs in its last bits: each trial has a controller of its own."""
    robot, some = load_robot("fish"), trials(speeds=[0.0], intensity=0.0, los_deg=[0, 90], repeats=1, duration=1.0)
    judged = lambda device, tanks: judge_in_solver(
        control.make("station", robot), robot, some, domain="laptop", device=device, tanks=tanks
    )
    one, two = judged("cpu", 2), judged("cpu,cpu", 1)
    for name in ("pose", "joint", "power", "command", "obs", "action", "distance"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert np.abs(one.pose[0] - one.pose[1]).max() > 1e-3


# commands -------------------------------------------------------------------------------------------------------------

CALLS = {
    "real_fish": (real_fish, ["--domain", "laptop", "--beats", "5"]),
    "forcemap": (forcemap, ["--domain", "laptop"]),
    "converge fish": (converge_fish, ["--domain", "laptop", "--grids", "0.02"]),
    "speeds": (speeds, ["--preset", "laptop"]),
    "collect": (collect, ["--preview"]),
}


class Begun(Exception):
    """What a command would spread: the work as it is sent to a process, keys, devices."""


def noted(work, keys, devices, go_on=None):
    raise Begun(bytes(ForkingPickler.dumps(work)), bytes(ForkingPickler.dumps(list(keys))), devices)


@pytest.mark.parametrize("name", CALLS)
def test_a_command_spreads_what_can_be_sent_over_the_devices_it_is_given(name, tmp_path, monkeypatch):
    module, argv = CALLS[name]
    monkeypatch.setattr(collect if module is collect else finished_rows, "spread", noted)
    with pytest.raises(Begun) as begun:
        module.main([*argv, "--device", "cpu,cpu,cpu", "--out", str(tmp_path / "out")])
    work, keys, devices = begun.value.args
    assert devices == ("cpu", "cpu", "cpu") and keys and (b"on_device" in work or b"run_swims" in work)


def test_hidden_sets_and_robots_of_a_plan_are_spread_too(tmp_path, monkeypatch):
    """Their jobs come with what they belong to, which a process does not need to know."""
    for module in (hidden_command, swims):
        monkeypatch.setattr(module, "spread", noted)
    job = hidden.jobs({}, ["gait"], 3)[0]
    monkeypatch.setattr(swims, "all_swims", lambda plan, shard: [swims.PlannedSwim("a", job, 1)])
    for call in (
        lambda: hidden_command.collect(tmp_path, {"set_000": [job]}, "cpu,cpu"),
        lambda: swims.swum_all(None, tmp_path, "cpu,cpu"),
    ):
        with pytest.raises(Begun) as begun:
            call()
        assert begun.value.args[2] == TWO and b"on_device" in begun.value.args[0] and b"gait" in begun.value.args[1]
    jobs = hidden.OwnedJobs(deque([("mine", job)]))
    assert jobs and jobs.popleft() is job and not jobs and jobs.owner(SimpleNamespace(job=job)) == "mine"


def test_a_judgement_is_spread_too(monkeypatch):
    monkeypatch.setattr("fishmj.lbm_oracle.run.spread.spread", noted)
    robot = load_robot("fish")
    for name in ("station", "dob", "drift"):
        with pytest.raises(Begun) as begun:
            judge_in_solver(control.make(name, robot), robot, trials(repeats=1), device="cpu,cpu", tanks=2)
        assert begun.value.args[2] == TWO and b"in_tanks" in begun.value.args[0]


def test_a_new_slip_table_is_spread_too(tmp_path, monkeypatch):
    monkeypatch.setattr("fishmj.lbm_oracle.run.spread.spread", noted)
    with pytest.raises(Begun) as begun:
        slip.recompute("laptop", [0.5, 1.0], "cpu,cpu", 1, tmp_path)
    assert begun.value.args[2] == TWO and b"_metrics" in begun.value.args[0]


@pytest.mark.parametrize("argv", [["lbm_oracle", "swim"], ["lbm_oracle", "cases"], ["lbm_oracle", "converge"]], ids=" ".join)
def test_what_is_one_water_refuses_several_devices(argv, capsys):
    assert cli.main([*argv, "--device", "cuda:all"]) == console.BAD_INPUT
    assert "got 'cuda:all', several devices; expected one: auto, cpu, cuda or cuda:N" in capsys.readouterr().err


def test_the_hybrid_water_has_one_device(capsys):
    call = ["evaluate", "drift", "--water", "hybrid", "--device", "cuda:0,cuda:1", "--repeats", "1"]
    assert cli.main(call) == console.BAD_INPUT
    assert "--device cuda:0,cuda:1: its tanks share one" in capsys.readouterr().err


def cached(source):
    """Names of the arguments of functions whose results are kept for good."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef) and any("cache" in ast.unparse(mark) for mark in node.decorator_list):
            found += [argument.arg for argument in (*node.args.args, *node.args.kwonlyargs)]
    return found


def test_no_cache_of_the_solver_holds_what_belongs_to_a_device():
    """Kernels are kept by what they compute; graphs, streams and arrays are their water's own, so that devices never mix."""
    named = {name for path in Path(lbm_oracle.__file__).parent.rglob("*.py") for name in cached(path.read_text(encoding="utf-8"))}
    assert named and not named & {"device", "fluid", "stream", "boundary", "coupled", "array"}
    assert cached("@cache\ndef of(device, *, n): ...\ndef plain(fluid): ...") == ["device", "n"]


# benchmark ------------------------------------------------------------------------------------------------------------


def test_the_table_of_scaling_says_how_many_gpus_it_needs(gpus, monkeypatch):
    assert devices.gpus(2) == ("cuda:0", "cuda:1")
    found = bench.measure(bench.known()["oracle_devices_4"])
    assert found == {"name": "oracle_devices_4", "skipped": "needs 4 GPUs in one host; here: 2"}
    monkeypatch.setattr(wp, "get_cuda_devices", list)
    assert bench.measure(bench.known()["oracle_devices_2"])["skipped"] == "needs 2 GPUs in one host; here: 0"


@pytest.mark.slow
@pytest.mark.oracle
def test_tanks_on_two_devices_tick_together():
    work = devices.scaled(TWO, quick=True)
    work.run()
    assert work.amount == 2 * devices.TANKS_CPU * devices.TICKS_QUICK * 5 and work.where == "cpu cpu, tanks: 2 x 2"


def test_a_process_that_finds_no_device_says_why():
    with pytest.raises(RuntimeError, match="on device cuda:9:\n(.|\n)*(cuda:9 was asked for|no usable accelerator)"):
        devices.scaled(("cuda:9",))
