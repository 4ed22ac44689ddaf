"""Ctrl-C and SIGTERM end every verb, whatever it is doing, and what was finished is gone on with. The campaign: interrupts.py."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import interrupts
import jax.numpy as jnp
import numpy as np
import pytest

from fishmj import evaluate
from fishmj.base import console, interrupt, store
from fishmj.evaluate import __main__ as judge
from fishmj.hydro_fit.fit.training_loop import Loop

AT = {"train": 3.0, "gap bench": 5.0, "gap find": 2.0, "evaluate": 1.0, "hydro_fit fit": 4.0}  # s; the campaign's are random

COMMAND = """
import sys, time
from fishmj.base import console, interrupt, store
interrupt.is_command = lambda: True
interrupt.arm()
def main(argv):
    {body}
raise SystemExit(console.run(main, sys.argv[1:]))
"""


STARTED: list[subprocess.Popen] = []  # by the test that runs


@pytest.fixture(autouse=True)
def nothing_left():
    """A command that did not end as asked does not outlive its test."""
    yield
    while STARTED:
        STARTED.pop().kill()


def made(path: Path, process: subprocess.Popen | None = None) -> None:
    """Wait until this file is there, or the process has ended; ten minutes at most."""
    until = time.monotonic() + 600
    while not path.exists() and (process is None or process.poll() is None) and time.monotonic() < until:
        time.sleep(0.02)


def begun(tmp_path: Path, body: str, *argv: str) -> subprocess.Popen:
    """A command with this body, once it has made the file `begun`."""
    script = COMMAND.format(body=body.strip().replace("\n", "\n    "))
    env = {**os.environ, "PYTHONPATH": str(interrupts.ROOT)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen([sys.executable, "-c", script, *argv], cwd=tmp_path, env=env, **pipes)
    STARTED.append(process)
    made(tmp_path / "begun", process)
    return process


@pytest.mark.slow
@pytest.mark.parametrize("name", list(AT))
def test_fault_13_ctrl_c_ends_every_verb_with_130_also_while_it_compiles(name, tmp_path):
    shipped = ["fishmj.hydro_fit", "fit", "--data", str(interrupts.ROOT / "data" / "hydro" / "swift"), "--out", str(tmp_path)]
    verb = interrupts.VERBS[name] if name != "hydro_fit fit" else interrupts.Verb(name, lambda _: shipped, str, 0.0)
    shot = interrupts.shoot(verb, tmp_path, tmp_path / "cache", AT[name], True)
    assert isinstance(shot, interrupts.Shot), "it ended before: give it more to do"
    assert (shot.code, shot.wrong, shot.left) == (130, (), ()), shot
    assert shot.said.startswith("fishmj: interrupted")


def test_fault_13_sigterm_says_what_is_kept_and_exits_143(tmp_path):
    body = """
with interrupt.keeping(lambda: "x holds it; go on with y"):
    open("begun", "w").close()
    time.sleep(60)
"""
    process = begun(tmp_path, body, "--json")
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=600)
    assert process.returncode == 143 and err.splitlines() == ["fishmj: terminated; x holds it; go on with y"]
    assert json.loads(out) == {"error": "terminated; x holds it; go on with y", "kind": "KeyboardInterrupt", "exit": 143}


def test_fault_13_a_training_that_compiles_says_what_is_kept(tmp_path):
    body = """
from fishmj.train import __main__ as train
from fishmj.train.planned_runs import PlannedRun
def compiles(argv, under_way):
    under_way += [PlannedRun(None, Path("run"))] if "--out" in argv else []
    open("begun", "w").close()
    time.sleep(60)
train._train = compiles
return train.main(argv)
"""
    nothing = "nothing is saved yet; start again with: fishmj"
    held = "run holds checkpoints; go on with: fishmj train --out run --resume"
    for argv, told in ((["--preset", "quick"], f"{nothing} --preset quick"), (["--out", "run", "--force"], held)):
        process = begun(tmp_path, f"from pathlib import Path{body}", *argv)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=600)
        assert process.returncode == 130 and err.splitlines() == [f"fishmj: interrupted; {told}"]
        store.Checkpoints(tmp_path / "run" / "checkpoints").save(256, {"a": np.zeros(1)}, {})
        (tmp_path / "begun").unlink()


def test_fault_13_a_loop_that_stops_by_itself_says_its_own_last_line(tmp_path):
    body = """
import signal
asked = []
signal.signal(signal.SIGINT, lambda *_: asked.append(1))
with interrupt.finishing(lambda: "too late"):
    open("begun", "w").close()
    while not asked:
        time.sleep(0.01)
console.warn("interrupted; all of it is kept")
return console.INTERRUPTED
"""
    process = begun(tmp_path, body)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=600)
    assert process.returncode == 130 and err.splitlines() == ["fishmj: interrupted; all of it is kept"]


def test_fault_13_what_cannot_be_kept_in_time_does_not_keep_the_process(tmp_path):
    """Nor does a main thread that never looks up, as in a compiler; no half-written file stays."""
    body = """
def words():
    with interrupt.writing:
        open("tried", "w").close()
        time.sleep(60)
with interrupt.keeping(words):
    open("begun", "w").close()
    while True:
        store.write_bytes("big", bytes(10**7))
"""
    process = begun(tmp_path, body)
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=600)
    assert process.returncode == 130 and time.monotonic() - began > 3.0
    assert (tmp_path / "tried").exists() and not list(tmp_path.glob(".*.tmp"))


def test_fault_13_asked_twice_it_ends_at_once(tmp_path):
    body = """
with interrupt.keeping(lambda: (open("keeping", "w").close(), time.sleep(60))):
    open("begun", "w").close()
    time.sleep(60)
"""
    process = begun(tmp_path, body)
    process.send_signal(signal.SIGINT)
    made(tmp_path / "keeping", process)
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=600)
    assert process.returncode == 130


def test_fault_13_a_dropped_connection_is_heard_and_exits_129(tmp_path):
    body = """
with interrupt.keeping(lambda: "x holds it"):
    open("begun", "w").close()
    time.sleep(60)
"""
    process = begun(tmp_path, body)
    process.send_signal(signal.SIGHUP)
    _, err = process.communicate(timeout=600)
    assert process.returncode == console.HUNG_UP == 129 and err.splitlines() == ["fishmj: hung up; x holds it"]


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="a terminal of POSIX")
def test_fault_13_closed_terminal_stops_cleanly_despite_unprintable_output(tmp_path):
    import pty

    body = """
import threading
asked = threading.Event()
with interrupt.finishing(lambda: "", heard=asked.set):
    open("begun", "w").close()
    asked.wait()
    open("rested", "w").close()
console.say("nobody reads this")
"""
    script = COMMAND.format(body=body.strip().replace("\n", "\n    "))
    child, terminal = pty.fork()
    if not child:
        os.chdir(tmp_path)
        os.environ["PYTHONPATH"] = str(interrupts.ROOT)
        os.execv(sys.executable, [sys.executable, "-c", script])
    made(tmp_path / "begun")
    os.close(terminal)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == console.HUNG_UP
    assert (tmp_path / "rested").exists()


WAY_OUT = """
from threading import Event
from fishmj.deploy.loop.graceful_stop import graceful_stop
asked = Event()
with graceful_stop(asked, lambda: open("let go", "a").write("."), lambda: "too late"):
    open("begun", "w").close()
    asked.wait()
    open("heard", "w").close()
    time.sleep({seconds})
    open("rested", "w").close()
console.warn("interrupted; it rests")
return console.INTERRUPTED
"""


def test_fault_13_homing_robot_gets_more_than_two_seconds_to_finish(tmp_path):
    process = begun(tmp_path, WAY_OUT.format(seconds=interrupt.GRACE + 0.5))
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=600)
    assert process.returncode == 130 and err.splitlines() == ["fishmj: interrupted; it rests"]
    assert (tmp_path / "rested").exists() and not (tmp_path / "let go").exists()


def test_fault_13_asked_twice_a_robot_is_let_go_before_the_process_ends(tmp_path):
    process = begun(tmp_path, WAY_OUT.format(seconds=60))
    process.send_signal(signal.SIGINT)
    made(tmp_path / "heard", process)
    time.sleep(interrupt.TWICE + 0.1)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=600)
    assert process.returncode == 130 and not (tmp_path / "rested").exists()
    assert (tmp_path / "let go").read_text().startswith(".....")


def test_a_program_that_imports_fishmj_keeps_its_own_handlers():
    code = "import signal, fishmj, fishmj.base.console; print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)"
    env = {**os.environ, "PYTHONPATH": str(interrupts.ROOT)}
    said = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True).stdout
    assert said.strip() == "True"


def test_fault_13_a_judgement_goes_on_with_the_next_controller(tmp_path, capsys, monkeypatch):
    argv = ["drift", "pd", "--engine", "compiled", "--speeds", "0.2", "--los", "0,180", "--repeats", "1", "--duration", "2"]
    argv += ["--json", "--out", str(tmp_path)]
    sound, ran = judge.run, []

    def run(brain, *given, **told):
        ran.append(brain.name)
        if len(ran) == 2:
            raise KeyboardInterrupt
        return sound(brain, *given, **told)

    monkeypatch.setattr(judge, "run", run)
    assert console.run(judge.main, argv) == 130
    partial = json.loads((tmp_path / "results.json").read_text())
    assert [r["controller"] for r in partial["results"]] == ["drift"] and partial["unfinished"] == ["pd"]
    capsys.readouterr()
    assert console.run(judge.main, argv) == console.OK
    said = capsys.readouterr()
    assert ran == ["drift", "pd", "pd"] and "drift was evaluated before under the same conditions" in said.err
    again = json.loads(said.out.splitlines()[-1])
    assert "unfinished" not in json.loads((tmp_path / "results.json").read_text()) and not (tmp_path / "judged").exists()
    monkeypatch.setattr(judge, "run", sound)
    assert console.run(judge.main, argv) == console.OK
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == again  # the figures of one that nobody interrupted


def test_what_was_judged_under_other_conditions_is_not_taken(tmp_path):
    robot = judge.load_robot("fish")
    given = {"speeds": [0.2], "los_deg": [0], "repeats": 1, "duration": 1}
    brains = [judge.control.make(name, robot) for name in ("drift", "pd")]
    kept = judge.FinishedTrials(tmp_path, robot, evaluate.trials(**given), "compiled", ["drift", "pd"])
    kept.keep(brains[0], evaluate.run(brains[0], robot, kept.trials, "compiled"))
    assert kept.find(brains[0]) is not None and kept.find(brains[1]) is None
    others = [(evaluate.trials(**given, seed=1), "compiled"), (evaluate.trials(**given), "batch")]
    assert all(judge.FinishedTrials(tmp_path, robot, *other, ["drift", "pd"]).find(brains[0]) is None for other in others)


def test_a_loop_goes_on_to_the_same_bits(tmp_path):
    def through(loop, steps, stop=None):
        since, state = loop.begin({"x": jnp.float32(0.1), "sum": np.zeros(3)})
        for k in range(since, steps):
            state = {"x": jnp.sin(state["x"] * 3.1), "sum": state["sum"] + float(state["x"])}
            loop.after(k + 1, state)
            if k + 1 == stop:
                loop.save()
                return None
        return [np.asarray(a).tobytes() for a in state.values()]

    assert through(Loop(tmp_path / "a", "key"), 9, stop=4) is None
    assert through(Loop(tmp_path / "a", "key"), 9) == through(Loop(), 9)
    assert Loop(tmp_path / "a", "another").begin({"x": jnp.float32(0.1), "sum": np.zeros(3)})[0] == 0
    Loop(tmp_path / "a").end()
    assert not (tmp_path / "a").exists()


def test_a_named_stage_is_shown_at_once_and_not_counted():
    import io

    clock, out = iter(np.arange(0.0, 1e4, 100.0)), io.StringIO()
    bar = console.Progress(10, "x", stream=out, clock=lambda: float(next(clock)), every=0.0)
    bar.stage("compiling")
    bar.update(1)
    assert out.getvalue().splitlines()[0] == "x: compiling" and bar.rate == 0
    bar.update(2)
    assert bar.rate == pytest.approx(0.01)  # 1 in 100 s; the 100 s of compiling are not among them


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["python", "-m", "fishmj.hydro_fit", "rank", "pd", "--out", "a b"], "go on with: fishmj hydro_fit rank pd --out 'a b'"),
        (["python", "-m", "fishmj", "calibrate", "check"], "go on with: fishmj calibrate check"),
        (["python", "/bin/fishmj", "evaluate", "dob"], "go on with: fishmj evaluate dob"),
        (["python", "mine.py"], "go on with the same command"),
    ],
)
def test_the_command_that_goes_on_is_this_one(given, said, monkeypatch):
    monkeypatch.setattr(sys, "orig_argv", given)
    monkeypatch.setattr(sys, "argv", given[1:])
    assert interrupt.again() == said
