"""`python -m fishmj.effects [NAME] [--robot FILE | --mjcf] [--json]`: the catalogue of imperfections, or one entry in full."""

import sys

from fishmj import effects
from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.effects.effect import Confusion, Effect, Parameter


def rows(chosen) -> list[dict]:
    """One table row an effect."""
    return [
        {
            "effect": e.name,
            "stage": e.stage,
            "formula": e.formula,
            "parameters": ", ".join(f"{p.name} [{p.unit}]" for p in e.parameters),
            "typical": ", ".join(f"{p.typical[0]:g} to {p.typical[1]:g}" for p in e.parameters),
            "null": ", ".join(f"{p.null:g}" for p in e.parameters),
            "shows in": ", ".join(e.shows) or "velocity",
        }
        for e in chosen
    ]


def robot_rows(chosen) -> list[dict]:
    """One table row an effect of a robot in MJCF: at each of its sites of a kind."""
    return [
        {
            "effect": e.name,
            "at each": e.robot.site,
            "formula": e.formula,
            "parameters": ", ".join(p.name for p in e.robot.parameters),
        }
        for e in chosen
    ]


def record(e: Effect) -> dict:
    """One effect as plain data, for JSON."""
    kept = ("name", "stage", "about", "formula", "source", "shows", "native", "stochastic", "delays", "drifts", "stream", "sites")
    at = {} if e.robot is None else {"robot": {"site": e.robot.site, "parameters": [p.name for p in e.robot.parameters]}}
    return {
        **{key: getattr(e, key) for key in kept},
        **at,
        "parameters": [
            {key: getattr(p, key) for key in ("name", "unit", "null", "low", "high", "typical", "signed", "shape", "about")}
            for p in e.parameters
        ],
        "confusions": [{"other": c.other, "separates": c.separates, "excitations": c.excitations} for c in alike(e)],
    }


def enters(e: Effect) -> str:
    """Ways in which an effect enters the model: sites, clock delays, random streams, MuJoCo's own options."""
    ways = [f"site {site}" for site in e.sites]
    ways += [f"delay of the clock {clock}" for clock in dict.fromkeys((*e.delays, *e.drifts))]
    ways += [f"drawn once a run on the stream {e.stream}"] if e.stochastic else []
    return "; ".join(ways) + (f"; MuJoCo: {e.native}" if e.native else "")


def alike(e: Effect) -> tuple[Confusion, ...]:
    """Effects with a similar signature: of a fish, or of a robot in MJCF for an effect that only such robots have."""
    return e.confusions if e.swims or e.robot is None else e.robot.confusions


def text(e: Effect) -> str:
    """Description of one effect in full."""
    lines = [f"{e.name} ({e.stage})", f"  {e.about}", f"  formula   {e.formula}", f"  source    {e.source}"]
    if e.swims:
        lines += [f"  shows in  {', '.join(e.shows) or 'velocity'}", f"  enters    {enters(e)}", "  parameters"]
        lines += [f"    {_parameter(p)}" for p in e.parameters]
    if e.robot is not None:
        lines.append(f"  a robot in MJCF: at each {e.robot.site}, {', '.join(p.name for p in e.robot.parameters)}")
    lines += ["  looks like"] if alike(e) else []
    for c in alike(e):
        runs = f" ({', '.join(c.excitations)})" if c.excitations else ""
        lines.append(f"    {c.other}: {c.separates}{runs}")
    return "\n".join(lines)


def _parameter(p: Parameter) -> str:
    sides = ", either sign" if p.signed else ", shape only" if p.shape else ""
    size = f"typical {p.typical[0]:g} to {p.typical[1]:g}{sides}"
    about = f"; {p.about}" if p.about else ""
    return f"{p.name} [{p.unit}]: null {p.null:g}, bounds {p.low:g} to {p.high:g}, {size}{about}"


def options() -> console.Parser:
    """The arguments of `effects`."""
    summary = "The catalogue of imperfections: what each is, how large, where it shows, what looks like it."
    parser = console.parser(
        "effects", summary, examples="example:\n  fishmj effects torque_saturation --robot my_fish.toml\n  fishmj effects --mjcf"
    )
    parser.add_argument("name", type=console.text, nargs="?", help="one effect in full; by default the table of all")
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--robot", type=console.text, help="sizes for this fish: shipped name or TOML file (default: the default fish)"
    )
    mjcf = "those that gap find --model robot.xml knows, in place of those of a fish"
    which.add_argument("--mjcf", action="store_true", help=mjcf)
    return parser


def on_robot(chosen: list[Effect], source: str) -> list[Effect]:
    """The effects as a search on this fish has them. Raises ConfigError, DescriptionError, UnknownName."""
    from fishmj.mjcf.reading import load_robot

    if source.lower().endswith((".xml", ".urdf")):
        raise ConfigError(
            f"--robot {source}: sizes of a robot in MJCF follow from its logs; fishmj effects --mjcf lists its effects"
        )
    robot = load_robot(source)
    return [e.on_joints(robot.n_joints).on_robot(effects.RobotScales.of(robot)) for e in chosen]


def main(argv: list[str]) -> int:
    """Prints the table, or one effect. Returns the exit code."""
    args = options().parse_args(argv)
    chosen = list((effects.robot_catalogue() if args.mjcf else effects.catalogue()).values())
    if args.name:  # of either kind: no name is of both with two meanings
        chosen = [effects.robot_catalogue().get(args.name) or effects.get(args.name)]
    if args.robot:
        chosen = on_robot(chosen, args.robot)
    if args.json:
        records = [record(e) for e in chosen]
        console.emit_json(records[0] if args.name else {"effects": records, "n": len(records)})
    elif args.name:
        console.say(text(chosen[0]))
    else:
        console.say(console.table((robot_rows if args.mjcf else rows)(chosen)))
    return console.OK


if __name__ == "__main__":
    sys.exit(console.run(main))
