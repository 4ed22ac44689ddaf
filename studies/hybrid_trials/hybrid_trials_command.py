"""Test of the online correction: a policy holds station in MuJoCo, with and without it, compared with the flow solver.

    fishmj hydro_fit hybrid --wrong stream --device cuda     12 trials of 120 s at 0.2 m/s in turbulence; resumable
    fishmj hydro_fit hybrid --wrong all ...                  every condition, one after the other
    fishmj hydro_fit hybrid --domain laptop --episodes 2 --seconds 20         a preview on a CPU

    none          the water as fitted                slip      the solver at a slip ratio 0.02 lower than the water's
    tail          a tail 10 % shorter, in the water fitted to a no-slip hull (NAME-noslip)
    added_mass    the tail's added mass 30 % off     stream    the tank's stream 0.05 m/s faster than MuJoCo's

Every trial is swum three times, with the same fish, noise and eddies: in MuJoCo alone, in MuJoCo corrected (the water `hybrid`),
and in the flow solver, closed loop. Solver trials are saved in --out and reused by all conditions. The trials are those of
`evaluate --speeds 0.2`. RMSE is the distance from the target over the second half of a trial. Speed is over ground, averaged over
a beat; place is the distance from the solver's fish. Both are means after the first segment, before which nothing is corrected.

`none` is the control, which runs with every other condition. A metric is off if it differs from the solver's by two standard
errors and by more than in the control (bound of its 95 % interval). The correction holds if less than half of that difference
remains, or no more than in the control. Other metrics must not become off, and place and RMSE of the control must not grow by
more than 5 %.
"""

import contextlib
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from fishmj import control
from fishmj.base import console, interrupt
from fishmj.base.errors import ConfigError
from fishmj.base.source import package_sha256
from fishmj.base.store import read_json, write_json
from fishmj.engines import batch
from fishmj.engines.hybrid import HybridOptions
from fishmj.engines.hybrid.engine import HybridEngine
from fishmj.engines.hybrid.hybrid_segment import Replay
from fishmj.evaluate import protocol, run_trials
from fishmj.evaluate.metrics import Result, beat_mean, difference
from fishmj.evaluate.protocol import Trials
from fishmj.hydro_fit.campaign.data.collect import ON_GPU, tanks_on
from fishmj.hydro_fit.campaign.data.solver_hash import solver_sha256
from fishmj.lbm_oracle.fluid.device import device_of
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import NAMES, PREVIEWS, preset
from fishmj.lbm_oracle.run.solver_water import SolverWater, boundary_name
from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import geometry_of
from fishmj.mjcf.reading import load_robot
from fishmj.water import choice
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import DrawnFlow, Flow, shifted
from studies.rank_waters.rank import GAP

SHORTER, LESS, FASTER, STICKS = 0.9, 0.7, 0.05, 0.02  # of the tail's length, of its added mass; m/s; less slip
WRONG = ("none", "slip", "tail", "added_mass", "stream")
CONTROL = "none"  # condition with the correct water
RIGHT = {"rmse": GAP, "speed": 0.01}  # m, m/s: its largest difference; 0.01 is the tolerance of motion at 0.2 m/s
FIRST_KIND = 2.0  # standard errors from which on a metric counts as off
MUST, TARGET = 0.5, 0.25  # required and desired remaining share of the difference
WORSE, SHARE = 1.05, 0.10  # largest growth of the control's metrics; largest share of time in the solver
LEAST = 0.02  # m/s, least speed of the stream, so that a slower tank still has a speed above 0
SHOWN = ("figure", "solver", "alone - solver", "hybrid - solver", "right water", "left", "mended")


def options() -> console.Parser:
    """Parser of the verb `hybrid`."""
    parser = console.parser("hydro_fit hybrid", __doc__)
    add = parser.add_argument
    add("--fish", type=console.text, default="fish", help="a shipped name or a description (.toml)")
    add("--model", type=console.text, default="fitted", help="water to correct: fitted, a name or .toml")
    noslip = "water of --wrong tail, fitted to a no-slip hull; default the model's name with -noslip"
    add("--noslip", type=console.text, help=noslip)
    add("--policy", type=console.text, default="station", help="controller, shipped policy, policy file or module:Name")
    wrong = "error in MuJoCo's water or in the tank"
    add("--wrong", choices=(*WRONG, "all"), default="none", help=wrong)
    add("--episodes", type=console.whole(1, 1000), default=12, help="number of trials")
    add("--seconds", type=console.number(1, 600), default=120.0, help="length of each trial; 120 s include three segments")
    add("--speed", type=console.number(LEAST, 1), default=0.2, metavar="M/S", help="speed of the current in MuJoCo")
    console.add_settings(parser, HybridOptions, "every", "first", "lead", "own")
    add("--domain", choices=NAMES, help="box of water; by default that of the model's segments; laptop is a preview")
    add("--device", type=console.device, default="auto", help=console.DEVICE_HELP)
    add("--tanks", type=console.whole(1, 256), help=f"number of parallel tanks; default {ON_GPU} on a GPU, else 1")
    add("--seed", type=console.SEED, default=0, help="of the trials")
    place = "folder of solver trials and results; an existing one is continued"
    add("--out", type=console.out_folder, default="runs/hybrid", help=place)
    return parser


def main(argv: list[str]) -> int:
    """Runs the verb `hybrid`; exit code 1 if the correction does not hold."""
    args = options().parse_args(argv)
    if args.seconds <= (least := args.first + args.lead + HybridOptions.span):
        raise ConfigError(
            f"hydro_fit hybrid: --seconds {args.seconds:g}: the first segment ends at {least:g} s; take longer trials"
        )
    asked = WRONG if args.wrong == "all" else dict.fromkeys((CONTROL, args.wrong))
    conditions = [condition(name, args) for name in asked]
    args.tanks = tanks_on(str(device_of(args.device)), args.tanks)
    trials = trials_of(args)
    box, solved = solver_of(args).domain, {(c.slip, c.faster) for c in conditions}
    share = args.lead + HybridOptions.span
    water = len(trials) * args.seconds * (len(solved) + len(conditions) * share / args.every)
    less = "take fewer --episodes, shorter --seconds; --domain laptop is a preview"
    solver_cost.agree("hydro_fit hybrid", args.device, [(preset(box), water)], instead=less, tanks=min(args.tanks, len(trials)))
    if box in PREVIEWS:
        console.warn(f"hydro_fit hybrid: the box {box} is a preview, no judgement")
    found: list[dict] = []
    with interrupt.keeping(lambda: f"{args.out} holds what is finished; {interrupt.again()}"):
        for one in conditions:
            found.append(kept(one, trials, args, found[0] if found else None))
            print_condition(found[-1])
    if args.json:
        console.emit_json({"ok": all(f["ok"] for f in found), "conditions": found})
    return console.OK if all(f["ok"] for f in found) else console.FAILED_CHECK


@dataclass(frozen=True)
class StudyCondition:
    """Condition of the study: MuJoCo's robot in its water, the chain of that water, slip and stream of the tanks."""

    name: str
    robot: Robot
    chain: planar_chain.Chain
    slip: float
    faster: float = 0.0  # m/s

    def options(self, args) -> HybridOptions:
        """Options of the hybrid in this condition."""
        tank = Flow(speed=args.speed + self.faster) if self.faster else None
        right = solver_of(args)
        water: dict[str, Any] = {"domain": right.domain, "slip": self.slip, "boundary": boundary_name(right.sharpness)}
        water |= {"device": args.device, "tank": tank}
        return HybridOptions(side_by_side=args.tanks or 1, wait=True, **water, **console.settings_of(args, HybridOptions))

    def engine(self) -> batch.BatchEngine:
        """Engine: MuJoCo with the body of the robot in the water of the chain."""
        inside = batch.BatchEngine(self.robot, threads=1)
        if self.chain != planar_chain.chain_of(self.robot):
            for shoal in inside.shoals:
                shoal.evaluate, shoal.look = batch.evaluator_of(self.robot, self.chain, "jax")
        return inside


def solver_of(args) -> SolverWater:
    """Water of the tanks: that of the correct water's segments; the conditions `slip` and `stream` change it."""
    return HybridOptions(domain=args.domain).solver(choice.in_water(load_robot(args.fish), args.model))


def condition(name: str, args) -> StudyCondition:
    """Condition by name."""
    plain = load_robot(args.fish)
    robot = choice.in_water(plain, args.model)
    chain, slip = planar_chain.chain_of(robot), solver_of(args).slip
    if name == "tail":
        wet = args.noslip or f"{choice.label(robot).removesuffix('.toml')}-noslip"
        return StudyCondition(name, choice.in_water(plain, wet), shorter_tail(robot), slip)
    if name == "added_mass":
        k = [*robot.water["k"][:-1], LESS * robot.water["k"][-1]]
        return StudyCondition(name, replace(robot, water={**robot.water, "k": k}), chain, slip)
    slip -= STICKS if name == "slip" else 0.0
    return StudyCondition(name, robot, chain, slip, faster=FASTER if name == "stream" else 0.0)


def shorter_tail(robot: Robot) -> planar_chain.Chain:
    """Chain of the robot in the water of a tail that is a tenth shorter."""
    tail = robot.links[-1]
    short = replace(tail, length=SHORTER * tail.length, sections=tuple((SHORTER * s, h, w) for s, h, w in tail.sections))
    strips = planar_chain.chain_of(robot, geometry_of(replace(robot, links=(*robot.links[:-1], short)))).strips
    return planar_chain.chain_of(robot)._replace(strips=strips)


# ---- the three swims ----


@dataclass(frozen=True, kw_only=True)
class TankTrials(Trials):
    """Trials in tanks whose mean stream is `faster` m/s faster than nominal, in the same eddies."""

    faster: float

    def flows(self) -> list[Flow]:
        """Background flow of each trial, with the faster mean."""
        flows = super().flows()
        more = [self.faster * flow.mean[None, :2] / flow.speed for flow in flows]
        still = np.zeros(1, int)
        return [DrawnFlow.of(shifted(flow.current(), by, still), flow) for flow, by in zip(flows, more, strict=True)]


def trials_of(args) -> Trials:
    """First standard trials at one speed: every direction once, then the next repeats."""
    repeats = 1 + (args.episodes - 1) // 8
    made = protocol.trials(speeds=(args.speed,), repeats=repeats, seed=args.seed, duration=args.seconds)
    return replace(made, items=tuple(sorted(made.items, key=lambda item: (item.repeat, item.los))[: args.episodes]))


def kept(one: StudyCondition, trials: Trials, args, right: dict | None) -> dict:
    """Results of a condition: those in --out if made with the same options, else new ones; compared with the control."""
    path = Path(args.out) / f"{one.name}.json"
    made = {"robot": repr(one.robot), "chain": repr(one.chain), "hybrid": repr(one.options(args)), "policy": args.policy}
    made |= {"trials": asdict(trials), "code": package_sha256()}
    made = {key: str(value) for key, value in made.items()}
    row = read_json(path) if path.is_file() else {}
    if row.get("made") != made:
        row = measured(one, trials, args) | {"made": made}
    row = judged(row, right)
    write_json(path, row)
    return row


def measured(one: StudyCondition, trials: Trials, args) -> dict:
    """Swims the trials in all three ways, and compares."""
    brain = control.chosen(args.policy, one.robot)
    hybrid = one.options(args)
    inside = one.engine()
    corrected = HybridEngine(one.robot, trials.flows()[0], hybrid, inner=inside, replay=Replay(one.robot, one.chain))
    total = args.seconds * len(trials)
    swims: dict[str, Result] = {}
    wall: dict[str, float] = {}
    for name, engine in (("alone", inside), ("hybrid", corrected)):
        began = time.perf_counter()
        with console.Progress(total, f"{one.name}: {name}", unit="sim s") as bar, _on_cpu():
            every = one.robot.timing.control_dt * len(trials)
            seen = lambda k: bar.update(k * every)  # noqa: B023  used at once
            swims[name] = run_trials.run(brain, one.robot, trials, engine, progress=seen)
        wall[name] = time.perf_counter() - began
    tanks = trials if not one.faster else TankTrials(**vars(trials), faster=one.faster)
    how: dict[str, Any] = {"water": corrected.hybrid.water, "device": args.device, "tanks": args.tanks}
    began = time.perf_counter()
    with console.Progress(total, f"{one.name}: solver", unit="sim s") as bar:
        seen = lambda k: bar.update(k * one.robot.timing.control_dt)  # noqa: B023  used at once
        asked = choice.in_water(load_robot(args.fish), args.model)  # the fish itself is the same in every condition
        swims["solver"] = run_trials.judge_in_solver(brain, asked, tanks, Path(args.out), progress=seen, **how)
    wall["solver"] = time.perf_counter() - began
    reports = [corrected.hybrid.report(i) for i in range(len(trials))]
    since = hybrid.first + hybrid.lead + hybrid.span
    found = compared({name: figures(swim, swims["solver"], since) for name, swim in swims.items()})
    share = max(report["solver_share"] for report in reports)
    real = {name: args.seconds * len(trials) / seconds for name, seconds in wall.items()}
    about = {"condition": one.name, "water": choice.label(one.robot), "policy": args.policy, "n": len(trials)}
    about |= {"options": repr(hybrid), "solver": solver_sha256(), "device": str(device_of(args.device))}
    return {**about, **found, "solver_share": share, "wall_s": wall, "times_real_time": real, "reports": reports}


def _on_cpu() -> contextlib.AbstractContextManager:
    """Context on the CPU: a dozen fish are too few for a GPU, which computes the tanks."""
    return jax.default_device(jax.local_devices(backend="cpu")[0])


# ---- results ----


def figures(swim: Result, solver: Result, since: float) -> dict[str, np.ndarray]:
    """RMSE (n,) m of the second half; speed m/s and place m from `since` s on; NaN if the solver stopped."""
    late, half = swim.t >= since, swim.t >= max(since, swim.t[-1] / 2)
    over_ground = [beat_mean(swim.velocity[..., i], swim.robot.timing.bus_dt)[:, late] for i in (0, 1)]
    apart = np.linalg.norm(swim.pose[..., :2] - solver.pose[..., :2], axis=-1)[:, late].mean(1)
    sound = np.where(solver.left < len(solver.t), np.nan, 1.0)
    rmse = np.sqrt((swim.distance[:, half] ** 2).mean(1))
    return {"rmse": sound * rmse, "speed": sound * np.hypot(*over_ground).mean(1), "place": sound * apart}


def compared(found: dict[str, dict[str, np.ndarray]]) -> dict:
    """Differences of both MuJoCo swims from the solver's, `off`, and their own values of place and RMSE, `same`."""
    rows: list[dict[str, Any]] = []
    same: list[dict[str, Any]] = []
    for name in ("rmse", "speed"):
        solver, alone, hybrid = (found[swim][name] for swim in ("solver", "alone", "hybrid"))
        before, after = difference(name, solver, alone), difference(name, solver, hybrid)
        both = (alone - solver)[np.isfinite(alone - solver)]
        error = float(np.std(both, ddof=1) / np.sqrt(len(both))) if len(both) > 1 else float("nan")
        row = {"figure": name, "solver": float(np.nanmean(solver)), "alone": before._asdict(), "hybrid": after._asdict()}
        rows.append(row | {"standard_error": error, "left": abs(after.value) / max(abs(before.value), 1e-12)})
    for name in ("rmse", "place"):
        one, two = (float(np.nanmean(found[swim][name])) for swim in ("alone", "hybrid"))
        same.append({"figure": name, "alone": one, "hybrid": two, "ratio": two / max(one, 1e-12)})
    return {"off": rows, "same": same}


def judged(row: dict, right: dict | None) -> dict:
    """Row of a condition with the verdict on its correction.

    Args:
        row: figures of a condition, as of `compared`. right: row of the control; None if this is the control.
    Returns:
        the row with "ok", "first_kind" (something is off), "no_worse"; each figure with "margin", "first_kind", "held", "target"
    """
    rows = []
    for one, usual in zip(row["off"], (right or row)["off"], strict=True):
        bounds = [abs(x) for key in ("value", "low", "high") if (x := usual["alone"][key]) is not None and np.isfinite(x)]
        margin, before, after = max(bounds, default=0.0), abs(one["alone"]["value"]), abs(one["hybrid"]["value"])
        first = right is not None and before > margin and before > FIRST_KIND * (one["standard_error"] or np.inf)
        sound = right is not None or before <= RIGHT[one["figure"]]
        held = sound and (after <= margin or (one["left"] < MUST if first else after <= WORSE * before))
        more = {"margin": margin, "first_kind": bool(first), "held": bool(held), "target": bool(first and one["left"] < TARGET)}
        rows.append(one | more)
    off, no_worse = any(one["first_kind"] for one in rows), all(one["ratio"] <= WORSE for one in row["same"])
    ok = all(one["held"] for one in rows) and (off or no_worse) and row["solver_share"] <= SHARE + 1e-9
    return {**row, "ok": ok, "first_kind": off, "no_worse": no_worse, "off": rows}


def print_condition(row: dict) -> None:
    """Prints the table of a condition."""
    between = lambda d: f"{d['value']:+.4f} " + (d["why"] or f"({d['low']:+.4f} {d['high']:+.4f})")
    lines = []
    for one in row["off"]:
        cells = (
            one["figure"],
            f"{one['solver']:.4f}",
            between(one["alone"]),
            between(one["hybrid"]),
            f"{one['margin']:.4f}",
            f"{100 * one['left']:.0f} %",
        )
        lines.append(dict(zip(SHOWN, (*cells, _said(one)), strict=True)))
    kind = "off without the correction" if row["first_kind"] else "not off without the correction"
    console.say("", f"{row['condition']}: {row['n']} trials, {row['policy']} in {row['water']}, {kind}", console.table(lines))
    for one in row["same"]:
        change = f"{100 * (one['ratio'] - 1):+.1f} %"
        console.say(f"{one['figure']}, mean: {one['alone']:.4f} m alone, {one['hybrid']:.4f} m corrected ({change})")
    moved = sum(any(s.get("moved") for s in report["segments"]) for report in row["reports"])
    times = ", ".join(f"{name} {times:.2g}" for name, times in row["times_real_time"].items())
    stream = np.mean([report["stream"] for report in row["reports"]], 0)
    console.say(
        f"moved in {moved} of {row['n']}, stream by {stream[0]:+.3f} {stream[1]:+.3f} m/s on average; times real time: {times}"
    )
    console.say(f"solver {100 * row['solver_share']:.1f} % of the time: {'holds' if row['ok'] else 'MISSED'}")


def _said(one: dict) -> str:
    if not one["first_kind"]:
        return "not asked" if one["held"] else "WORSE"
    left = "more than three quarters" if one["target"] else "more than half" if one["left"] < MUST else "as the right water"
    return left if one["held"] else "NO"
