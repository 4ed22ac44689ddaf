"""Named waters of the flow solver: box and grid, slip ratio, immersed boundary.

`PLAIN` is the meaning of `--water lbm` alone: the paper's tank and grid, the source of the shipped fitted water and the published
tables. `REFERENCES` are the waters for judging, selected by name (`--water lbm --reference NAME`). None of them ever changes;
another water gets another `name`. Grid, slip ratio and boundary were chosen by the effect of half the cell; a real fish's swims
judged them (docs/solver/results.md, "The reference water").

`BOUNDARIES` are the treatments of the immersed boundary that have a name (`--boundary`); Python takes any `Sharpness`. Another
kind of treatment is a new field with a default, which `immersed` passes on.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.units import WATER_VISCOSITY
from fishmj.lbm_oracle.immersed import markers
from fishmj.lbm_oracle.immersed.markers import Sharpness
from fishmj.lbm_oracle.run.domain import Domain, preset
from fishmj.mjcf import Robot, load_robot

BOUNDARIES = {
    "plain": markers.PLAIN,  # markers as shipped data were made with
    "rims": Sharpness(rim=1.0),  # fins and tail end about where they do; for hulls with a slip ratio
    "fins": markers.FINS,  # hulls, edges and fins where they are, added mass of fins: for all that is new
    "wall_stress": markers.WALL_STRESS,  # without that added mass; a law for the wall's stress sets the slip ratio of each marker
}


def boundary_name(sharpness: Sharpness) -> str:
    """Name of the boundary in `BOUNDARIES`, else its lengths."""
    lengths = repr(sharpness).replace(", edges=False", "")  # as in records from before there were edges
    return next((name for name, known in BOUNDARIES.items() if known == sharpness), lengths)


def boundary_of(dataset: Mapping[str, Any]) -> Sharpness:
    """Boundary with which a data set, or a fitted water's segments, were solved. Raises ConfigError: it has no name here."""
    name = str(dataset.get("boundary", "plain"))
    if name not in BOUNDARIES:
        raise ConfigError(f"flow solver: boundary {name}; expected {', '.join(BOUNDARIES)}")
    return BOUNDARIES[name]


def boundary_entry(sharpness: Sharpness) -> dict[str, str]:
    """Entry for the boundary in the set-up of a table or data set; empty for the plain boundary, as in older files."""
    return {} if sharpness == markers.PLAIN else {"boundary": boundary_name(sharpness)}


def robot_entry(robot: Robot) -> dict[str, str]:
    """Entry for the swimmer in the set-up of a table; empty for the shipped fish, as in older files."""
    return {} if robot == load_robot("fish") else {"robot": robot.name}


def swim_entries(sharpness: Sharpness, robot: Robot, nu: float) -> dict[str, Any]:
    """Entries for boundary, swimmer and viscosity [m2/s] in the set-up of a table; none for water's, as in older files."""
    return boundary_entry(sharpness) | robot_entry(robot) | ({} if nu == WATER_VISCOSITY else {"nu": nu})


def swim_options(add: Callable[..., Any], slips: Iterable[float]) -> None:
    """Adds --robot, --nu, --beats and those of `study_options` to the command of a study of free swims."""
    add("--robot", type=console.text, default="fish", help="shipped name or TOML file")
    add("--nu", type=console.number(1e-7, 1e-2), default=WATER_VISCOSITY, metavar="M2/S", help="kinematic viscosity")
    add("--beats", type=console.number(0, 1000, above=True), default=8.0, help="of a swim; the last two count")
    study_options(add, slips)


def boundary_option(add: Callable[..., Any], default: str | None = "plain") -> None:
    """Adds the option `--boundary` to a command; `add` is its parser's method."""
    words = "treatment of the hull. plain: as shipped waters. rims: fins drawn in, as in reference-2. fins: hulls, edges and fins"
    words += " drawn in, and the added mass of fins; for all that is new. wall_stress: a law of the wall in place of --slip."
    words += " Default plain"
    add("--boundary", choices=tuple(BOUNDARIES), default=default, help=words)


def cell_option(add: Callable[..., Any]) -> None:
    """Adds the option `--dx` to a command with a box of water; `add` is its parser's method."""
    cell = "another cell, same size, dt in proportion; by default the domain's"
    add("--dx", type=console.number(0.001, 0.2), metavar="M", help=cell)


def study_options(add: Callable[..., Any], slips: Iterable[float]) -> None:
    """Adds --slips, by default `slips`, --boundary and --device to the command of a study."""
    slip = f"quoted at the paper's grid: 1 slides, 0 sticks; default {' '.join(f'{s:g}' for s in slips)}"
    add("--slips", type=console.number(0, 1), nargs="+", action=console.Distinct, metavar="S", help=slip)
    boundary_option(add)
    add("--device", type=console.devices, default="auto", help=console.DEVICES_HELP)


def study_slips(who: str, slips: list[float] | None, boundary: str, usual: Iterable[float]) -> list[float]:
    """Slip ratios of a study: those given, else the usual ones; 1 alone with a boundary that sets them.

    Raises ConfigError: slip ratios beside such a boundary.
    """
    if BOUNDARIES[boundary].law_height is None:
        return list(usual if slips is None else slips)
    if slips is not None and slips != [1.0]:
        raise ConfigError(f"{who}: --slips beside --boundary {boundary}, which sets the slip ratio; leave one of them out")
    return [1.0]


class SolverWater(NamedTuple):
    """Boxes of water by name, for a tank and for a fish that swims away; slip ratio of the hull at the paper's grid.

    width, passes, sharpness: of the immersed boundary (`SwimSetup`). storage: type of the populations, float32 or float16.
    dx: m, cells of the tank in place of its domain's. nu: m2/s, kinematic viscosity.
    """

    name: str
    domain: str
    window: str
    slip: float = 1.0
    width: int = 3
    passes: int = 2
    sharpness: Sharpness = markers.PLAIN
    storage: str = "float32"
    dx: float | None = None
    nu: float = WATER_VISCOSITY

    @property
    def box(self) -> Domain:
        """Domain of the tank."""
        return preset(self.domain).changed(nu=self.nu).with_cells(self.dx)

    @property
    def immersed(self) -> dict[str, Any]:
        """Options of `SwimSetup`: the immersed boundary, and the storage if it is not single precision."""
        edge = {"width": self.width, "passes": self.passes, "sharpness": self.sharpness}
        return edge | ({} if self.storage == "float32" else {"storage": self.storage})

    @property
    def label(self) -> str:
        """Label for tables and file names, `paper, slip 1`; also the reference's name, and a boundary that is not plain.

        With a law for the wall's stress it names that law in place of the slip ratio.
        """
        named = "" if self.name == PLAIN.name else f"{self.name}, "
        edge = "" if self.sharpness == markers.PLAIN else f", boundary {boundary_name(self.sharpness)}"
        stored = "" if self.storage == "float32" else f", {self.storage}"
        cells = "" if self.dx is None else f", cells of {1e3 * self.dx:g} mm"
        viscous = "" if self.nu == WATER_VISCOSITY else f", viscosity {self.nu:g} m2/s"
        hull = f"slip {self.slip:g}" if self.sharpness.law_height is None else "Werner-Wengle wall law"
        return f"{named}{self.domain}{cells}, {hull}{edge}{stored}{viscous}"

    @property
    def said(self) -> str:
        """One line for people: cells far from the fish and at it."""
        cells = " and ".join(f"{1e3 * level.dx:g} mm" for level in self.box.levels)
        return f"{self.label}; cells of {cells}{', the last round the fish' if self.box.fine else ''}"


PLAIN = SolverWater("lbm", "paper", "window_coarse")
REFERENCE = SolverWater("reference-2", "paper_refined", "window_coarse_refined", slip=0.99, sharpness=BOUNDARIES["rims"])
IN_WINDOW = REFERENCE._replace(domain=REFERENCE.window)  # as of segments and free swims
WALL_STRESS = SolverWater("reference-3", "paper_refined", "window_coarse_refined", sharpness=BOUNDARIES["wall_stress"])
LOW_REYNOLDS = SolverWater(
    "low-reynolds", "paper_refined_twice_small", "window_coarse_refined_twice_small", slip=0.0, sharpness=BOUNDARIES["fins"],
    nu=2e-5,
)  # fmt: skip
REFERENCES = {water.name: water for water in (REFERENCE, WALL_STRESS, LOW_REYNOLDS)}


def water_of_fit(dataset: Mapping[str, Any], slip: float, domain: str | None = None) -> SolverWater:
    """Water in which the segments of a fitted water were solved.

    Args:
        dataset, slip: of the fit. domain: box in place of the segments'; of a fit that names none, the window of `PLAIN`.

    Raises ConfigError: a boundary without a name.
    """
    box = str(domain or dataset.get("grid") or PLAIN.window)
    return PLAIN._replace(domain=box, slip=slip, sharpness=boundary_of(dataset))


def reference_option(add: Callable[..., Any], otherwise: str) -> None:
    """Adds the option `--reference [NAME]` to a command; `otherwise`: its default, in words."""
    which = "; ".join(water.said for water in REFERENCES.values())
    words = f"with --water lbm, a water for judging, {REFERENCE.name} without a name: {which}; default: {otherwise}"
    add("--reference", nargs="?", const=REFERENCE.name, choices=tuple(REFERENCES), metavar="NAME", help=words)


def asked_for(
    who: str, reference: str | None, domain: str | None, slip: float | None, *, boundary: str | None = None,
    storage: str | None = None, dx: float | None = None,
) -> SolverWater:  # fmt: skip
    """Water that the options select.

    Args:
        who: the verb, for the message.
        reference: name in `REFERENCES`, None if not given.
        domain, slip, boundary, storage, dx: the options, None if not given.

    Raises ConfigError: the reference together with another box, slip ratio or boundary, or a slip ratio beside `wall_stress`.
    """
    if reference is None:
        box, edge = domain or PLAIN.domain, BOUNDARIES[boundary or "plain"]
        if edge.law_height is not None and slip is not None:
            raise ConfigError(f"{who}: --slip {slip:g} beside --boundary {boundary}, which sets it; leave one of them out")
        water = PLAIN._replace(domain=box, slip=PLAIN.slip if slip is None else slip, sharpness=edge)
        return water._replace(storage=storage or PLAIN.storage, dx=dx)
    refuse_beside(who, REFERENCES[reference], domain=domain, slip=slip, boundary=boundary, storage=storage, dx=dx)
    return REFERENCES[reference]


def refuse_beside(who: str, water: SolverWater, **options: Any) -> None:
    """Raises ConfigError: an option beside --reference, which is `water` there; None: not given."""
    if given := " ".join(f"--{name} {value}" for name, value in options.items() if value is not None):
        raise ConfigError(f"{who}: {given} beside --reference, which is {water.said}; leave one of them out")
