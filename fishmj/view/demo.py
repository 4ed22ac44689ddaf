"""Train a fish from scratch, judge it in 24 currents, write a replay and a report: the first ten minutes."""

import os
import shlex
import time
from pathlib import Path
from typing import Any

from fishmj.base import console, interrupt
from fishmj.control.policy import BEST

SPEED, INTENSITY = 0.2, 0.10  # m/s at which holding is judged; gusts as a fraction of the flow
ARRIVALS, HOLDING = 20, 0.10  # of 24 trials, where ENOUGH lets two be lost; m, median
OTHER_WATER = "swift-reference"  # fitted to finer cells and a less slippery hull
TRAINING = {"steps": 2_500_000, "assess_every": 250_000, "assess_episodes": 128, "algorithm": {"envs": 256}}
ENOUGH = 0.92  # share of episodes on the tuning flows that hold within 0.1 m (RMS over the last 10 s): training stops there
TIMED = 4  # iterations of training that measure the machine
USUAL, JUDGING = 0.6, 300_000  # share of the steps after which the fish holds; control steps that take as long as the judging
SMOKE = {"steps": 150_000, "assess_every": 150_000, "assess_episodes": 32}  # runs every part, learns next to nothing
ABOUT = """The policy sees 11 numbers in its own frame and never the current. It trains in gusts until it holds its place on
flows that training does not see, and is judged on MuJoCo in 24 trials of 60 s: three flow speeds, eight directions,
10 % gusts, randomised robot, noise, latencies. The same trials in another water, in which the fish is slower, show what
a policy trained in one water loses, and that of the shipped policy for unknown waters. The demo measures this machine
first and says how long it will take.
Exit 1: fewer than 20 of 24 trials arrive, or their median at 0.2 m/s is worse than 0.10 m.

example:
  fishmj demo --out runs/demo"""
FINISHED = "demo.json"  # in --out: what a finished demo found


def options() -> console.Parser:
    """The arguments of `demo`."""
    p = console.parser("demo", "Train station holding from scratch, judge it, watch it.", examples=ABOUT)
    out = "folder for everything; a finished demo in it is replaced, an interrupted one goes on"
    p.add_argument("--out", type=console.out_folder, default="runs/demo", help=out)
    p.add_argument("--seed", type=console.whole(0, 2**32 - 1), default=0, help="of the training")
    p.add_argument("--open", action="store_true", help="open the replay in the browser at the end")
    p.add_argument("--smoke", action="store_true", help="every part in short; the policy will not be good and is not checked")
    return p


def learn(args) -> dict:
    """Trains into <out>/training until the fish holds its station.

    An interrupted demo goes on there, a finished one begins anew.
    """
    import shutil

    os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=1")  # compiles in 3/4 of the time, swims as fast
    from fishmj.base import store
    from fishmj.train.build import settled, water_for
    from fishmj.train.settings import as_dict, change, preset
    from fishmj.train.training_run import TrainingRun, learner_of

    folder = args.out / "training"
    settings = settled(change(preset("quick"), seed=args.seed, **(TRAINING | (SMOKE if args.smoke else {}))))
    console.say(f"water: {water_for(settings).said}")
    kept = None if (args.out / FINISHED).exists() else store.Checkpoints(folder / "checkpoints").latest()
    same = kept is not None and kept.meta["settings"] == store.plain(as_dict(settings))
    if not same:
        shutil.rmtree(folder, ignore_errors=True)
        (args.out / FINISHED).unlink(missing_ok=True)
    else:
        console.say(f"going on with the training in {folder}")
    learner = learner_of(settings)
    left = settings.steps - (kept.step if kept is not None and same else 0)
    console.say(plan(steps_per_second(learner), left))
    return TrainingRun(settings, folder, resume=same, learner=learner, stop_when=holds).go()


def holds(figures: dict) -> bool:
    """True where an assessment on the tuning flows is good enough to stop."""
    return figures["within"] >= ENOUGH


def steps_per_second(learner) -> float:
    """Control steps a second that this machine trains, measured on a training that is thrown away."""
    import jax

    _, algorithm, _ = learner
    with console.Progress(TIMED + 1, "measure this machine", "iterations") as bar:
        bar.stage("compiling the fish and the networks")
        training = algorithm.init(jax.random.key(0))
        training, _ = jax.block_until_ready(algorithm.iterate(training))  # compiles
        bar.update(1)
        began = time.monotonic()
        for k in range(TIMED):
            training, _ = jax.block_until_ready(algorithm.iterate(training))
            bar.update(k + 2)
    return TIMED * algorithm.steps_per_iteration / (time.monotonic() - began)


def plan(rate: float, left: int) -> str:
    """Sentence with the expected duration of the demo.

    rate: control steps of training per second. left: control steps of training, at most.
    """
    usual, most = (console.duration((share * left + JUDGING) / rate) for share in (USUAL, 1.0))
    return f"this machine trains {rate:,.0f} control steps/s: about {usual} to go, {most} if the fish is slow to hold"


def judge(args, policy: str, water: str | None = None):
    """Runs the 24 trials on batched MuJoCo (smoke: two), in the fitted water or in another."""
    from fishmj import control
    from fishmj.evaluate import run, trials
    from fishmj.mjcf import load_robot
    from fishmj.water.choice import in_water

    robot = in_water(load_robot("fish"), water)
    brain = control.make(policy, robot)
    brain.name = brain.name if policy in control.shipped_policies() else "just trained"
    subset: dict[str, Any] = {"speeds": [SPEED], "los_deg": [0, 180], "duration": 60.0} if args.smoke else {}
    plan = trials(repeats=1, turbulence="gust", intensity=INTENSITY, **subset)
    total = plan.duration * len(plan)
    with console.Progress(total, f"judge {brain.name}{f' in {water}' if water else ''}", "sim s") as bar:
        bar.stage("compiling the engine batch")
        step = robot.timing.control_dt * len(plan)
        return run(brain, robot, plan, "batch", progress=lambda k: bar.update(k * step))


def show(args, result) -> dict:
    """Writes the report with pictures, and the replay of one trial against the stream."""
    from fishmj.evaluate import summary
    from fishmj.evaluate.trial_logs import trial_of
    from fishmj.evaluate.trial_report import condition, write
    from fishmj.log import write_trial
    from fishmj.view.replay import write_html

    found = {"condition": condition(result), "results": [summary(result)], "paired": []}
    part = ["--speeds", f"{SPEED:g}", "--los", "0,180"] if args.smoke else []
    gusts = ["--turbulence", "gust", "--intensity", f"{INTENSITY:g}", "--repeats", "1", *part]
    files = ["--out", str(args.out / "report"), "--plots", "--log"]
    again = shlex.join(["fishmj", "evaluate", str(args.out / "training"), *gusts, *files])
    report = write(args.out / "report", [result], found, plots=True, again=again)
    index = next(i for i, t in enumerate(result.trials.items) if t.speed == SPEED)
    trial = trial_of(result, index)
    write_trial(args.out / "trial", trial, overwrite=True)
    title = "fishmj demo: 0.2 m/s, gusts of 10 %, target straight upstream"
    page = write_html([trial], args.out / "replay.html", result.robot, title)
    return {"report": str(report), "replay": str(page), **verdict(result)}


def verdict(result) -> dict:
    """Headline figures: trials, arrivals, and the median RMSE (m) at one speed, in which a lost fish is infinite."""
    import numpy as np

    from fishmj.evaluate import figures

    found = figures(result)
    at_speed = result.trials.speed == SPEED
    return {
        "trials": len(result.trials),
        "arrivals": int(found["arrival"].sum()),
        "rmse_last20": float(np.median(np.nan_to_num(found["rmse_last20"][at_speed], nan=np.inf))),
    }


def elsewhere(found: dict) -> str:
    """Words for the headline figures of the trained and the shipped policy in the other water."""
    said = lambda v: f"{v['arrivals']} of {v['trials']} trials, {v['rmse_last20']:.3f} m"
    trained, shipped = found.values()
    return f"{said(trained)}; the shipped {BEST}: {said(shipped)}"


def shown(page: Path) -> None:
    """Opens a page in the user's browser; without one, prints that."""
    import webbrowser

    address = page.resolve().as_uri()
    if not webbrowser.open(address):
        console.warn(f"no browser could be opened here; open {address} yourself")


def main(argv: list[str]) -> int:
    """Trains, evaluates and shows a fish: the verb `demo`. Returns the exit code."""
    from fishmj.base import store

    args = options().parse_args(argv)
    training = learn(args)
    more = f"{args.out / 'training'} holds the training; {interrupt.again()}"
    if training["stopped"]:
        console.warn(f"interrupted; {more}")
        return console.INTERRUPTED
    with interrupt.keeping(lambda: more):
        found = {"training": training, **show(args, judge(args, training["policy"]))}
        found["other_water"] = {policy: verdict(judge(args, policy, OTHER_WATER)) for policy in (training["policy"], BEST)}
        store.write_json(args.out / FINISHED, found)
    console.say(
        f"trained {training['steps']:,} control steps in {console.duration(training['seconds'])}",
        f"arrived in {found['arrivals']} of {found['trials']} trials",
        f"holds within {found['rmse_last20']:.3f} m (RMS, 40 to 60 s, median at {SPEED} m/s)",
        f"in another water, {OTHER_WATER}: {elsewhere(found['other_water'])}",
        f"report: {found['report']}",
        f"replay: {found['replay']}" + ("" if args.open else "  (a page: open it in a browser, or add --open)"),
    )
    if args.open:
        shown(Path(found["replay"]))
    good = args.smoke or (found["arrivals"] >= ARRIVALS and found["rmse_last20"] <= HOLDING)
    if args.json:
        console.emit_json({**found, "passed": good})
    return console.OK if good else console.FAILED_CHECK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
