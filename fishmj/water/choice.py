"""Choice of the water in which a fish swims, by the same names in all commands and functions.

    fitted       strips and a learnt residual, fitted to the flow solver for this body; the default wherever the robot has one
    structured   strips with the description's own coefficients
    hybrid       `fitted`, corrected by the flow solver while the fish swims
    lbm          the flow solver itself
    none         no water: a bench in air
    family       fits to the flow solver at several slip ratios: every randomised fish draws a water between them
    NAME         a fitted water by name or .toml file; NAME-base: strip model fitted alone; NAME#2: member 2 of its ensemble

    choice = chosen(robot, None)      WaterChoice(kind, robot in that water, one line that says which it is)

A description may state its default water as `[water] model`. `robot.water["model"]` holds the chosen water, a kind or the name of
a fitted water; the key is absent until a water is chosen.
"""

from collections.abc import Collection
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from fishmj.base import calib, console
from fishmj.base.errors import ConfigError, FishmjError, StoreError, UnknownName
from fishmj.base.names import split_member
from fishmj.mjcf.description import Robot
from fishmj.mjcf.priors import water_prior
from fishmj.water.dynamics import strip_forces

if TYPE_CHECKING:
    from fishmj.water.hydro_model import HydroModel
    from fishmj.water.water_family import WaterFamily

FITTED, STRUCTURED, HYBRID, LBM, NONE = KINDS = ("fitted", "structured", "hybrid", "lbm", "none")
FAMILY = "family"  # the family of the robot's body
FAMILY_SCHEMA = "fishmj.water-family/1"
OWN = "own"  # key in `robot.water` of the description's own table
DRY = ("k", "cn", "cf", "ca_forward", "ca_backward", "ke")  # coefficients, zero in air
NO_FORCE = ("model", "stations", "residual")  # keys of `[water]` that a fitted water does not replace
EARLIER = {"ke": (0.5, 0.7), "stall_angle_deg": (35.0,)}  # of shipped descriptions and earlier ones of `fishmj new`
SELF_MADE = (FITTED, STRUCTURED, NONE)  # waters that every engine supports without the flow solver
SOLVED = (HYBRID, LBM)  # waters that need the flow solver
HELP = (
    "fitted: strips and learnt residual fitted to the flow solver for this body, the default if there is a fit; family:"
    " each randomised fish draws a water between several fits; structured: the description's own coefficients; none: air; or a"
    " fitted water by name (NAME-base: without the residual) or .toml file"
)


NOT_FITTED = "none is fitted for this body"
FIT_IT = "fishmj hydro_fit --fish FILE"  # of its description: a shipped robot has a fitted water
RANDOM_WATER = "--randomise-effects crossflow_drag,quadratic_drag,tail_normal_force"  # random forces without any fit
INSTEAD = {
    HYBRID: "hybrid works in Sim, suite.load, `fishmj evaluate` and `fishmj play`",
    LBM: "lbm works in suite.load, `fishmj evaluate` and `fishmj train --engine lbm`",
    NONE: "none works in Sim and the engines",
}


class WaterChoice(NamedTuple):
    """Chosen water of one robot."""

    kind: str  # of KINDS
    robot: Robot  # with the coefficients and the name of its water
    said: str  # description in one line

    def within(self, can: Collection[str], who: str) -> "WaterChoice":
        """Returns this choice if the caller supports its kind.

        Args:
            can: kinds that the caller supports.
            who: name of the caller, for the message.
        Raises:
            ConfigError: the caller does not support this water; the message lists those that it supports.
        """
        if self.kind not in can:
            raise ConfigError(
                f"water {self.kind!r}: {who} supports {', '.join(can)}, or a fitted water by name; {INSTEAD[self.kind]}"
            )
        return self

    def announced(self) -> "WaterChoice":
        """Returns this choice; warns once for each body if no water was chosen and none is fitted."""
        if NOT_FITTED in self.said:
            console.warn_once(f"robot {self.robot.name!r}, water: {self.said}")
        return self


def chosen(robot: Robot, water: "str | Path | None" = None) -> WaterChoice:
    """Water that the option selects; None: the description's default, else the fitted water, else `structured`.

    Raises:
        UnknownName, StoreError: no such water, or a damaged one. ConfigError: no water is fitted for this body, or it was fitted
        for another body or time step.
    """
    name, described = None if water is None else str(water), robot.water.get(OWN, robot.water)
    stated = robot.water.get("model")
    if name == FAMILY:
        name = f"{_body_name(robot)}{calib.FAMILY}"
        if name not in calib.families():
            own = "write one of your own fits and give its file, --water FILE.toml (docs/train/training.md, In a random water)"
            ways = f"{own}, or draw the water's effects with train {RANDOM_WATER}"
            raise ConfigError(f"water {FAMILY!r}: no family comes with fishmj for robot {robot.name!r}; {ways}")
    if name is None:
        name = stated or (FITTED if fitted_for(robot) else STRUCTURED)
    if name == STRUCTURED:
        why = "" if water is not None or stated else f"; {NOT_FITTED}: {FIT_IT}"
        return WaterChoice(STRUCTURED, _with_coefficients(robot, described, name), f"structured, own coefficients{why}")
    if name == LBM:
        return WaterChoice(LBM, _with_coefficients(robot, described, name), "lbm, the flow solver itself")
    if name == NONE:
        return WaterChoice(NONE, _with_coefficients(robot, _air_table(robot), name), "none, a bench in air")
    if name == HYBRID:
        fitted = chosen(robot, FITTED)
        return WaterChoice(HYBRID, fitted.robot, f"hybrid, {fitted.said}, corrected by the flow solver")
    return _fitted(robot, name)


def _with_coefficients(robot: Robot, coefficients: dict[str, Any], name: str) -> Robot:
    """Robot with other coefficients; keeps its description's under `OWN`, to identify and restore it."""
    described = robot.water.get(OWN, robot.water)
    kept = {key: described[key] for key in ("stations",) if key in described}
    return replace(robot, water={**coefficients, **kept, "model": name, OWN: described})


def in_water(
    robot: Robot, water: "str | Path | None" = None, *, can: Collection[str] = SELF_MADE, who: str = "this engine"
) -> Robot:
    """Robot in the water that the option selects, as `chosen`; further arguments and errors as `WaterChoice.within`."""
    return chosen(robot, water).within(can, who).announced().robot


def as_described(robot: Robot, water: "str | Path" = STRUCTURED) -> Robot:
    """Robot in its description's own water, or in a fitted water if one is named.

    For work that tests a description: the gap search, the calibration, the virtual robot.
    """
    return robot if str(water) == STRUCTURED else in_water(robot, water, who="a command that tests a description")


def _joined(name: str, member: str | None) -> str:
    """The inverse of `split_member`."""
    return name if member is None else f"{name}#{member}"


def model_of(robot: Robot) -> "HydroModel | None":
    """Fitted water of the robot, or None. Raises UnknownName, StoreError, ConfigError if it cannot be read."""
    name = label(robot)
    if name in (STRUCTURED, LBM, NONE):
        return None
    return fitted_water(_resolved_name(robot, name))


def _resolved_name(robot: Robot, name: str) -> str:
    """Name of the water for `fitted`: the description's, else the one of the robot's body. Returns other names unchanged.

    Raises ConfigError: this robot has no fitted water.
    """
    kind, member = split_member(name)
    if kind != FITTED:
        return name
    states = robot.water.get(OWN, robot.water).get("model")
    if states not in (None, *KINDS):
        return _joined(split_member(states)[0], member or split_member(states)[1])
    if (own := _body_name(robot)) not in calib.waters():
        raise ConfigError(f"water 'fitted': none is fitted for robot {robot.name!r}; take structured, or fit one: {FIT_IT}")
    return _joined(own, member)


def _body_name(robot: Robot) -> str:
    """Name of the waters of this body: the robot's, or that of the shipped robot with this body."""
    waters = calib.waters()
    alike = lambda name: name in waters and fitted_water(name).fits_body(robot)
    return robot.name if robot.name in waters else next(filter(alike, calib.robots().values()), robot.name)


def label(robot: Robot) -> str:
    """Water of a robot for tables and logs: a kind, or the name of the fitted water."""
    return robot.water.get("model") or STRUCTURED


def fitted_for(robot: Robot) -> str | None:
    """Name of this body's fitted water, or None.

    Raises StoreError, ConfigError: it is damaged, or was fitted at another time step.
    """
    try:
        if (name := _body_name(robot)) not in calib.waters():
            return None
        model = fitted_water(name)
    except FishmjError as error:
        raise StoreError(f"{error}; without it: --water structured") from error
    if not model.fits_body(robot):
        return None
    model.swimmer(robot)
    return name


def _fitted(robot: Robot, name: str) -> WaterChoice:
    name, described = _resolved_name(robot, name), robot.water.get(OWN, robot.water)
    model, family = fitted_water(name), family_of(name)
    coefficients = model.swimmer(robot).water._asdict()
    if (share := described.get("residual")) is not None:
        if family is not None:
            raise ConfigError(
                f"water {name!r}: [water] residual = {share} of robot {robot.name!r}, but every fish of a family draws its share"
                f" between {family.residual[0]:g} and {family.residual[1]:g} times its fit's; leave it out, or name one fit"
            )
        coefficients["residual"] = share
    made, prior = _with_coefficients(robot, coefficients, name), water_prior(robot.links)
    guessed = {key: (value, *EARLIER.get(key, ())) for key, value in prior.items()}
    own = [key for key, value in described.items() if key not in NO_FORCE and value not in guessed.get(key, ())]
    if own:
        about = f"robot {robot.name!r}: [water] {', '.join(own)}"
        console.warn_once(f"{about}: not used in the fitted water {name!r}; --water structured uses them", about)
    if family is not None:
        said = lambda one: f"{one.name} (slip {one.slip:g}{', a preview' if one.preview else ''})"
        fits = ", ".join(dict.fromkeys(map(said, family.members)))
        return WaterChoice(FITTED, made, f"{name}: each randomised fish draws a water between the fits {fits}")
    parts = "strips alone" if model.learnt is None else "strips and learnt residual"
    preview = ", a preview" if model.preview else ""
    return WaterChoice(FITTED, made, f"fitted ({name}: {parts}, slip {model.slip:g}{preview}){model.remark(robot)}")


def _air_table(robot: Robot) -> dict[str, Any]:
    """Water table with all coefficients zero, for air."""
    table = strip_forces.coefficients(robot.water, len(robot.links))._asdict()
    return {
        key: ([0.0] * len(value) if isinstance(value, list) else 0.0) if key in DRY else value for key, value in table.items()
    }


def residuals_of(robot: Robot) -> tuple:
    """Learnt residuals of the robot's water, several in a family. Raises ConfigError if they have another number of links."""
    model = model_of(robot)
    if model is None:
        return ()
    if (links := len(model.base.k)) != len(robot.links):
        raise ConfigError(
            f"robot {robot.name!r} [water] model: got {label(robot)!r}, fitted for {model.robot!r} of {links} links, expected"
            f" one for {len(robot.links)} links; 'structured' fits every robot"
        )
    if (family := family_in(robot)) is not None:
        return family.nets
    return () if model.learnt is None else (model.learnt,)


@lru_cache(8)
def family_of(name: str) -> "WaterFamily | None":
    """Family of waters by name or file; None if `name` is another water."""
    files = [Path(name)] if name.endswith(".toml") else [folder / f"{name}.toml" for folder in calib.WATERS]
    found = next((path for path in files if path.is_file()), None)
    if found is None or FAMILY_SCHEMA not in found.read_text(encoding="utf-8", errors="replace"):
        return None
    if calib.read_toml(found).get("schema") != FAMILY_SCHEMA:
        return None
    from fishmj.water.water_family import WaterFamily

    return WaterFamily.load(found)


def family_in(robot: Robot) -> "WaterFamily | None":
    """Family from which each randomised fish of this robot draws its water; None if the robot's water is no family."""
    return family_of(str(robot.water.get("model", "")))


@lru_cache(8)
def fitted_water(name: str) -> "HydroModel":
    """Loads a fitted water by name or file."""
    from fishmj.water.hydro_model import HydroModel, shipped

    if (family := family_of(name)) is not None:
        return family.members[0]
    plain, _ = split_member(name)
    if plain.removesuffix("-base") not in shipped() and not plain.endswith(".toml"):
        raise UnknownName(
            "water", name, (*KINDS, FAMILY, *shipped(), *calib.families()), more=" One of your own is named by its file, .toml."
        )
    return HydroModel.load(name)
