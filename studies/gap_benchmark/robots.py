"""The search on other robots than the shipped fish, and on logs of other sensors than the second robot's own.

python -m studies.gap_benchmark.robots pike.toml tendon_fish --seeds 3 --out runs/robots
python -m studies.gap_benchmark.robots fish --sensors --seeds 10 --out runs/sensors

Each seed is a robot of the model's kind, made by the second robot, in a session of four experiments. Without --sensors nothing is
hidden in one set and 50 ms of latency in another. With it nothing is hidden, and the sensors differ from the usual, as the logs
state.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj.base import console
from fishmj.gap.bench.bench_rows import judge_cases
from fishmj.gap.bench.run_case import effect_row, fish
from fishmj.gap.bench.score import share
from fishmj.gap.commands import admission, gap_options
from fishmj.gap.commands.plant import with_lost_rows
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.thresholds import frozen
from fishmj.gap.workflow import compile_kernel, investigate
from fishmj.mjcf.reading import load_robot

SESSION = ("gait_fast", "chirp", "steps", "turn_left")
LATE = 0.05  # s
NOISES = ("network.angle_noise", "camera.position_noise", "camera.heading_noise", "meter.voltage_noise", "meter.current_noise")


class Condition(NamedTuple):
    """effects: hidden. louder: factor on the sensors' noise. fields: of the second robot's sensors. lost: share of rows."""

    effects: dict[str, dict[str, float]]
    louder: float = 1.0
    fields: dict[str, float] = {}
    lost: float = 0.0


ROBOTS = {"nothing hidden": Condition({}), "50 ms of latency": Condition({"command_latency": {"delay": LATE}})}
SENSORS = {
    "twice the noise": Condition({}, louder=2.0),
    "joints at 25 Hz": Condition({}, fields={"network.period": 0.04}),
    "a fifth of all rows lost": Condition({}, lost=0.2),
    "camera at 30 Hz": Condition({}, fields={"camera.period": 1 / 30}),
}


class TrialSettings(NamedTuple):
    """Settings of one search. model: name or TOML file."""

    model: str
    condition: str
    seed: int

    @property
    def id(self) -> str:
        """Id of the search's row."""
        return f"{Path(self.model).stem}, {self.condition}, {self.seed}"


def main(argv: list[str]) -> int:
    """Runs the searches and prints a table. Returns the exit code."""
    parser = console.parser("studies.gap_benchmark.robots", __doc__)
    add = parser.add_argument
    add("models", nargs="+", type=console.text, metavar="MODEL", help="names or TOML files of descriptions")
    add("--sensors", action="store_true", help="other sensors, nothing hidden (default: nothing, and a latency)")
    add("--seeds", type=console.whole(1, 1000), default=3, metavar="N", help="robots of each kind (default 3)")
    gap_options.of_seed(add, "of the first robot")
    add("--jobs", type=console.whole(1, 1024), default=1, metavar="N", help="processes side by side (default 1)")
    add("--out", type=console.out_folder, help="folder for rows.jsonl; the same command goes on where it stopped (default none)")
    args = parser.parse_args(argv)
    for model in args.models:
        admission.searchable(load_robot(model), model)
    for model in args.models:  # once each, before processes begin
        compile_kernel(fish(model), console.say)
    asked = SENSORS if args.sensors else ROBOTS
    seeds = range(args.seed, args.seed + args.seeds)
    todo = [TrialSettings(model, name, seed) for model in args.models for name in asked for seed in seeds]
    rows = judge_cases(todo, args.out, row_of, args.jobs, "searches")
    table = [summary(model, name, rows) for model in args.models for name in asked]
    console.say(console.table(table))
    if args.json:
        console.emit_json({"rows": rows, "table": table})
    return console.OK


def trials_of(one: TrialSettings) -> list:
    """The data set of a search."""
    from fishmj.gap.laboratory.virtual_robot import generate, plant

    how = {**SENSORS, **ROBOTS}[one.condition]
    usual = plant({}, nuisance=0.0, robot=one.model)
    louder = {} if how.louder == 1.0 else {name: how.louder * value_of(usual, name) for name in NOISES}
    trials = generate(how.effects, SESSION, one.seed, robot=one.model, sensors=louder | how.fields)
    rng = np.random.default_rng([one.seed, 19])
    return [with_lost_rows(trial, how.lost, rng) for trial in trials]


def value_of(made, field: str) -> float:
    """Value of a constant by its dotted name."""
    group, _, key = field.partition(".")
    return float(getattr(getattr(made, group), key))


def row_of(one: TrialSettings) -> dict:
    """Row of a search."""
    verdict = investigate(fish(one.model), trials_of(one), gates=frozen(), null=SimulatedNull(), seed=one.seed).verdict
    row = {"id": one.id, "model": Path(one.model).stem, "condition": one.condition, "seed": one.seed}
    row |= {"answer": verdict.answer, "said": [effect_row(effect) for effect in verdict.effects]}
    return row | {"gap_before": verdict.gap_before, "gap_after": verdict.gap_after}


def summary(model: str, condition: str, rows: list[dict]) -> dict:
    """Line of the table: right answers with 95 % bounds; for a latency its values and the number of intervals that hold."""
    mine = [row for row in rows if (row["model"], row["condition"]) == (Path(model).stem, condition)]
    hidden = {**SENSORS, **ROBOTS}[condition].effects
    if hidden:
        right = [row for row in mine if row["answer"] == "NAMED" and [e["name"] for e in row["said"]] == list(hidden)]
    else:
        right = [row for row in mine if row["answer"] == "AGREES"]
    got = share(len(right), len(mine))
    values = [row["said"][0]["values"]["delay"] for row in right] if hidden else []
    line = {"model": Path(model).stem, "set": condition, "right": len(right), "of": len(mine)}
    line |= {"95 %": f"{got['low']:.0%} to {got['high']:.0%}", "gap": round(float(np.median([r["gap_before"] for r in mine])), 2)}
    line["ms"] = ", ".join(f"{1e3 * value:.1f}" for value, _, _ in values) or "-"
    return line | {"interval holds": f"{sum(low <= LATE <= high for _, low, high in values)}" if values else "-"}


if __name__ == "__main__":
    raise SystemExit(console.run(main))
