"""`python -m fishmj.train.curves RUN [RUN ...] --out curves.png`: learning curves, reward and distance, grouped by label.

A RUN is a run's folder or a metrics.jsonl; `label=RUN` names it. Runs with one label are drawn as their mean and range.
"""

import json
from pathlib import Path

import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.figures import BLUE, GREEN, PURPLE, VERMILION, canvas, save, style
from fishmj.base.pages import drawn

COLOURS = (BLUE, VERMILION, GREEN, PURPLE)


def read(path: Path) -> dict[str, np.ndarray]:
    """Columns step, seconds, reward, late_distance of one run, and the rows of its assessments."""
    path = path / "metrics.jsonl" if path.is_dir() else path
    if not path.is_file():
        raise ConfigError(f"{path}: no such file; a run's folder holds metrics.jsonl")
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    going = [r for r in rows if "reward" in r]
    return {key: np.array([r[key] for r in going], float) for key in ("step", "seconds", "reward", "late_distance")}


def smooth(y: np.ndarray, share: float = 0.02) -> np.ndarray:
    """Moving average; the window is `share` of the run."""
    n = max(1, round(share * len(y)))
    padded = np.pad(y, (n // 2, n - 1 - n // 2), mode="edge")
    return np.convolve(padded, np.ones(n) / n, "valid")


@style()
def draw(groups: dict[str, list[dict]], out: Path) -> Path:
    """Draws one figure: reward, and distance in the second half of the episodes, over control steps."""
    figure, ((reward, distance),) = canvas(1, 2, (10, 3.8))
    for (label, runs), colour in zip(groups.items(), COLOURS * 3, strict=False):
        grid = np.geomspace(max(r["step"][0] for r in runs), min(r["step"][-1] for r in runs), 300)
        for ax, key in zip((reward, distance), ("reward", "late_distance"), strict=True):
            lines = np.array([np.interp(grid, r["step"], smooth(r[key])) for r in runs])
            ax.fill_between(grid, lines.min(0), lines.max(0), color=colour, alpha=0.25, lw=0)
            ax.plot(grid, lines.mean(0), color=colour, lw=1.8, label=f"{drawn(label)} (n = {len(runs)})")
    for ax, title in zip((reward, distance), ("reward per control step", "distance to the target after 15 s [m]"), strict=True):
        ax.set(xscale="log", xlabel="control steps of 0.2 s", title=title)
        ax.grid(alpha=0.3)
    distance.set_yscale("log")
    reward.legend(frameon=False)
    return save(figure, out)


def main(argv: list[str]) -> int:
    """Draws the learning curves of the given runs; returns the exit code."""
    p = console.parser("train.curves", "Draw the learning curves of training runs.")
    p.add_argument("runs", nargs="+", metavar="[LABEL=]RUN")
    p.add_argument("--out", type=Path, default=Path("curves.png"))
    args = p.parse_args(argv)
    groups: dict[str, list[dict]] = {}
    for item in args.runs:
        label, _, path = item.rpartition("=")
        groups.setdefault(label or Path(path).name, []).append(read(Path(path)))
    out = draw(groups, args.out)
    console.say(f"wrote {out}")
    if args.json:
        console.emit_json({"out": str(out), "runs": {k: len(v) for k, v in groups.items()}})
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
