"""Refit a fish's water to the flow solver: collect what is missing, fit, check on held-out episodes, report."""

import shlex
from dataclasses import replace
from functools import partial
from pathlib import Path

from fishmj.base import console, interrupt
from fishmj.base.calib import OWN, ROOTS
from fishmj.base.console import Command
from fishmj.base.errors import ConfigError, DatasetError, FishmjError, StoreError
from fishmj.base.store import sha256
from fishmj.base.store.manifest import MANIFEST, SOURCES
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.hydro_fit.segment_dataset import PREVIEW, SPLIT, SegmentDataset, open_dataset, open_each, same_fish
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.water.hydro_model import FOLDERS, HydroModel, robot_hash

DATA = OWN / "hydro"
SHIPPED = tuple(root / "hydro" / name for name in ("swift", "tendon_fish") for root in ROOTS)  # the default fish, the second one
FEWEST = 4  # free swims that a fit needs at least
GAITS = ("gait", "straight", "turning")  # blocks by which a check tells speed and turning
FRESH = "-fresh"  # of a data set's name: more test episodes, solved when the model had been made


def run(verb: str, argv: list[str]) -> int | None:
    """Runs one of all, fit, calibrate, check, report."""
    made = options(verb)
    args = made.parse_args(argv)
    needs: dict = {
        "fit or all": (verb in ("fit", "all"), ("name", "seed")),
        "all, calibrate, check or report": (verb != "fit", ("model", "prior")),
        "a fitted water, not --prior": (not args.prior, ("model", "base")),
    }
    console.refuse_unheeded(f"hydro_fit {verb}", args, made, needs)
    robot = load_robot(args.fish)
    code = console.OK
    folder = gathered(robot, args) if verb == "all" else data_of(robot, args)
    found: dict = {"data": str(folder)} if verb == "all" else {}
    if verb in ("fit", "all"):
        found["fit"] = fit(robot, folder, args)
    if verb == "all":
        args.model = args.model or found["fit"]["place"]
    if verb == "calibrate":
        found["calibrate"] = calibrate(robot, folder, args)
    if verb in ("check", "all"):
        found["check"] = check(robot, folder, args)
        code = console.OK if found["check"]["ok"] or found["check"]["preview"] else console.FAILED_CHECK
    if verb in ("report", "all"):
        found["report"] = str(report(robot, folder, args))
        console.say(f"report: {found['report']}")
    if args.json:
        console.emit_json(found[verb] if verb in found and isinstance(found[verb], dict) else found)
    return code


def gathered(robot: Robot, args) -> Path:
    """Data set for the bare verb: at hand, or solved first; refused before the fit if it is too small.

    Raises DatasetError: no data to check the fit; ConfigError: as `default_dataset.segments_at_hand`.
    """
    from fishmj.hydro_fit.campaign.data.default_dataset import Request, segments_at_hand

    out, place = Path(args.out or FOLDERS[0]), args.data and Path(args.data)
    for folder in (out, place or DATA):  # hours may lie between now and the first file
        console.out_folder(str(folder))
    begun = (DATA / robot.name / SPLIT).is_file()
    if place is None and not begun and (there := shipped_of(robot)) and there.whole:
        place = there.folder
    standing = standing_model(out, args.name or robot.name, robot_hash(robot))
    grid = "" if standing is None or standing[0].preview else str(standing[0].dataset.get("grid", ""))
    given = {"device": args.device, "ray": args.ray or "", "budget": args.budget, "quiet": args.json}
    given |= {} if args.slip is None else {"slip": args.slip}
    data = open_dataset(segments_at_hand(Request(robot=robot, home=DATA, folder=place, grid=grid, **given)))
    if lost := [meta["block"] for meta in data.about.values() if "file" not in meta]:
        blocks = ", ".join(sorted(set(lost)))
        console.say(
            f"{len(lost)} of {len(data.about)} segments ({blocks}) are lost (the solver stopped); the fit does without them"
        )
    slip = slip_of(data, args.slip)
    if not any(
        meta["split"] == "test" and meta["block"] in GAITS and "file" in meta and abs(meta["grid"]["slip"] - slip) < 1e-9
        for meta in data.about.values()
    ):
        raise DatasetError(
            f"{data.folder}: no test swim of a gait at slip {slip:g} to check a fit by; {_more(data)}, or fit without a check:"
            " fishmj hydro_fit fit"
        )
    return data.folder


def data_of(robot: Robot, args) -> Path:
    """Data set of the option, else the fish's own, the shipped one if it is of this fish, the fish's preview."""
    own = DATA / robot.name
    if args.data or (own / MANIFEST).is_file():
        return Path(args.data or own)
    if there := shipped_of(robot):
        console.say(f"no data set in {own}: using the shipped {there.folder}")
        return there.folder
    preview = DATA / f"{robot.name}{PREVIEW}"
    return preview if (preview / MANIFEST).is_file() else own


def shipped_of(robot: Robot) -> SegmentDataset | None:
    """The shipped data set of this fish, if there is one."""
    there = (open_dataset(path) for path in SHIPPED if (path / MANIFEST).is_file())
    return next((data for data in there if data.robot["name"] == robot.name), None)


def options(verb: str) -> console.Parser:
    """Parser of a command."""
    made = console.parser(f"hydro_fit {verb}", COMMANDS[verb].summary[:1].upper() + COMMANDS[verb].summary[1:] + ".")
    add = made.add_argument
    add("--fish", type=console.text, default="fish", help="a shipped name or a description (.toml)")
    data = "data set; default data/hydro/<robot> (to judge: and <robot>-fresh beside it), else the shipped one"
    add("--data", type=console.path, help=data)
    add("--model", type=console.text, help="name or .toml of the water that is checked; default data/water/<robot>.toml")
    add("--out", type=console.out_folder, help=f"folder of what is written: {WRITTEN[verb]}")
    add("--name", type=console.name, help="of the model that is fitted; default the robot's")
    slip = "slip ratio of the records: 1 slides, 0 sticks; default that of the data, of several the model's, else 1"
    add("--slip", type=console.number(0, 1), help=slip)
    add("--seed", type=console.SEED, default=0, help="of the draws of the fit")
    add("--base", action="store_true", help="the strip model alone, without the learnt residual")
    add("--prior", action="store_true", help="check, report: the description's own coefficients, nothing fitted")
    if verb == "fit":
        also = "further data sets in the same water, such as rounds of hydro_fit correct (OUT/solver); default none"
        add("--also", type=console.path, nargs="+", default=[], metavar="FOLDER", help=also)
        add(
            "--residual",
            type=console.text,
            metavar="NAME",
            help="keep the learnt residual of this water; fit its share and the strips; default: fit a residual",
        )
    if verb in ("fit", "all"):
        swims = console.whole(0, 100_000)
        add("--swims", type=swims, help="steps of learning by swims, 1000 by default; 0 learns from forces alone")
    if verb == "all":
        place = "of the flow solver: auto, cpu, cuda, cuda:N, cuda:all or a list of them; default auto"
        add("--device", type=console.devices, default="auto", help=place)
        budget = "wall clock for collecting; default as long as it takes, on a CPU 30 minutes; a larger one, a larger preview"
        add("--budget", type=console.number(0, 1e7), metavar="S", help=budget)
        add("--ray", type=console.text, help="address of a Ray cluster that collects; by default this machine does")
    return made


def slip_of(data: SegmentDataset, asked: float | None, model: HydroModel | None = None) -> float:
    """Slip ratio of the option, else the only one of the data, else that of the model if the data have it, else 1."""
    there = {float(meta["grid"]["slip"]) for meta in data.about.values()}
    if asked is not None:
        return asked
    if len(there) == 1:
        return there.pop()
    return model.slip if model is not None and model.slip in there else 1.0


def records_of(data: SegmentDataset, robot: Robot, split: str, slip: float) -> list[SegmentRecord]:
    """Records of one part at one slip ratio, without repeats.

    Raises ConfigError: the data are of another robot or body, or the part is empty.
    """
    about = data.robot
    if (about["name"], about["joints"]) != (robot.name, robot.n_joints):
        raise ConfigError(
            f"{data.folder}: data of robot {about['name']!r} with {about['joints']} joints, got {robot.name!r} with"
            f" {robot.n_joints}; collect for this fish, or give --data"
        )
    same_fish(about, robot, data.folder)
    found = [r for r in data.records(split, slip=slip) if not r.meta.get("replicate_of")]
    if not found:
        slips = sorted({meta["grid"]["slip"] for meta in data.about.values()})
        raise ConfigError(f"{data.folder}: no {split} records at slip {slip:g}; slips there: {slips}")
    return found


def fitted_parts(data: SegmentDataset, robot: Robot, slip: float) -> tuple[list[SegmentRecord], list[SegmentRecord]]:
    """Training and validation records at one slip ratio; if none validate there, every fifth training record does.

    Raises DatasetError: fewer than `FEWEST` free swims to fit, or none to validate: a fit would be meaningless.
    """
    from fishmj.hydro_fit.fit.rollout import SHORTEST, is_free

    train = records_of(data, robot, "train", slip)
    if data.names("val", slip=slip):
        val = records_of(data, robot, "val", slip)
    else:
        train, val = [r for k, r in enumerate(train) if k % 5 != 2], train[2::5]
    swims = [sum(is_free(r) and r.seconds >= SHORTEST for r in part) for part in (train, val)]
    if swims[0] < FEWEST or not swims[1]:
        raise DatasetError(
            f"{data.folder}: {swims[0]} free swims of {SHORTEST:g} s or more to fit and {swims[1]} to validate at slip {slip:g};"
            f" expected {FEWEST} and 1 at least; {_more(data)}"
        )
    return train, val


def further_parts(data: SegmentDataset, robot: Robot, slip: float, grid: dict) -> tuple[list[SegmentRecord], list[SegmentRecord]]:
    """Training and validation records of a data set that is fitted beside the first, whose `grid` it must have.

    Raises ConfigError: as `records_of`, or solved in another box or boundary, which would be two waters in one fit.
    """
    train = records_of(data, robot, "train", slip)
    if told := data.other_water(grid):
        raise ConfigError(f"fit --also: {told}; name data sets of the same water")
    return train, records_of(data, robot, "val", slip) if data.names("val", slip=slip) else []


def _more(data: SegmentDataset) -> str:
    """Hint on how to enlarge a data set that is too small."""
    if missing := data.meta.get("missing", 0):
        return f"{missing} segments of its plan are missing: the bare fishmj hydro_fit goes on with them"
    return "solve more segments: fishmj hydro_fit collect"


def promote(model: HydroModel, folder: Path, *, score: float, standing: float | None) -> tuple[Path, bool]:
    """Writes `model` to `folder`, or beside it as `rejected-<hash>` if the existing model is better on the same validation.

    Args:
        score, standing: squared error of the validation swims of the new and of the existing model; None if there is none.
    Returns:
        (path of the TOML, True if the model replaced the existing one).
    """
    if standing is None or score <= standing:
        return model.save(folder), True
    rejected = Path(folder) / "rejected"
    path = model.save(rejected)
    mark = sha256(path)[:12]
    place = Path(folder) / f"rejected-{mark}"
    if place.exists():
        raise FishmjError(f"{place}: this candidate was rejected before; change data, seed or settings, or remove the folder")
    rejected.rename(place)
    console.warn(
        f"the standing model is better: validation {standing:.4g} against {score:.4g}; it stays, the candidate is {place}"
    )
    return place / path.name, False


def standing_model(folder: Path, name: str, robot_sha256: str) -> tuple[HydroModel, Path] | None:
    """Existing model of this name with its path, if it is for the same robot and of the present form, else None.

    In the default place the shipped model counts if there is no other.
    """
    places = FOLDERS if Path(folder) == FOLDERS[0] else (folder,)
    path = next((path for place in places if (path := Path(place) / f"{name}.toml").is_file()), None)
    if path is None:
        return None
    try:
        model = HydroModel.load(path)
    except (ConfigError, StoreError) as error:
        console.warn(f"what stands in the place cannot be compared and will be replaced: {error}")
        return None
    return (model, path) if model.robot_sha256 == robot_sha256 else None


def fit(robot: Robot, folder: Path, args) -> dict:
    """Fits, and puts the model in its place if it is not worse than the existing one.

    A preview never replaces a complete model: it is named `<name>-preview`.
    """
    from fishmj.hydro_fit.fit.fit_pipeline import FitPipeline, FitSettings
    from fishmj.hydro_fit.fit.training_loop import use_cores_as_devices
    from fishmj.water.prior import flat

    use_cores_as_devices()
    data, out = open_dataset(folder), Path(args.out or FOLDERS[0])
    slip = slip_of(data, args.slip)
    train, val = fitted_parts(data, robot, slip)
    solved = train[0].meta["grid"]
    about = {"sha256": data.sha256, "folder": folder.name, "origin": "synthetic", "grid": solved.get("domain", "")}
    if "boundary" in solved:  # as in segments: not for the plain one
        about["boundary"] = solved["boundary"]
    for further in open_each([folder, *getattr(args, "also", [])])[1:]:
        more = further_parts(further, robot, slip, solved)
        train, val = train + more[0], val + more[1]
        about["also"] = about.get("also", []) + [further.sha256]
    console.say(f"{len(train)} records to fit, {sum(r.seconds for r in train):.0f} s of water; {len(val)} to validate")
    with console.Progress(1.0, f"fit {robot.name}") as bar:

        def told(stage: str, share: float, figures: dict) -> None:
            if figures:
                bar.update(share, stage=stage, **figures)
            else:
                bar.stage(f"{stage}, compiling")

        work = Path("runs") / "hydro_fit" / f"{folder.name}-{robot.name}-{slip:g}"
        taught = {} if args.swims is None else {"swims": args.swims}
        given = HydroModel.load(args.residual).learnt if getattr(args, "residual", None) else None
        settings = FitSettings(seed=args.seed, residual=not args.base, **taught)
        done = FitPipeline(robot, train, val, dataset=about, settings=settings, folder=work, report=told, given=given)
        with interrupt.keeping(done.kept_so_far):
            model = replace(done.run(), name=args.name or robot.name, preview=data.preview)
    found = ((name, row) for name, stage in model.found.items() for row in stage["parameters"].values())
    for stage, row in found:
        if row["status"] != "identified":
            trade = f"; it trades with {row['partner']} ({row['correlation']:+.2f})" if row["partner"] else ""
            console.say(f"stage {stage}: {row['name']} = {row['value']:.3g} is {row['status']}{trade}: not quoted as calibrated")
    standing = standing_model(out, model.name, robot_hash(robot))
    if model.preview and standing is not None and not standing[0].preview:
        model = replace(model, name=f"{model.name}{PREVIEW}")
        console.say(f"{standing[1]} was fitted to a whole plan and stays; the preview is {model.name}")
        standing = standing_model(out, model.name, robot_hash(robot))
    if standing is not None and standing[0].preview and not model.preview:
        console.say(f"{standing[1]} is a preview and is replaced")
        standing = None
    old = None if standing is None else done.score(flat(standing[0].base), standing[0].learnt)
    new = model.scores["validation"]
    path, taken = promote(model, out, score=new, standing=old)
    console.say(f"{path}: validation {new:.4g} squared tolerances" + ("" if old is None else f", standing model {old:.4g}"))
    place = path if standing is None or taken else standing[1]
    if taken and path.parent.resolve() not in [folder.resolve() for folder in FOLDERS]:
        console.say(f"swim in it with --water {shlex.quote(str(path))}, in play, train and evaluate")
    row = {"model": str(path), "taken": taken, "place": str(place), "preview": model.preview, "validation": new, "standing": old}
    return row | {"fastest": fastest_gait(robot, path), "seconds": done.seconds, "notes": done.notes}


def fastest_gait(robot: Robot, water: Path) -> float | None:
    """Speed in m/s of the fastest measured gait in a fitted water, which it prints; None if no gait swims."""
    from fishmj.control.gait_table import gait_of
    from fishmj.water.choice import in_water

    try:
        fastest = float(gait_of(in_water(robot, water))["speed"].max())
    except ConfigError as error:
        console.say(str(error))
        return None
    console.say(f"fastest gait {fastest:.2g} m/s (a family's `fastest`); faster streams carry the fish away")
    return fastest


def chosen(robot: Robot, args) -> HydroModel:
    """Model to be judged."""
    if args.prior:
        from fishmj.hydro_fit.prior_model import unfitted

        return unfitted(robot)
    places = [folder / f"{robot.name}.toml" for folder in ([Path(args.out)] if args.out else FOLDERS)]
    place = next((path for path in places if path.is_file()), places[0])
    if not args.model and not place.is_file():
        raise StoreError(
            f"{place}: no fitted water for {robot.name!r} yet; fit it: fishmj hydro_fit fit --fish {shlex.quote(args.fish)}"
        )
    if not args.model and place != places[0]:
        console.say(f"no fitted water in {places[0].parent}: using the shipped {place}")
    model = HydroModel.load(args.model or place)
    return model.base_only if args.base else model


def repeats_of(data: SegmentDataset, slip: float) -> list[tuple[SegmentRecord, SegmentRecord]]:
    """Pairs of a repeat and its original."""
    pairs = []
    for name in data.names("test", slip=slip):
        original = data.about[name].get("replicate_of")
        if original and original in data.about and "file" in data.about[original]:
            pairs.append((data[name], data[original]))
    return pairs


def held_out(
    robot: Robot, folder: Path, args, model: HydroModel | None = None
) -> tuple[list[SegmentRecord], list[tuple[SegmentRecord, SegmentRecord]]]:
    """Records on which `model` is judged: the test part, plus that of the fresh episodes unless --data selects one set.

    Returns:
        the records without repeats, and pairs of a repeat and its original.
    """
    beside = folder.with_name(folder.name + FRESH)
    places = [folder] if args.data or not (beside / MANIFEST).is_file() else [folder, beside]
    records, repeats = [], []
    for data in of_its_water(model, [open_dataset(place, test=True) for place in places], args.slip):
        if not data.whole:
            console.warn(
                f"judged on {data.folder.name}'s first test episodes, which are installed; its other ones are {SOURCES} only"
            )
        slip = slip_of(data, args.slip, model)
        records += records_of(data, robot, "test", slip)
        repeats += repeats_of(data, slip)
    return records, repeats


def of_its_water(model: HydroModel | None, sets: list[SegmentDataset], asked: float | None) -> list[SegmentDataset]:
    """Data sets with test segments of the water that `model` was fitted to: its slip ratio, box and boundary.

    asked: --slip. With it all sets are used, with a warning where they are of another water.

    Raises DatasetError: no set has such segments.
    """
    if model is None or not model.dataset.get("grid"):  # nothing was fitted
        return sets
    water = lambda grid, slip: (round(float(slip), 9), grid.get("domain", grid.get("grid")), grid.get("boundary", "plain"))
    words = lambda slip, box, edge: f"slip {slip:g} in {box}" + (f" with boundary {edge}" if edge != "plain" else "")
    tests = lambda data: {water(meta["grid"], meta["grid"]["slip"]) for meta in data.about.values() if meta["split"] == "test"}
    own = water(model.dataset, model.slip)
    if asked is None and (found := [data for data in sets if own in tests(data)]):
        return found
    there = sorted({at for data in sets for at in tests(data) if asked in (None, at[0])})
    if asked is not None and own in there:
        return sets
    names = " and ".join(str(data.folder) for data in sets)
    text = f"{model.name} was fitted at {words(*own)}; test swims of {names} are at {', '.join(words(*at) for at in there)}"
    if asked is not None:
        console.warn(f"{text}: the check is of another water, as --slip {asked:g} asks")
        return sets
    folder = f"runs/{model.name}-test"
    solve = f"--fresh-test 1 --all-at-slip {own[0]:g} --domain {own[1]} --boundary {own[2]} --out {folder}"
    raise DatasetError(
        f"{text}. Solve test swims of its own water: fishmj hydro_fit collect {solve}; then add --data {folder}."
        f" To check it against another water, name that: --slip {there[-1][0]:g}"
    )


def calibrate(robot: Robot, folder: Path, args) -> dict:
    """Scales the error bar of the installed model by the test part of a data set that is used for no other judgement."""
    from fishmj.hydro_fit.fit.prediction_interval import calibrated

    data, model = open_dataset(folder, test=True), chosen(robot, args)
    swims = records_of(data, robot, "test", slip_of(data, args.slip, model))
    made = calibrated(model, robot, swims, {"sha256": data.sha256, "folder": folder.name})
    path = made.save(Path(args.out or FOLDERS[0]))
    factors = {name: made.band[name][0] / parts[0] for name, parts in model.band.items()}
    times = ", ".join(f"{name} {factor:.3g}" for name, factor in factors.items())
    console.say(f"{path}: bands by {made.calibration['swims']} swims, times {times}")
    return {"model": str(path), "factors": factors, **made.calibration}


def check(robot: Robot, folder: Path, args) -> dict:
    """Judges the model on the test part; a preview's misses are printed but are not a failure."""
    from fishmj.hydro_fit.fit_report import PREVIEW_TOLERANCES, check_rows
    from fishmj.hydro_fit.free_swims import judge

    model = chosen(robot, args)
    found = judge(model, robot, *held_out(robot, folder, args, model)) | {"preview": model.preview}
    console.say(console.table(check_rows(found)))
    if model.preview:
        console.say(f"{model.name} is a preview, {PREVIEW_TOLERANCES}")
    return found


def report(robot: Robot, folder: Path, args) -> Path:
    """Writes report.html and report.json beside the model."""
    from fishmj.hydro_fit.fit_report import write

    model = chosen(robot, args)
    out = Path(args.out or FOLDERS[0]) / f"{model.name if model.preview else robot.name}-report"
    return write(out, model, robot, *held_out(robot, folder, args, model))


WRITTEN = {
    "all": "as of fit and report; default data/water",
    "fit": "the model, in place of one that is worse; default data/water",
    "calibrate": "the model with its new error bar, in place of the old; default data/water",
    "check": "where the model is looked for, nothing is written; default data/water",
    "report": "<robot>-report/ with report.html and report.json, in place of old ones; default data/water",
}
_ROWS: tuple[tuple[str, ...], ...] = (
    # verb, summary, options of the example, module where it is not `run`
    ("all", "collect what is missing, fit, check and report", "--fish fish"),
    ("collect", "segments of the flow solver that a water is fitted to", "--preview --out runs/preview",
        "fishmj.hydro_fit.campaign.data.collect"),
    ("fit", "fit the water to a data set; the model takes its place if it is not worse",
        "--data runs/preview --out runs/water"),
    ("calibrate", "the error bar of a model, by swims that no fit has seen", "--data runs/bar"),
    ("check", "the model on held-out episodes; exit 1 where it misses a tolerance", "--prior"),
    ("report", "report.html and report.json of a model", "--out runs/water"),
    ("correct", "rounds of a policy's own states, solved and refitted",
        "paper --domain window_coarse --device cuda --out runs/correct", "fishmj.hydro_fit.campaign.dagger.dagger"),
)  # fmt: skip
COMMANDS = {
    verb: Command(module[0] if module else partial(run, verb), summary, f"fishmj hydro_fit {verb} {example}")
    for verb, summary, example, *module in _ROWS
}
main = console.CommandGroup("hydro_fit", __doc__ or "", COMMANDS, bare="all")


if __name__ == "__main__":
    raise SystemExit(console.run(main))
