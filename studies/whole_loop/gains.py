"""Gains of latency and horn in the search of a robot, channel by channel: the reason that the horn is fitted but not named.

    python -m studies.whole_loop.gains --only 4 --out runs/whole_loop      after whole_loop --only 4 --out runs/whole_loop

The search is repeated from `fish.toml` and `faulty/trials` of the robot's folder, some 3 minutes of a core; missing records are
played again. For each effect that was found:

    gain     drop of |z|^2 beyond the possible gain of errors of the other formulas (`Likelihood.tolerating`)
    asked    gain that the search requires before it adds a further effect (`search.stepwise.Beyond`)
    of all   its share of the gains of all effects
    there    its share on the channels where it shows (`Effect.shows`)
"""

import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.store import write_json
from fishmj.gap import progress
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.search.fit import drop_effect, on_records
from fishmj.gap.search.stepwise import Selection
from fishmj.gap.thresholds import Gates
from fishmj.gap.workflow import investigate
from fishmj.log.dataset import take
from fishmj.mjcf.reading import load_robot
from studies.whole_loop import steps
from studies.whole_loop.steps import Fault, Loop


def gains(found: Selection, gates: Gates) -> dict[str, dict]:
    """Gains of the found effects, in |z|^2: {effect: {"gain", "asked", "by_channel": {channel: gain}}}."""
    out = {}
    for name in found.best.names:
        others = drop_effect(found.near.subset(), found.best, name)
        near, imitated = found.near.tolerating(others.row, gates)
        whole = near.subset()
        best = on_records(whole, found.best)
        less, channel = drop_effect(whole, best, name), whole.layout.channel
        fall = less.z**2 - best.z**2
        by_channel = {str(c): float(np.sum(fall[channel == c])) for c in dict.fromkeys(channel.tolist())}
        asked = gates.gain + gates.min_gain_per_sample * near.layout.size + imitated
        out[name] = {"gain": less.cost - best.cost, "asked": asked, "by_channel": by_channel}
    return out


def shares(told: dict[str, dict], shows: dict[str, tuple[str, ...]]) -> dict[str, tuple[float, float]]:
    """Shares {effect: (share of all gains, share on the channels where it shows)}. shows: {effect: channels}."""
    there = lambda name, channels: sum(told[name]["by_channel"].get(channel, 0.0) for channel in channels)
    whole = sum(row["gain"] for row in told.values())
    return {n: (told[n]["gain"] / whole, there(n, shows[n]) / sum(there(other, shows[n]) for other in told)) for n in told}


def searched(loop: Loop, seed: int) -> dict[str, dict]:
    """Gains of one robot, with the shares. Raises ConfigError if its water was not calibrated yet."""
    folder = loop.folder(seed)
    if not (folder / "fish.toml").is_file():
        raise ConfigError(f"{folder}/fish.toml: no such file; python -m studies.whole_loop --only {seed} --out {loop.out}")
    steps.played(loop, seed, loop.experiments, folder / "faulty", Fault.of(seed).options())
    model = SwimmingFish(load_robot(folder / "fish.toml"))
    trials = list(take(folder / "faulty/trials").trials.values())
    inquiry = investigate(model, trials, null=SimulatedNull(runs=loop.null_runs), bars=progress.terminal_bar)
    told = gains(inquiry.found, inquiry.gates)
    parts = shares(told, {effect.name: effect.shows for effect in model.active.effects})
    return {name: row | {"of_all": parts[name][0], "there": parts[name][1]} for name, row in told.items()}


def main(argv: list[str]) -> int:
    """Runs the study. Exit code 0: every robot was searched."""
    parser = console.parser("studies.whole_loop.gains", __doc__ or "")
    add = parser.add_argument
    add("--only", type=console.Listed(console.SEED), default=[0], metavar="SEED,..", help="robots (default 0)")
    add("--null-runs", type=console.whole(8, 1000), default=96, metavar="N", help="of the search (default 96)")
    add("--out", type=console.out_folder, required=True, help="folder of whole_loop")
    args = parser.parse_args(argv)
    loop, rows, told = Loop(out=args.out, null_runs=args.null_runs), [], {}
    for seed in args.only:
        found = told[f"{seed}"] = searched(loop, seed)
        write_json(loop.folder(seed) / "gains.json", found)
        for name, row in found.items():
            shown = {"seed": seed, "effect": name, "gain": f"{row['gain']:.0f}", "asked": f"{row['asked']:.0f}"}
            rows.append(shown | {"of all": f"{row['of_all']:.2%}", "there": f"{row['there']:.1%}"})
    console.say(console.table(rows))
    if args.json:
        console.emit_json(told)
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
