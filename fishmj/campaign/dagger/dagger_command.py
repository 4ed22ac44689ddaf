"""The verb `correct`: rounds of a policy in the surrogate and in the flow solver, the surrogate fitted again after each.

python -m fishmj.hydro_fit correct paper --domain window_coarse --device cuda --out runs/correct

Nothing is written outside --out: the data set of the first fit is read, the rounds' segments have one of their own.
"""

from dataclasses import replace
from math import ceil
from pathlib import Path

from fishmj import console, controllers, interrupt
from fishmj.campaign.dagger.dagger import correct
from fishmj.campaign.data.collect import Local
from fishmj.campaign.data.collect_command import ON_GPU
from fishmj.campaign.data.run_segments import Setup
from fishmj.hydro_fit.segment_dataset import SEGMENTS, SegmentDataset, open_dataset
from fishmj.lbm_oracle.fluid.device import device_of
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import NAMES, preset
from fishmj.mjcf.description import Robot, load_robot
from fishmj.water.hydro_model import HydroModel

SWIMS = 600.0  # s of swims in a fit


def main(argv: list[str]) -> int:
    """Exit code 1 where the returns do not agree after the last round."""
    parser = console.parser("hydro_fit correct", "Correct a surrogate where a policy takes it.")
    add = parser.add_argument
    add("policy", type=console.text, metavar="POLICY", help="name of a controller or a policy file")
    add("--fish", type=console.text, default="fish", help="a shipped name or a description (.toml)")
    add("--model", type=console.text, default="swift", help="the surrogate to begin with: name or .toml")
    add("--data", type=console.path, help="data set that it was fitted to; default data/hydro/<robot>; it is read only")
    place = "folder of the rounds and of the corrected model; goes on with what is there"
    add("--out", type=console.out_folder, default="runs/correct", help=place)
    add("--rounds", type=console.whole(1, 100), default=4, help="at most; it ends when the returns agree")
    add("--episodes", type=console.whole(1, 1000), default=6, help="of each round")
    add("--seconds", type=console.number(2, 600), default=20.0, help="of each episode")
    add("--domain", choices=NAMES, default="window", help="box of water; laptop is a preview")
    add("--device", type=console.device, default="auto", help="auto, cpu, cuda or cuda:N")
    args = parser.parse_args(argv)
    robot, out, began = load_robot(args.fish), Path(args.out), HydroModel.load(args.model)
    controllers.make(args.policy, robot)  # a wrong name fails before anything else is looked at
    first = open_dataset(args.data or Path("data") / "hydro" / robot.name)
    if (grid := {meta["grid"]["domain"] for meta in first.about.values()}) != {args.domain}:
        console.warn(
            f"{first.folder} was solved in {', '.join(sorted(grid))}, the rounds in {args.domain}: two waters in one fit"
        )

    box, water = preset(args.domain), args.rounds * args.episodes * args.seconds
    less = "take fewer --rounds and --episodes; --domain laptop is a preview"
    solver_cost.agree("hydro_fit correct", args.device, [(box, water)], instead=less)
    setup = Setup(robot=robot, domain=box, device=str(device_of(args.device)))
    sized = {"rounds": args.rounds, "episodes": args.episodes, "seconds": args.seconds}
    pool = Local(ON_GPU if setup.device.startswith("cuda") else 1)
    refit = lambda model, solver: refitted(robot, model, first, solver, out)
    with interrupt.keeping(lambda: kept_words(out)):
        found = correct(args.policy, robot, began, out, setup, refit=refit, pool=pool, **sized)
    path = found["model"].save(out)
    console.say(console.table(found["rounds"]), f"model: {path}")
    if args.json:
        console.emit_json({"rounds": found["rounds"], "agreed": found["agreed"], "model": str(path)})
    return console.OK if found["agreed"] else console.FAILED_CHECK


def kept_words(out: Path) -> str:
    """What an interrupted correction says."""
    rounds, swims = (len(list(out.glob(kind))) for kind in ("round-*.json", f"solver/{SEGMENTS}/*.json"))
    return f"{out} holds {rounds} finished rounds and {swims} segments of the solver; {interrupt.again()}"


def refitted(robot: Robot, model: HydroModel, first: SegmentDataset, solver: Path, out: Path) -> HydroModel:
    """Taught again by the free swims of all rounds and, thinned to `SWIMS` s, of the first data set.

    Args:
        out: folder of the rounds; finished stages of the fit are kept there.
    """
    from fishmj.hydro_fit.fit.descent import several
    from fishmj.hydro_fit.fit.gauss_newton import flaps
    from fishmj.hydro_fit.fit.incremental import Refit
    from fishmj.hydro_fit.fit.rollout import is_free

    several()
    keep = lambda r: not r.meta.get("replicate_of") and (is_free(r) or flaps(r))
    of = lambda data, split: [r for r in data.records(split, slip=model.slip) if keep(r)]
    added = open_dataset(solver)
    new, old = ({split: of(data, split) for split in ("train", "val")} for data in (added, first))
    room = max(SWIMS - sum(r.seconds for r in new["train"]), SWIMS / 3)
    every = max(1, ceil(sum(r.seconds for r in old["train"]) / room))
    made = {"sha256": added.sha256, "folder": solver.name, "first": first.sha256, "origin": "synthetic"}
    again = Refit(robot, model, new["train"] + old["train"][::every], (old["val"], new["val"]), dataset=made, folder=out / "fit")

    def words() -> str:
        again.loop.save()  # the stage that is under way
        return kept_words(out)

    with interrupt.keeping(words):
        return replace(again.run(), name=model.name)
