"""Damaged recordings of every format end in one of our errors, never in a traceback, and write nothing beside --out.

FISHMJ_FUZZ_SECONDS: for how long each format is damaged (default 1 s, so that the whole file takes under 20 s). Example n of a
format is the same every time: its number seeds the damage. FISHMJ_FUZZ_FIRST: the number of the first example (default 0), to go
on where a run ended. FISHMJ_FUZZ_REPORT: a file to which every format adds how many examples ran.
"""

import contextlib
import io
import os
import random
import shutil
import time

import lab_files
import pytest
from mutations import first_seed, seconds, tell
from synthetic import whole_trial

from fishmj import log
from fishmj.base import console
from fishmj.log import __main__ as command


def own(root, form):
    log.write_trial(root / "set" / "a", whole_trial(0.2), form=form)
    return root / "set"


MAKERS = lab_files.MAKERS | {"own_csv": lambda root: own(root, "csv"), "own_npz": lambda root: own(root, "npz")}


def files_of(path):
    return sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]


@pytest.mark.slow
@pytest.mark.parametrize("name", MAKERS)
def test_a_damaged_recording_is_read_or_refused_in_one_line(tmp_path, monkeypatch, name):
    monkeypatch.setattr(os, "fsync", lambda handle: None)  # durability is tested elsewhere
    rng_seed, count, refused = first_seed(), 0, 0
    source = MAKERS[name](tmp_path / "source")
    kept = {file: file.read_bytes() for file in files_of(source)}
    out = tmp_path / "out" / "set"
    out.parent.mkdir()
    until = time.monotonic() + seconds(1.0)
    while time.monotonic() < until or count < 3:
        rng = random.Random(f"{name} {rng_seed}")
        file = rng.choice(sorted(kept))
        damaged = lab_files.mutated(kept[file], rng)
        file.write_bytes(damaged)
        said, complaint = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complaint):
            code = console.run(command.main, ["import", str(source), "--out", str(out), "--yes"])
        assert code in (console.OK, console.BAD_INPUT), f"example {rng_seed} of {name}: {complaint.getvalue()}"
        assert file.read_bytes() == damaged, "a source was edited"
        assert [p.name for p in out.parent.iterdir()] == ([out.name] if code == console.OK else [])
        if code == console.BAD_INPUT:
            last = complaint.getvalue().strip().split("\n")[-1]
            assert last.startswith("fishmj: ") and len(last) < 4000 and last.isprintable(), f"example {rng_seed}: {last!r}"
            refused += 1
        else:
            shutil.rmtree(out)
        file.write_bytes(kept[file])
        rng_seed += 1
        count += 1
    tell(f"{name}, {refused} refused", count)
