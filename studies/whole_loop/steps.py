"""The steps of one robot through the loop: the commands of its user, each done once and kept.

    seed_03/healthy      deploy experiment, before the fault                seed_03/fish.toml    calibrate water
    seed_03/faulty       deploy experiment, with latency and horn           seed_03/report       gap find; fish.v2.toml: gap apply
    seed_03/trained_*    train, in the patched model and in the old one     seed_03/swims        deploy swim, four arms
    seed_03/log.txt      output of the commands

Robot commands run in lockstep (`tank.Tank`), the others as processes of their own.
"""

import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import IO, Any, NamedTuple

from fishmj.base import console
from fishmj.base.errors import FishmjError
from fishmj.base.store import read_json, write_json
from fishmj.deploy.rig import rig_experiment
from studies.whole_loop.tank import Tank

DELAY, ANGLE_DEG = 0.15, 10.0  # s more until a command acts, and by how much a horn is turned
EXPERIMENTS = ("session", "gait_mirrored", "spin", "flap")  # twelve records
SECONDS = 30.0  # of a swim
HEALTHY, BEFORE, UNPATCHED, AFTER = ARMS = ("healthy", "before", "unpatched", "after")


class Fault(NamedTuple):
    """Fault that is hidden in a robot. delay: s. horn: 1 at the head. angle_deg: of its zero."""

    delay: float
    horn: int
    angle_deg: float

    @classmethod
    def of(cls, seed: int) -> "Fault":
        """Fault by a fixed rule, so that no seed is selected: horns in turn, even seeds to one side and odd ones to the other."""
        return cls(DELAY, 1 + seed % 3, ANGLE_DEG if seed % 2 == 0 else -ANGLE_DEG)

    def options(self) -> str:
        """Options of `fishmj deploy loopback`."""
        return (
            f"--effect command_latency={self.delay:g} --effect joint_zero_offset:offset{self.horn}={radians(self.angle_deg):.6f}"
        )


@dataclass(frozen=True, kw_only=True)
class Loop:
    """Settings of the loop for every robot.

    Attributes:
        out: folder. policy: the first policy. healthy, experiments: names of `deploy experiment` before and after the fault,
            each once. null_runs: of `gap find`.
        steps: of each training, of `preset`, on `engine`. swims: number in each arm, seconds long.
    """

    out: Path
    policy: str = "station"
    healthy: tuple[str, ...] = EXPERIMENTS
    experiments: tuple[str, ...] = EXPERIMENTS
    null_runs: int = 96
    preset: str = "quick"
    engine: str = "auto"
    steps: int = 2_000_000
    swims: int = 8
    seconds: float = SECONDS

    def folder(self, seed: int) -> Path:
        """Folder of one robot."""
        return self.out / f"seed_{seed:02d}"


def measure(loop: Loop, seed: int, faulty: bool) -> None:
    """Does the designed experiments: `deploy experiment ... --out healthy | faulty`."""
    out = loop.folder(seed) / ("faulty" if faulty else "healthy")
    if (loop.folder(seed) / "searched.json").is_file():
        return
    played(loop, seed, loop.experiments if faulty else loop.healthy, out, Fault.of(seed).options() if faulty else "")


def played(loop: Loop, seed: int, names: Sequence[str], out: Path, hidden: str) -> None:
    """Does `deploy experiment NAMES --out OUT` in still water, once each. hidden: options of the loopback robot.

    Raises:
        FishmjError: the command failed.
    """
    words = [*names, "--repeats", "1", "--yes", "--link", "loopback", "--flow", "0,0", "--out", str(out)]
    with record_output(loop, seed, ["deploy", "experiment", *words, "--loopback", f"--seed {seed} {hidden}"]) as argv:
        code = rig_experiment.main(argv[2:], wire=Tank().wire)
    if code not in (console.OK, console.FAILED_CHECK):  # one that the supervisor ended is left out, as a user would leave it
        raise FishmjError(f"seed {seed}: deploy experiment ended with {code}; see {loop.folder(seed) / 'log.txt'}")


def calibrate(loop: Loop, seed: int) -> None:
    """Calibrates the robot's water to the healthy experiments."""
    folder = loop.folder(seed)
    if not (folder / "fish.toml").is_file():
        words = ("--data", folder / "healthy/trials", "--model", "fish", "--report", folder / "calibration")
        written = (console.OK, console.FAILED_CHECK)  # the latter says that the water is poor
        called(loop, seed, "calibrate", "water", *words, "--out", folder / "fish.toml", ok=written)


def search(loop: Loop, seed: int) -> None:
    """Runs `gap find`, then `gap apply --counted-in`; `searched.json` has the result."""
    folder = loop.folder(seed)
    report, version = folder / "report", folder / "fish.v2.toml"
    if (folder / "searched.json").is_file():
        return
    found: dict[str, Any] = {"answer": "CANNOT_TELL", "named": {}, "counted_in": {}}
    if not (report / "verdict.json").is_file():
        words = (folder / "faulty/trials", "--model", folder / "fish.toml", "--null-runs", loop.null_runs, "--out", report)
        called(loop, seed, "gap", "find", *words, ok=(console.OK, console.CANNOT_TELL))
    if (report / "verdict.json").is_file():
        found = answered(read_json(report / "verdict.json"))
    if found["named"] and not version.is_file():
        called(loop, seed, "gap", "apply", report, "--counted-in", "--out", version, ok=(console.OK, console.FAILED_CHECK))
    write_json(folder / "searched.json", found | {"patched": version.is_file()})


def answered(verdict: dict) -> dict:
    """Answer of a verdict, and {effect: {parameter: value}} of the named and of the fitted but unnamed effects."""
    sizes = lambda effects: {e["name"]: {k: p["value"] for k, p in e["parameters"].items()} for e in effects}
    named, counted = sizes(verdict["effects"]), sizes(verdict.get("tentative", []))
    if verdict["answer"] != "NAMED":
        named, counted = {}, named | counted
    gap = [verdict["gap_before"], verdict["gap_after"]]
    return {"answer": verdict["answer"], "named": named, "counted_in": counted, "gap": gap}


def train(loop: Loop, seed: int, arm: str) -> None:
    """Trains briefly in the last version (`after`), or in the model before any patch (`unpatched`), from the healthy policy."""
    folder = loop.folder(seed)
    model, out = model_of(loop, seed, arm), folder / f"trained_{arm}"
    done = folder / f"trained_{arm}.json"  # not a policy file: an interrupted training leaves these, too
    if done.is_file() or arm == AFTER and not patched(loop, seed):
        return
    words = ["--preset", loop.preset, "--engine", loop.engine, "--steps", loop.steps, "--robot", model, "--out", out]
    going = any((out / "checkpoints").glob("*"))
    called(loop, seed, "train", *words, *(["--resume"] if going else ["--begin", loop.policy]))
    write_json(done, {"steps": loop.steps, "preset": loop.preset, "engine": loop.engine, "begin": loop.policy})


def patched(loop: Loop, seed: int) -> bool:
    """Returns True if the search led to a new version of the model."""
    return bool(read_json(loop.folder(seed) / "searched.json")["patched"])


def model_of(loop: Loop, seed: int, arm: str) -> str:
    """Description that the host uses in an arm."""
    folder = loop.folder(seed)
    return {AFTER: str(folder / "fish.v2.toml"), UNPATCHED: str(folder / "fish.toml")}.get(arm, "fish")


def called(loop: Loop, seed: int, *words: object, ok: tuple[int, ...] = (0,)) -> int:
    """Runs `python -m fishmj WORDS` as a user would; returns its exit code. Raises FishmjError if that is not in `ok`."""
    argv = [str(word) for word in words]
    with log_of(loop, seed, argv) as log:
        code = subprocess.run([sys.executable, "-m", "fishmj", *argv], stdout=log, stderr=log, check=False).returncode
    if code not in ok:
        raise FishmjError(f"seed {seed}: fishmj {' '.join(argv[:2])} ended with {code}; see {loop.folder(seed) / 'log.txt'}")
    return code


@contextmanager
def log_of(loop: Loop, seed: int, argv: list[str]) -> Iterator[IO[str]]:
    """Opens the robot's `log.txt` at its end, with the command line in it."""
    loop.folder(seed).mkdir(parents=True, exist_ok=True)
    with (loop.folder(seed) / "log.txt").open("a", encoding="utf-8") as log:
        log.write(f"$ {shlex.join(['fishmj', *argv])}\n")
        log.flush()
        yield log


@contextmanager
def record_output(loop: Loop, seed: int, argv: list[str]) -> Iterator[list[str]]:
    """Yields `argv`, and sends the output inside to `log.txt`: for commands that run in this process."""
    with log_of(loop, seed, argv) as log, redirect_stdout(log), redirect_stderr(log):
        yield argv
