"""Ctrl-C at random times in the verbs that run long: a campaign, started by hand.

    python tests/interrupts.py --times 10 --json interrupts.json

Each verb is started, gets SIGINT as a terminal sends it (its whole process group) at a time drawn from the seed, and starts
again on what it left, until it was interrupted `times` times; every second time its cache of machine code is empty. Asked for
each time: exit code 130 within 5 s, no traceback or crash on stderr, no process left behind. In the end it runs to its end, and
what it found is compared with a run that nobody interrupted, but for the clock.
"""

import argparse
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
WITHIN = 5.0  # s from Ctrl-C to the end of the process
PATIENCE = 600.0  # s after which a process that does not end is killed, and counted
CLOSE = 1e-6  # relative, of figures: code just compiled and code from the cache differ in the last bits
OUTPUTS = ("run", "bench", "found", "judged", "runs", "water")
WRONG = ("Traceback", "Segmentation", "Fatal", "Exception ignored", "Abort", "leaked", "core dumped")


@dataclass(frozen=True)
class Verb:
    """One verb.

    words: its command line on a folder, which it may have left before. found: what it found there, without the clock.
    span: s that times are drawn up to where the cache of machine code is empty; else up to what an uninterrupted run takes.
    """

    name: str
    words: Callable[[Path], list[str]]
    found: Callable[[Path], object]
    span: float
    ends: tuple[int, ...] = (0,)  # exit codes of its end


def train(folder: Path) -> list[str]:
    """A small network, on from its newest checkpoint."""
    out = folder / "run"
    small = ["--preset", "quick", "--engine", "compiled", "--hidden", "16,16", "--envs", "64", "--steps", "40000"]
    return ["fishmj.train", *small, "--out", str(out), *(["--resume"] if any(out.glob("checkpoints/step_*")) else [])]


def bench(folder: Path) -> list[str]:
    """Two cases of the search's benchmark, side by side."""
    return ["fishmj.gap", "bench", "--small", "--cases", "2", "--jobs", "2", "--out", str(folder / "bench")]


def find(folder: Path) -> list[str]:
    """A search over a small synthetic data set."""
    data = folder / "data"
    if not data.is_dir():
        planted = ["coulomb_friction", "--logs", "4", "--out", str(data), "--truth", str(folder / "truth.json")]
        command = [sys.executable, "-m", "fishmj.gap", "plant", *planted]
        subprocess.run(command, cwd=folder, env=environment(folder / "warm"), check=True, stdout=subprocess.DEVNULL)
    return ["fishmj.gap", "find", str(data), "--null-runs", "16", "--most", "1", "--out", str(folder / "found")]


def judge(folder: Path) -> list[str]:
    """Three controllers over eight trials."""
    few = ["--speeds", "0.2", "--repeats", "1", "--duration", "30"]
    return ["fishmj.evaluate", "drift", "dob", "pd", *few, "--engine", "compiled", "--out", str(folder / "judged")]


def fit(folder: Path) -> list[str]:
    """A water for a small synthetic campaign."""
    import hidden_water as hidden

    data = folder / "records"
    if not data.is_dir():
        parts = [hidden.campaign(size=0.34, seed=k, split=s, seconds=5.0) for k, s in enumerate(("train", "val", "test"))]
        hidden.write_dataset(data, [r for part in parts for r in part])
    return ["fishmj.hydro_fit", "fit", "--data", str(data), "--swims", "10", "--out", str(folder / "water")]


def rows(path: Path) -> list[dict]:
    """Lines of JSON without their clock, in the order of what they are of."""
    made = [json.loads(line) for line in path.read_text().splitlines()]
    return sorted(({k: v for k, v in row.items() if k != "seconds"} for row in made), key=lambda r: str(r.get("id", "")))


def verdict(folder: Path) -> dict:
    """Of a search, without the paths of its context."""
    return {k: v for k, v in json.loads((folder / "found" / "verdict.json").read_text()).items() if k != "context"}


def water(folder: Path) -> list:
    """Of a fit: coefficients, members, net, to the bit."""
    from fishmj.water.hydro_model import HydroModel

    model = HydroModel.load(folder / "water" / "swift.toml")
    net = [] if model.learnt is None else [np.asarray(a).tobytes() for a in model.learnt.net]
    return [repr(model.base), np.asarray(model.members).tobytes(), net, repr(model.band), model.notes]


def alike(a, b) -> bool:
    """Whether two findings are the same, their numbers to `CLOSE`."""
    if isinstance(a, float) and isinstance(b, float):
        return math.isclose(a, b, rel_tol=CLOSE, abs_tol=CLOSE)
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(alike(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(alike, a, b))
    return a == b


VERBS = {
    verb.name: verb
    for verb in (
        Verb("train", train, lambda folder: rows(folder / "run" / "metrics.jsonl"), 40.0),
        Verb("gap bench", bench, lambda folder: rows(folder / "bench" / "rows.jsonl"), 40.0, (0, 1)),
        Verb("gap find", find, verdict, 40.0),
        Verb("evaluate", judge, lambda folder: json.loads((folder / "judged" / "results.json").read_text()), 30.0),
        Verb("hydro_fit fit", fit, water, 60.0),
    )
}


@dataclass(frozen=True)
class Shot:
    """One Ctrl-C. at: s after the start; took: s from there to the end; said: the last line of stderr."""

    verb: str
    at: float
    cold: bool
    code: int
    took: float
    wrong: tuple[str, ...]
    left: tuple[str, ...]  # processes of the group that were still there 5 s later
    said: str

    @property
    def good(self) -> bool:
        return self.code == 130 and self.took <= WITHIN and not self.wrong and not self.left


def environment(cache: Path) -> dict[str, str]:
    """Of a started verb: this checkout, and a cache of machine code of its own."""
    empty = {"FISHMJ_CACHE": str(cache), "JAX_COMPILATION_CACHE_DIR": str(cache / "jax")}
    return {**os.environ, **empty, "PYTHONPATH": str(ROOT), "PYTHONFAULTHANDLER": "1"}


def started(words: list[str], folder: Path, cache: Path, said) -> subprocess.Popen:
    """The verb in a process group of its own."""
    command = [sys.executable, "-m", *words]
    return subprocess.Popen(
        command, cwd=folder, env=environment(cache), stdout=subprocess.DEVNULL, stderr=said, start_new_session=True
    )


def shoot(verb: Verb, folder: Path, cache: Path, at: float, cold: bool) -> Shot | float:
    """Start the verb and interrupt it; where it had ended before, the seconds that it took."""
    with tempfile.TemporaryFile("w+") as said:
        process = started(verb.words(folder), folder, cache, said)
        began = time.monotonic()
        try:
            process.wait(at)
            return time.monotonic() - began
        except subprocess.TimeoutExpired:
            pass
        began = time.monotonic()
        os.killpg(process.pid, signal.SIGINT)
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            pass
        took = time.monotonic() - began
        left = remains(process.pid)
        if left:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        said.seek(0)
        text = said.read()
    last = text.strip().splitlines()[-1:] or [""]
    return Shot(verb.name, at, cold, process.returncode, took, tuple(w for w in WRONG if w in text), left, last[0])


def remains(group: int) -> tuple[str, ...]:
    """Command lines of the processes of the group that are still there after a moment; those that wait to be reaped are not."""
    until, there = time.monotonic() + WITHIN, ("?",)
    while there and time.monotonic() < until:
        listed = subprocess.run(["ps", "-eo", "pgid=,stat=,args="], capture_output=True, text=True, check=True).stdout
        rows = (line.split(None, 2) for line in listed.splitlines())
        there = tuple(args[:200] for pgid, stat, args in rows if int(pgid) == group and not stat.startswith("Z"))
        time.sleep(0.1)
    return there


def to_its_end(verb: Verb, folder: Path, cache: Path, patience: float) -> tuple[int, float]:
    """Exit code and seconds of the verb on what the interrupts left."""
    began = time.monotonic()
    with tempfile.TemporaryFile("w+") as said:
        process = started(verb.words(folder), folder, cache, said)
        try:
            process.wait(patience)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        said.seek(0)
        if process.returncode not in verb.ends:
            print(said.read()[-2000:], file=sys.stderr)
    return process.returncode, time.monotonic() - began


def campaign(verb: Verb, times: int, seed: int, folder: Path, patience: float = 1800.0) -> dict:
    """A run that nobody interrupts, all interrupts of one verb, and its end."""
    rng = np.random.default_rng([seed, *verb.name.encode()])
    shots, finished, rounds = [], 0, 0
    whole, folder = folder / "whole", folder / "broken"
    for place in (folder / "warm", folder / "first", whole):
        place.mkdir(parents=True)
    to_its_end(verb, folder / "first", folder / "warm", patience)  # fills the cache
    code, first = to_its_end(verb, whole, folder / "warm", patience)
    print(f"{verb.name:14s} uninterrupted: exit {code}, {first:.0f} s", flush=True)
    seconds = first
    while len(shots) < times:
        cold, rounds = bool(len(shots) % 2), rounds + 1
        at = float(rng.uniform(0.05, min(verb.span, first) if cold else seconds))
        cache = folder / (f"cold-{rounds}" if cold else "warm")
        shot = shoot(verb, folder, cache, at, cold)
        if not isinstance(shot, Shot):
            finished, seconds = finished + 1, min(seconds, shot)
            if finished > times:
                raise SystemExit(f"{verb.name} ends before it can be interrupted: give it more to do")
            for made in set(OUTPUTS) & {path.name for path in folder.iterdir()}:
                shutil.rmtree(folder / made)  # it has come to its end: from the beginning
            continue
        shots.append(shot)
        print(f"{verb.name:14s} {at:5.1f} s {'cold' if cold else 'warm'}  exit {shot.code} after {shot.took:.2f} s", end="  ")
        print("ok " if shot.good else "BAD", shot.said[:150], flush=True)
    code, rest = to_its_end(verb, folder, folder / "warm", patience)
    return {
        "verb": verb.name,
        "interrupted": len(shots),
        "good": sum(shot.good for shot in shots),
        "slowest": max(shot.took for shot in shots),
        "ended before": finished,
        "end": code,
        "ends": code in verb.ends,
        "the same": code in verb.ends and alike(verb.found(folder), verb.found(whole)),
        "seconds": rest,
        "uninterrupted": first,
        "shots": [{**vars(shot), "good": shot.good} for shot in shots],
    }


def main() -> int:
    from fishmj.base import console

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--verbs", default=",".join(VERBS), help=f"of {', '.join(VERBS)} (default: all)")
    parser.add_argument("--times", type=int, default=10, help="interrupts of each verb (default 10)")
    parser.add_argument("--seed", type=int, default=0, help="of the times (default 0)")
    parser.add_argument("--span", type=float, help="s, times are drawn up to; default each verb's own")
    parser.add_argument("--out", type=Path, help="folder to work in; default a temporary one")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every interrupt")
    args = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for name in args.verbs.split(","):
            verb = VERBS[name] if args.span is None else replace(VERBS[name], span=args.span)
            folder = (args.out or Path(scratch)) / name.replace(" ", "-")
            folder.mkdir(parents=True)
            rows.append(campaign(verb, args.times, args.seed, folder))
            if args.json:
                args.json.write_text(json.dumps({"seed": args.seed, "verbs": rows}, indent=1) + "\n")
    print(console.table([{k: v for k, v in row.items() if k != "shots"} for row in rows]))
    return 0 if all(row["good"] == row["interrupted"] and row["ends"] and row["the same"] for row in rows) else 1


if __name__ == "__main__":
    raise SystemExit(main())
