"""Accuracy of the camera trackers on a drawn fish.

    python -m studies.tracker --out runs/tracker                     both methods, gates and reported cases
    python -m studies.tracker --parts heights --out runs/tracker     the tag for each height of the camera
    python -m studies.tracker --parts decoys --frames 10000 --out runs/tracker

Frames are drawn (synthetic): 1280x720, a lens with distortion, a slightly tilted camera. Writes OUT/PART.csv, a row a case, and
with the gates OUT/camera_noise.toml: the errors' white and correlated parts (m, rad, s) and the share of frames without a fix;
the shipped one is data/calib/camera_noise.toml. The exit status is 1 if a gate is missed. A case's frames a second are those of
the tracker alone, CPU time, one thread.
"""

import csv
import io
from functools import partial
from pathlib import Path
from typing import Any

from fishmj.base import console
from fishmj.base.source import made_by
from fishmj.base.store import write_text
from fishmj.log.toml import dumps
from studies.tracker import cases
from studies.tracker.error_statistics import noise

PARTS = ("gates", "reported", "heights", "decoys")
SHORT = 200  # frames of a case of `heights`, where every one is read anew


def options() -> console.Parser:
    """Parser of the study."""
    p = console.parser("studies.tracker", "How well the camera trackers find a drawn fish.")
    p.add_argument("--parts", nargs="+", default=["gates", "reported"], choices=PARTS, action=console.Distinct)
    p.add_argument(
        "--frames",
        type=console.whole(50, 1_000_000),
        default=2000,
        help="a case; a tenth where the fish is away",
    )
    p.add_argument("--methods", nargs="+", default=["tag", "colour"], choices=("tag", "colour"), action=console.Distinct)
    p.add_argument("--seed", type=console.SEED, default=0, help="of path, water and noise")
    p.add_argument("--out", type=console.out_folder, default="runs/tracker", help="(default: %(default)s)")
    return p


def main(argv: list[str]) -> int:
    """Measures, writes and prints; returns the exit code."""
    args = options().parse_args(argv)
    out, missed, told = Path(args.out), [], {}
    for part in args.parts:
        plan = _plan(part, args.methods)
        most = min(args.frames, SHORT) if part == "heights" else args.frames
        counts = [max(most // 10, 50) if case.absent else most for case in plan]
        rows: list[dict[str, Any]] = []
        statistics: dict[str, Any] = {}
        with console.Progress(sum(counts), f"tracker {part}", "frames") as bar:
            for k, (case, frames) in enumerate(zip(plan, counts, strict=True)):
                measured = cases.run(case, frames, args.seed, partial(_tick, bar, sum(counts[:k])))
                rows.append({"case": case.name} | measured.figures())
                if part == "gates":
                    statistics[case.name.replace(" ", "_")] = noise(measured.error, cases.FRAME)
        missed += _missed(part, rows)
        told[part] = rows
        console.say("", console.table(rows))
        write_text(out / f"{part}.csv", _csv(rows))
        if statistics:
            head: dict[str, Any] = {"schema": "fishmj.camera_noise/1", "origin": "synthetic", "frame": cases.FRAME}
            asked = f"--parts gates --frames {most} --methods {' '.join(args.methods)} --seed {args.seed}"
            head |= {"frames": most, "seed": args.seed, "source": f"python -m studies.tracker {asked}"}
            head |= made_by("numpy", "opencv-python-headless")
            write_text(out / "camera_noise.toml", dumps(head | statistics))
    console.say("", *(missed or ["every gate is met"]))
    if args.json:
        console.emit_json({"missed": missed, **told})
    return console.FAILED_CHECK if missed else console.OK


def _tick(bar: console.Progress, before: int, done: int) -> None:
    bar.update(before + done)


def _plan(part: str, methods: list[str]) -> list[cases.Case]:
    if part == "decoys":
        return [case for method in methods for case in cases.decoys(method)]
    plan = {"gates": cases.gated, "reported": cases.reported, "heights": cases.heights}[part]()
    return [case for case in plan if case.method in methods]


def _missed(part: str, rows: list[dict[str, Any]]) -> list[str]:
    """Missed gates, one line each."""
    missed = []
    for row in rows:
        if part in ("gates", "decoys") and row["false_locks"]:
            missed.append(f"{row['case']}: {row['false_locks']} false locks")
        if part == "decoys" and "alone" in row["case"] and row["fixes_%"] > 0:
            missed.append(f"{row['case']}: fixes of a fish that is not there")
        if part == "gates":
            most_mm, most_deg, least = cases.GATES["glare" if "glare" in row["case"] else "clean"]
            bounds = (("rms_mm", most_mm), ("rms_deg", most_deg))
            for name, bound in bounds:
                if not row[name] <= bound:
                    missed.append(f"{row['case']}: {name} {row[name]:.2f}, at most {bound:g}")
            for name, bound in (("fixes_%", least), ("frames/s", cases.FASTEST)):
                if not row[name] >= bound:
                    missed.append(f"{row['case']}: {name} {row[name]:.1f}, at least {bound:g}")
    return missed


def _csv(rows: list[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)
    return text.getvalue()


if __name__ == "__main__":
    raise SystemExit(console.run(main))
