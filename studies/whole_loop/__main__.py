"""The whole loop on robots with 150 ms more latency and a horn that is 10 deg off: measure, search, patch, train, swim.

    python -m studies.whole_loop --seeds 10 --out runs/whole_loop
    python -m studies.whole_loop --only 0 --steps 5e5 --swims 4 --out runs/look           one robot, a shorter training

A robot is the second one with constants of its seed; horn and side follow from the seed by a rule (`steps.Fault.of`). Every step
is a command of its user: twelve experiments while it is healthy, and the calibration of its water to them. Then the fault sets
in: the same experiments again, `gap find` and `gap apply --counted-in`; a training in the patched model; eight swims of 30 s in a
stream of 0.2 m/s. Finished steps are kept: the same command continues.

    named        an effect counts if `gap find` answered NAMED with it
    counted in   fitted jointly, below the naming threshold; `gap apply --counted-in` also applies it
    zeros        the horn as the sum of the three zeros: swims show the bend of the body, but hardly the joint
    RMSE         of the true distance from the first entry into 0.1 m until the end; without arrival from 10 s on
    differences  by robot (the mean of its swims), with 95 % bootstrap intervals over robots
"""

from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait

from fishmj.base import console, cores
from fishmj.base.store import write_json
from studies.whole_loop import steps
from studies.whole_loop.robots import chain, row_of, summary
from studies.whole_loop.steps import ARMS, Loop


def walked(loop: Loop, seeds: list[int], jobs: int) -> None:
    """Takes every robot through all steps, `jobs` robots at once.

    Swims run in processes, and threads wait for commands: both are children of this process, which end with it.
    """
    todo = {seed: chain() for seed in seeds}
    waiting, total, done = list(seeds), sum(map(len, todo.values())), 0
    with (
        ProcessPoolExecutor(jobs) as swimming,
        ThreadPoolExecutor(jobs) as beside,
        console.Progress(total, "whole loop", "steps") as bar,
    ):
        under_way: dict[Future, int] = {}

        def begin(seed: int) -> None:
            step = todo[seed].pop(0)
            under_way[(swimming if step.lockstep else beside).submit(step.do, loop, seed)] = seed

        while under_way or waiting:
            while waiting and len(under_way) < jobs:
                begin(waiting.pop(0))
            finished, _ = wait(under_way, return_when=FIRST_COMPLETED)
            for future in finished:
                seed = under_way.pop(future)
                future.result()
                done += 1
                bar.update(done, robot=seed)
                if todo[seed]:
                    begin(seed)


def main(argv: list[str]) -> int:
    """Runs the study. Exit code 0: every robot finished all steps."""
    parser = console.parser("studies.whole_loop", __doc__ or "")
    add = parser.add_argument
    add("--seeds", type=console.whole(1, 1000), default=10, metavar="N", help="robots, of seeds 0 to N - 1 (default 10)")
    add("--only", type=console.Listed(console.SEED), metavar="SEED,..", help="these robots in their place (default: all)")
    add("--policy", type=console.text, default="station", help="that swims before the fault is known (default station)")
    experiments = f"of deploy experiment, once each (default {' '.join(steps.EXPERIMENTS)})"
    add("--experiments", type=console.text, nargs="+", default=list(steps.EXPERIMENTS), metavar="NAME", help=experiments)
    add("--null-runs", type=console.whole(8, 1000), default=96, metavar="N", help="of gap find (default 96)")
    add("--preset", type=console.text, default="quick", help="of the trainings (default quick)")
    add("--engine", type=console.text, default="auto", help="of the trainings: planar is quick on a GPU (default auto)")
    add("--steps", type=console.number(1, 1e10), default=2e6, metavar="N", help="control steps of each training (default 2e6)")
    add("--swims", type=console.whole(1, 72), default=8, help="of each arm (default 8)")
    add("--seconds", type=console.number(1, 60), default=steps.SECONDS, help=f"of a swim (default {steps.SECONDS:g})")
    add("--jobs", type=console.whole(0, 256), default=0, metavar="N", help="robots at once; 0: one a core (default 0)")
    add("--out", type=console.out_folder, required=True, help="folder; the same command goes on where it stopped")
    args = parser.parse_args(argv)
    loop = Loop(
        out=args.out, policy=args.policy, experiments=tuple(args.experiments), null_runs=args.null_runs, preset=args.preset,
        engine=args.engine, steps=int(args.steps), swims=args.swims, seconds=args.seconds,
    )  # fmt: skip
    seeds = args.only or list(range(args.seeds))
    args.out.mkdir(parents=True, exist_ok=True)
    walked(loop, seeds, args.jobs or cores.usable_cores())
    rows = [row_of(loop, seed) for seed in seeds]
    told = summary(rows)
    write_json(args.out / "whole_loop.json", {"robots": rows, "summary": told})
    shown = (
        "seed",
        "horn",
        "angle_deg",
        "answer",
        "named",
        "counted_in",
        "delay_ms",
        "zeros_deg",
        *(f"rmse_{arm}" for arm in ARMS),
    )
    words = [{key: ", ".join(row[key]) or "none" for key in ("named", "counted_in")} for row in rows]
    console.say(console.table([row | said for row, said in zip(rows, words, strict=True)], shown))
    counts = f"both named {told['both']}, one {told['one']}, none {told['none']} of {told['robots']}"
    console.say(f"{counts}; both fitted {told['both_fitted']}, another one named {told['others_named']}")
    if told["patched"]:
        for name in ("after_less_before", "after_less_unpatched", "after_less_healthy"):
            value, low, high = told[name]
            interval = f" ({low:+.4f} to {high:+.4f})" if low == low else ""  # none of fewer than five robots
            console.say(f"{name.replace('_', ' ')}: {value:+.4f}{interval} m, {told['patched']} robots")
    if args.json:
        console.emit_json({"robots": rows, "summary": told})
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
