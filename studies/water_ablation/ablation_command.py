"""`fishmj hydro_fit ablation`: what each part of the fitted water is worth, by fits without it on the same held-out records.

fishmj hydro_fit ablation --data data/hydro/swift --seeds 0,1,2
"""

from pathlib import Path

from fishmj.base import console
from fishmj.hydro_fit.__main__ import data_of, held_out, records_of, slip_of
from fishmj.hydro_fit.fit.fit_pipeline import FitSettings
from fishmj.hydro_fit.fit.training_loop import use_cores_as_devices
from fishmj.hydro_fit.segment_dataset import open_dataset
from fishmj.mjcf.reading import load_robot
from studies.water_ablation import ablation_table
from studies.water_ablation.ablation import table


def options() -> console.Parser:
    """Parser of the command."""
    made = console.parser("hydro_fit ablation", "What each part of the model is worth: fits without it, same held-out records.")
    add = made.add_argument
    add("--fish", type=console.text, default="fish", help="a shipped name or a description (.toml)")
    add("--data", type=console.path, help="data set; default data/hydro/<robot>, else the shipped one")
    out = "folder of the table; finished rows there are not done again; default runs/hydro_fit/ablation-..."
    add("--out", type=console.out_folder, help=out)
    add("--slip", type=console.number(0, 1), help="slip ratio of the records; default that of the data, of several 1")
    add("--rows", type=console.Listed(console.text), default=[], metavar="NAME,..", help="rows of the table; default all")
    add("--seeds", type=console.Listed(console.SEED), default="0", metavar="N,..", help="of learnt rows: 0,1,2")
    return made


def main(argv: list[str]) -> None:
    """Makes the missing rows, then writes the table and its picture."""
    args = options().parse_args(argv)
    use_cores_as_devices()
    robot = load_robot(args.fish)
    folder = data_of(robot, args)
    data = open_dataset(folder)
    slip = slip_of(data, args.slip)
    parts = [*(records_of(data, robot, split, slip) for split in ("train", "val")), held_out(robot, folder, args)[0]]
    out = Path(args.out or Path("runs") / "hydro_fit" / f"ablation-{folder.name}-{robot.name}-{slip:g}")
    about = {"sha256": data.sha256, "folder": folder.name, "slip": slip}
    given = {"names": args.rows, "seeds": args.seeds}
    with console.Progress(1.0, f"ablation {folder.name}") as bar:
        update = lambda share, what: bar.update(share, at=what)
        rows = table(robot, *parts, settings=FitSettings(), dataset=about, folder=out, report=update, **given)
    console.say(console.table(ablation_table.cells(rows)))
    console.say(*(f"wrote {path}" for path in ablation_table.write(out, rows, about)))
    if args.json:
        console.emit_json({"about": about, "rows": rows})
