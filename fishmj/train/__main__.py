"""`python -m fishmj.train`: learn to hold station."""

import argparse
import shutil
import textwrap
from dataclasses import replace
from pathlib import Path

from fishmj import console
from fishmj.errors import ConfigError, UnknownName

CRITICS = ("plain", "privileged")
EXAMPLES = """
examples
  fishmj train                                   a policy for your laptop in a minute or two
  fishmj train --preset paper --engine planar    the paper's network on a GPU
  fishmj train --preset paper-sac --seeds 0,1,2  the paper's algorithm and budget, three runs
  fishmj train --algo sac --steps 300000         soft actor-critic
  fishmj train --memory 8                        the policy sees its last eight observations
  fishmj train --resume --out runs/quick-0       go on after Ctrl-C
  fishmj evaluate runs/quick-0/best.safetensors  judge what came out
"""


def options() -> argparse.ArgumentParser:
    from fishmj.engines import NAMES
    from fishmj.flow import PRESETS as FLOWS
    from fishmj.mjcf.description import COMMAND_PATHS
    from fishmj.tasks.station_hold import GROUPS
    from fishmj.train.settings import ALGORITHMS, PRESETS

    one_of = lambda names: "{" + ",".join(names) + "}"  # noqa: E731  (checked later: then a slip gets the closest name)
    p = console.parser("train", "Learn to hold station in a current that the fish cannot sense.")
    p.formatter_class = argparse.RawDescriptionHelpFormatter
    p.epilog = textwrap.dedent(EXAMPLES)
    p.add_argument(
        "--preset", metavar=one_of(PRESETS), help="quick: CPU, paper: GPU, paper-sac: the paper's budget (default: by device)"
    )
    p.add_argument("--algo", metavar=one_of(ALGORITHMS), help="learning algorithm (default: the preset's)")
    p.add_argument("--engine", metavar=one_of(("auto", *NAMES)), help="auto: mjx on a GPU, compiled or planar on a CPU")
    p.add_argument("--steps", type=float, help="control steps of 0.2 s, all fish together")
    p.add_argument("--envs", type=int, help="fish that swim at once")
    p.add_argument("--seed", type=int, default=0, help="seed of the run (default 0)")
    p.add_argument("--seeds", help="several runs, for example 0,1,2")
    p.add_argument(
        "--together", action="store_true", help="train all --seeds side by side in one program (fast on a GPU; not resumable)"
    )
    p.add_argument("--memory", type=int, help="observations that the policy sees (default 1: memoryless, as the paper's)")
    p.add_argument("--critic", metavar=one_of(CRITICS), help="privileged: the critic sees the flow, the policy does not (PPO)")
    p.add_argument("--hidden", help="layer widths, for example 256,256")
    p.add_argument("--learning-rate", type=float)
    p.add_argument("--turbulence", metavar=one_of(FLOWS), help="turbulence to train in")
    p.add_argument("--intensity", type=float, help="largest turbulence intensity; each episode draws from 0 to it")
    p.add_argument(
        "--command-path", metavar=one_of(COMMAND_PATHS), help="how commands travel between policy steps (default linear)"
    )
    p.add_argument("--robot", help="fish, tendon_fish, or a TOML file")
    p.add_argument("--water", help="structured (default), surrogate, or the TOML of a fitted water")
    p.add_argument("--hide", help=f"observation groups set to zero, for ablations: {', '.join(GROUPS)}")
    p.add_argument(
        "--randomise-effects", metavar="NAME,..", help="effects of the catalogue drawn in typical sizes for each episode"
    )
    p.add_argument("--reward", nargs="*", default=[], metavar="KEY=VALUE", help="weights of the reward: wG, wD, wS")
    p.add_argument("--out", type=Path, help="folder of the run (default runs/<preset>-<seed>)")
    p.add_argument("--resume", action="store_true", help="go on from the newest checkpoint in --out")
    p.add_argument("--force", action="store_true", help="overwrite a run that is there")
    return p


def settings_from(args):
    """The preset with everything that was asked for on the command line. Raises ConfigError, UnknownName."""
    from fishmj.train.settings import REWARD, change, preset

    s = preset(args.preset or _by_device())
    algorithm, task, reward = {}, {}, {}
    top = {
        name: value for name in ("engine", "robot", "water", "seed", "command_path") if (value := getattr(args, name)) is not None
    }
    if args.algo and args.algo != s.algo:  # hyperparameters do not carry over from one algorithm to another
        s = replace(s, algo=args.algo, algorithm={"hidden": s.algorithm["hidden"]})
    if args.steps is not None:
        if not 1 <= args.steps < float("inf"):
            raise ConfigError(f"--steps {args.steps:g}: expected a number of control steps, 1 or more")
        top |= {"steps": int(args.steps), "assess_every": min(s.assess_every, max(1, int(args.steps) // 4))}
    if args.envs is not None:
        algorithm["envs"] = args.envs
    if args.learning_rate is not None:
        algorithm["learning_rate"] = args.learning_rate
    if args.hidden:
        algorithm["hidden"] = tuple(whole("--hidden", args.hidden))
    if args.critic:
        if args.critic not in CRITICS:
            raise UnknownName("critic", args.critic, CRITICS)
        algorithm["privileged"] = args.critic == "privileged"
    if args.memory is not None:
        task["memory"] = args.memory
    if args.turbulence:
        task["turbulence"] = args.turbulence
    if args.intensity is not None:
        task["intensity"] = (0.0, args.intensity)
    if args.hide:
        task["hide"] = tuple(args.hide.split(","))
    if args.randomise_effects:
        task["effects"] = tuple(args.randomise_effects.split(","))
    for item in args.reward:
        key, _, value = item.partition("=")
        try:
            reward[key] = float(value)
        except ValueError as error:
            raise ConfigError(f"--reward {item!r}: expected {'=, '.join(REWARD)}= and a number") from error
    return change(s, algorithm=algorithm, task=task, reward=reward, **top)


def whole(option: str, text: str) -> list[int]:
    """`0,1,2` as integers. Raises ConfigError."""
    try:
        return [int(v) for v in text.split(",")]
    except ValueError as error:
        raise ConfigError(f"{option} {text!r}: expected whole numbers with commas between them, for example 0,1,2") from error


def _by_device() -> str:
    import jax

    return "quick" if jax.default_backend() == "cpu" else "paper"


def _together(settings, seeds: list[int], args) -> list[dict]:
    from fishmj.errors import ConfigError
    from fishmj.train.together import train_together

    folder = args.out or Path("runs") / f"{settings.preset}-{settings.algo}"
    if args.resume:
        raise ConfigError("--together cannot resume; train the seeds one after another")
    if folder.exists() and not args.force:
        raise ConfigError(f"{folder} is there already; add --force to overwrite it, or choose another --out")
    shutil.rmtree(folder, ignore_errors=True)
    return train_together(settings, seeds, folder)


def main(argv: list[str] | None = None) -> int:
    args = options().parse_args(argv)
    from fishmj.train.settings import change

    settings = settings_from(args)
    seeds = whole("--seeds", args.seeds) if args.seeds else [settings.seed]
    results = []
    learner = None
    if args.together:
        results, seeds = _together(settings, seeds, args), []
    for seed in seeds:
        one = change(settings, seed=seed)
        folder = args.out or Path("runs") / f"{settings.preset}-{settings.algo}-{seed}"
        folder = folder / f"seed-{seed}" if args.out and len(seeds) > 1 else folder
        if args.force and folder.exists() and not args.resume:
            shutil.rmtree(folder)
        if one.algo == "sb3-sac":
            from fishmj.train.sb3 import train_sb3

            results.append(train_sb3(one, folder, resume=args.resume))
            if results[-1]["stopped"]:
                break
            continue
        from fishmj.train.run import Run, learner_of

        learner = learner or learner_of(one)
        results.append(Run(one, folder, resume=args.resume, learner=learner).go())
        if results[-1]["stopped"]:
            break
    for r in results:
        arrival, rmse = (r.get(f"tune_{k}", float("nan")) for k in ("arrival", "rmse_last10"))
        took = console.duration(r["seconds"])
        console.say(
            f"{r['algorithm']} seed {r['seed']}: {r['steps']:,} control steps in {took} on {r['engine']}; "
            f"tuning flows: arrival {arrival:.1%}, RMSE of the last 10 s {rmse:.3f} m",
            f"policy: {r['policy']}",
        )
    if args.json:
        console.emit_json({"runs": results})
    if results and results[-1]["stopped"]:
        from fishmj.train.run import go_on

        last = results[-1]
        more = "--together cannot go on" if args.together else go_on(last["folder"], last["steps"])
        console.warn(f"interrupted; {more}")
        return console.INTERRUPTED
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
