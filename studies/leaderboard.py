"""Leaderboard of controllers and shipped policies: `python -m studies.leaderboard`.

    python -m studies.leaderboard                  the tables from stored rows; exit 1 if the page shows others
    python -m studies.leaderboard --run            judge again in the waters of a CPU, about four minutes of one core
    python -m studies.leaderboard --run --only station-sb3   judge one, and leave the rows of the others
    python -m studies.leaderboard --write          put tables into docs/train/results.md and cards beside the shipped policies

Rows of the CPU's waters are in studies/training/rows/judged/WATER.json, a results.json of `fishmj evaluate` without its
directions. Rows of the flow solver are studies/solver/rows/judged_*.csv, one line a trial; they need a GPU. The card of
`station-family` also has the waters of `studies.judged_waters`.
"""

import csv
import json
import re
from hashlib import sha256 as digest_of
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj.base import console
from fishmj.base.calib import constant
from fishmj.base.store import read_json, sha256, write_text
from fishmj.control.policy import Policy, file_of, shipped
from fishmj.evaluate.__main__ import main as evaluate
from fishmj.evaluate.metrics import gather
from fishmj.evaluate.policy_card import KEYS, KEYS_BY_SPEED, card_path, make_card, write_card
from studies import judged_waters

ROOT = Path(__file__).resolve().parent.parent
STORED = ROOT / "studies" / "training" / "rows" / "judged"
SOLVED = ROOT / "studies" / "solver" / "rows"
CURVES = ROOT / "studies" / "training" / "rows"
PAGE = ROOT / "docs" / "train" / "results.md"
CONTROLLERS = ("dob", "koopman-rls", "mpc-flow", "pi", "privileged", "drift")  # the page has a table of all
WATERS = {  # of the CPU: name -> heading
    "structured": "structured",
    "swift": "fitted, slip 1",
    "swift-slip099": "fitted, slip 0.99",
    "swift-slip098": "fitted, slip 0.98",
    "swift-reference": "fitted, reference",
}
CURVE_OF = {
    "paper": "ppo-planar-1.jsonl",
    "paper-sac": "sac-1.jsonl",
    "station-family": "ppo-family-3.jsonl",
    "station-sb3": "sb3-ppo-0.jsonl",
}
CONDITION = "default turbulence 5 % unless said, water lbm"  # of the flow solver
OTHERS = {  # rows of a card, each of some conditions of `judged_waters`
    "reference-2, two other draws": ("reference-10", "reference-11"),
    "reference-3": ("reference-3",),
    "paper slip 0.97, two draws": ("slip-0.97", "slip-0.97-10"),
    "reference-2, 0 to 0.04 m/s": ("rest",),
    "paper slip 1, 0 to 0.04 m/s": ("slip-1-rest",),
    "reference-2, 0.35 and 0.4 m/s": ("fast",),
    "reference-2, gusts of 25 %": ("gusts",),
    "reference-2, turbulence of 25 %": ("turbulence",),
    "reference-2, commands 85 ms later": ("late",),
    "reference-2, another mass, gain or tail": ("heavy", "light", "weak", "tail"),
    "cells of 1.5 cm, or box round the fish": ("cells-1.5", "window-0.995", "window-0.985"),
}
WEIGHTS = {  # digest of the arrays that the flow solver judged: a policy trained anew has none of its rows
    "paper": "30be15fc7745b3de5c71abceefa1cb316fc0ca8e2c0e5ea40991ed788cf97703",
    "pilot": "f73d422ad9ab2e6acafd3b1eb236210eb6972799244d7354069dc12ea52383b6",
    "station": "9bd216c1096445e789053ce72d72575e4437baaa49182d8d06c0b7e6ca766ee2",
    "station-family": "7dc318fb5c654bb30bc7aa8acb25b57ddf9c2f12a0596d46a701d829af4885b8",
    "station-sac": "4a3c88ca054e9ba543e943c149920281f4a7a2696e00773758caf76bd497f871",
}


class SolverRows(NamedTuple):
    """Judgements in one water of the flow solver: heading, file, its controllers, command without them, options of one trial."""

    heading: str
    file: str
    controllers: tuple[str, ...]
    options: str
    engine: str


SOLVER = (
    SolverRows(
        "solver, plain",
        "judged_trials.csv",
        ("station-family", "station", "station-sac", "pilot", "paper", "pi", "dob", "pd", "adrc-c1"),
        "--water lbm --tanks 24 --device cuda",
        "tanks, paper, slip 1",
    ),
    SolverRows(
        "solver, `reference-2`",
        "judged_reference.csv",
        (
            "station-family",
            "station",
            "pi",
            "dob",
            "koopman",
            "koopman-flow",
            "koopman-rls",
            "mpc",
            "mpc-flow",
            "privileged",
            "pnl",
            "adrc-c1",
            "pd",
        ),
        "--water lbm --reference --tanks 24 --device cuda",
        "tanks, reference-2, paper_refined, slip 0.99, boundary rims",
    ),
)


def arrays_sha256(name: str) -> str:
    """Digest of a policy's weights without its header."""
    weights = Policy.load(name).weights
    return digest_of(b"".join(np.asarray(a, np.float32).tobytes() for layer in weights for a in layer)).hexdigest()


def run(waters: list[str], only: list[str]) -> None:
    """Judges all controllers and policies, or those of `only`, over the 72 trials in waters of the CPU, and stores the rows."""
    every = [*CONTROLLERS, *shipped()]
    for water in waters:
        folder, path = ROOT / "runs" / "leaderboard" / water, STORED / f"{water}.json"
        options = ["--water", water, "--engine", "compiled"]
        evaluate([*(only or every), *options, "--out", str(folder)])
        found = read_json(folder / "results.json")
        rows = {row["controller"]: row for row in (read_json(path)["results"] if only else ())}
        rows |= {row["controller"]: less(row) | {"worst": relative(row["worst"])} for row in found["results"]}
        command = " ".join(["fishmj evaluate", *every, *options])  # of all: the trials of one do not depend on the others
        stored = {"condition": found["condition"], "command": command, "results": [rows[name] for name in every]}
        write_text(path, json.dumps(stored, indent=1) + "\n")


def relative(worst: dict) -> dict:
    """Worst trial whose replay names no folder of this machine."""
    return worst | {"replay": worst["replay"].replace(f"{ROOT}/", "")}


def less(row: dict) -> dict:
    """Row of a results.json with the figures that a card shows."""
    some = lambda figures, keys: {key: {k: v for k, v in figures[key].items() if k not in ("why", "unit")} for key in keys}
    by_speed = {speed: some(figures, KEYS_BY_SPEED) for speed, figures in row["by_speed"].items()}
    kept = ("controller", "n", "policy_sha256", "water", "engine", "held", "held_by_speed", "worst")
    return {**{key: row[key] for key in kept}, "overall": some(row["overall"], KEYS), "by_speed": by_speed}


def solved(rows: SolverRows) -> dict[str, dict]:
    """Rows of a results.json for each controller, from the figures of single trials in the flow solver."""
    with (SOLVED / rows.file).open(encoding="utf-8") as file:
        lines = [line for line in csv.DictReader(file) if line.get("water", "reference-2") == "reference-2"]
    found: dict[str, dict] = {}
    for name in rows.controllers:
        mine = [line for line in lines if line["controller"] == name]
        if not mine or (name in shipped() and arrays_sha256(name) != WEIGHTS.get(name)):
            continue
        seed, repeats = int(mine[0].get("seed", 0)), 1 + max(int(line["repeat"]) for line in mine)
        drawn = f"{rows.options} --seed {seed}" if seed else rows.options
        command = f"fishmj evaluate {name} {drawn if repeats == 3 else f'{drawn} --repeats {repeats}'}"
        found[name] = row_of(name, mine, rows.engine, command, [drawn] * len(mine))
    return found


def row_of(name: str, lines: list[dict], engine: str, command: str, options: list[str]) -> dict:
    """Row of a results.json from the figures of single trials in the flow solver; options: of each trial."""
    figures = {key: np.array([float(line[key] or "nan") for line in lines]) for key in KEYS}
    speeds, after = np.array([line["speed"] for line in lines]), figures["rmse_after_arrival"]
    known = sorted(set(speeds), key=float)
    holds = (figures["arrival"] > 0) & (after <= constant("protocol", "arrival_radius"))
    worst = int(np.nan_to_num(after, nan=np.inf).argmax())
    last = lines[worst]
    trial = f"--speeds {last['speed']} --los {last['los_deg']} --repeats {int(last['repeat']) + 1}"
    seeds = ", ".join(sorted({line.get("seed", "0") for line in lines}, key=int))
    return {
        "controller": name,
        "n": len(lines),
        "policy_sha256": sha256(file_of(name)) if name in shipped() else "",
        "water": {"name": "lbm", "kind": "lbm"},
        "engine": engine,
        "held": int(holds.sum()),
        "held_by_speed": {speed: int(holds[speeds == speed].sum()) for speed in known},
        "worst": {
            "trial": f"{name}_u{last['speed']}_los{int(last['los_deg']):03d}_r{last['repeat']}",
            "seed": int(last.get("seed", 0)),
            "rmse_after_arrival": float(last["rmse_after_arrival"]) if last["rmse_after_arrival"] else None,
            "replay": f"fishmj evaluate {name} {options[worst]} {trial} --out runs/worst_{name} --log",
        },
        "overall": gather(figures),
        "by_speed": {u: gather({key: figures[key] for key in KEYS_BY_SPEED}, speeds == u) for u in known},
        "command": command,
        "condition": f"{len(lines)} trials of 60 s, flow {'/'.join(known)} m/s, {CONDITION}, engine {engine}, seeds {seeds}",
    }


def in_other_waters() -> dict[str, dict[str, dict]]:
    """Rows of `judged_waters` by heading and controller; none if the policy is trained anew."""
    name, found = judged_waters.NAME, {}
    if arrays_sha256(name) != WEIGHTS.get(name):
        return {}
    for heading, conditions in OTHERS.items():
        lines = [line | {"of": one} for one in conditions for line in judged_waters.stored_rows(one)]
        commands = [f"fishmj evaluate {name} {other_options(one)} --repeats 1" for one in conditions]
        if any(judged_waters.CONDITIONS[one].changes for one in conditions):
            commands.append("python -m studies.judged_waters --list  # writes the robot")
        options = [re.sub(" --speeds [0-9.,]+", "", other_options(line["of"])) for line in lines]
        row = row_of(name, lines, f"tanks, {heading}", "; ".join(commands), options)
        found[f"solver, {heading}"] = {name: row}
    return found


def other_options(one: str) -> str:
    """Options of a condition of `judged_waters`; a changed robot by the file that `--list` writes."""
    robot = ["--robot", str(judged_waters.OUT / f"{one}.toml")] if judged_waters.CONDITIONS[one].changes else []
    return " ".join([*judged_waters.options_of(one), *robot])


def stored() -> dict[str, dict[str, dict]]:
    """Rows by heading and controller; a policy whose weights were judged before a change of its file is left out."""
    found: dict[str, dict[str, dict]] = {}
    for water, heading in WATERS.items():
        table = read_json(STORED / f"{water}.json")
        common = {key: table[key] for key in ("condition", "command")}
        of = lambda name: sha256(file_of(name)) if name in shipped() else ""
        rows = [row for row in table["results"] if row["controller"] in (*CONTROLLERS, *shipped())]
        found[heading] = {row["controller"]: common | row for row in rows if row["policy_sha256"] == of(row["controller"])}
    return found | {rows.heading: solved(rows) for rows in SOLVER} | in_other_waters()


def tables(found: dict[str, dict[str, dict]]) -> str:
    """Leaderboard as Markdown: the waters of the CPU, then the flow solver; best in the reference fit first."""
    first = found[WATERS["swift-reference"]]
    names = sorted({name for rows in found.values() for name in rows}, key=lambda name: (value(first.get(name)), name))
    parts = []
    for headings in (list(WATERS.values()), [rows.heading for rows in SOLVER]):
        some = [name for name in names if any(name in found[heading] for heading in headings)]
        lines = [f"| | {' | '.join(headings)} |", f"|---|{'--:|' * len(headings)}"]
        lines += [f"| `{name}` | {' | '.join(cell(found[heading].get(name)) for heading in headings)} |" for name in some]
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def value(row: dict | None) -> float:
    """RMSE after arrival of a row [m]; infinite without one."""
    return row["overall"]["rmse_after_arrival"]["value"] if row else float("inf")


def cell(row: dict | None) -> str:
    """Cell of the leaderboard: arrivals (of 72 if no number is said), RMSE after arrival, its interval."""
    if row is None:
        return "not run"
    arrived, figure = round(row["n"] * row["overall"]["arrival"]["value"]), row["overall"]["rmse_after_arrival"]
    count = f"{arrived}" if row["n"] == 72 else f"{arrived}/{row['n']}"
    return f"{count}, {figure['value']:.3f} ({figure['low']:.3f} {figure['high']:.3f})"


BEGIN, END = "<!-- python -m studies.leaderboard --write -->", "<!-- end -->"


def on_page(text: str, made: str) -> str:
    """Text of the page with these tables between its two marks."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n\n{made}\n\n{END}{after}"


def cards(found: dict[str, dict[str, dict]]) -> list[Path]:
    """Writes the cards of the shipped policies."""
    written = []
    for name in shipped():
        rows = [row for rows in found.values() if (row := rows.get(name))]
        judged = [{"condition": row["condition"], "command": row["command"], "results": [row]} for row in rows]
        curve = CURVES / CURVE_OF[name] if name in CURVE_OF else None
        written.append(write_card(make_card(name, judged, curve), card_path(name)))
    return written


def main(argv: list[str]) -> int:
    """Prints the leaderboard; returns the exit code."""
    parser = console.parser("leaderboard", __doc__ or "")
    parser.add_argument("--run", nargs="*", choices=tuple(WATERS), metavar="WATER", help="judge again; default all")
    parser.add_argument("--only", nargs="+", choices=(*CONTROLLERS, *shipped()), metavar="NAME", help="with --run: these alone")
    parser.add_argument("--write", action="store_true", help="write page and cards")
    args = parser.parse_args(argv)
    if args.run is not None:
        run(args.run or list(WATERS), args.only or [])
    found = stored()
    made, page = tables(found), PAGE.read_text(encoding="utf-8")
    console.say(made, "", "need a GPU, read from stored rows:")
    for rows in SOLVER:
        console.say(f"  fishmj evaluate {' '.join(rows.controllers)} {rows.options}")
        if missing := [name for name in (*shipped(), *CONTROLLERS) if name not in found[rows.heading]]:
            console.say(f"  not run: {' '.join(missing)}")
    if args.write:
        write_text(PAGE, on_page(page, made))
        console.say("", *(f"wrote {path.relative_to(ROOT)}" for path in (PAGE, *cards(found))))
    same = on_page(page, made) == page or args.write
    console.say("", "the page shows these tables" if same else f"{PAGE.relative_to(ROOT)} shows others: --write puts these there")
    if args.json:
        console.emit_json({"rows": found, "same": same})
    return console.OK if same else console.FAILED_CHECK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
