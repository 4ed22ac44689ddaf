"""Family of waters: fits to the flow solver at several slip ratios, between which every episode draws its water.

    c = f ((1 - w) A + w B + (A_e - A))
    A, B   strip coefficients of two members, drawn independently; w in [0, 1) interpolates, one w for drag and one for the rest,
           because the fits identify thrust minus drag better than each alone
    N      the learnt residual is that of A; if B has another, w is at most 1/2, so that A is the nearer
    A_e    member e of A's ensemble, which represents the uncertainty of that fit
    f      a random factor for each coefficient, within `scatter`, of drag within `drag`; none for stall shape and suction.
           Trailing-edge coefficients are k_e, k_e a, k_e b, because forces can be averaged and a fit may have k_e = 0.
           The factor of the learnt residual's share lies within `residual`

A fish cannot hold station in a fast stream in every such water. With v_m the speed of the fastest gait in member m, a draw with
(1 - w) v_A + w v_B below `RESERVE` times the stream, for either w, moves towards the fastest member until it is not below.

GPU engines need neighbouring fish with the same residual: in batches of `MANY` or more, `RUN` neighbours have the same A.

A family is a TOML file, `<name>.toml`, with schema `fishmj.water-family/1`. Its members are in the same folder or come with
fishmj. The first is the water of a fish without randomisation.
"""

import hashlib
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fishmj.base import calib, console, names
from fishmj.base.errors import ConfigError, DescriptionError, StoreError
from fishmj.mjcf.description import Robot
from fishmj.mjcf.description_schema import shown
from fishmj.water import residual_hooks
from fishmj.water.dynamics import planar_chain
from fishmj.water.hydro_model import HydroModel, shipped
from fishmj.water.prior import STEEPEST, flat, names_of, unflat

KEPT = ("stall_angle", "stall_width", "stall_lag", "suction", "residual")  # coefficients without a factor
EDGE = ("ke", "lift_a", "lift_b")  # coefficients of the trailing edge
DRAG = ("cn", "cf", "ca_forward", "ca_backward")
N_FIXED = 6  # uniforms before those of the factors: A, B, w, e, factor of the residual's share, w of drag
MANY, RUN = 4096, 128  # residual_step.FEWEST, planar_kernel.BLOCK
RESERVE = 1.3  # minimal ratio of the fastest gait to the stream, because a fish also has to turn and to catch up
EXPECTED = {
    "schema": "'fishmj.water-family/1'",
    "name": "1 to 64 letters, digits, '_', '.' or '-'",
    "members": "2 to 32 names of fitted waters, without folder",
    "scatter": "a number from 0 to 0.5",
    "residual": "two numbers from 0 to 2, the smaller first",
    "drag": "two numbers above 0, 2 at most, the smaller first",
    "fastest": "for each member the speed of its fastest gait in m/s, above 0, 20 at most",
    "commands": "texts: the commands that made the members",
}


class FamilyFile(BaseModel):
    """The file of a family."""

    model_config = ConfigDict(extra="forbid", strict=True)

    schema_: Literal["fishmj.water-family/1"] = Field(alias="schema")
    name: Annotated[str, Field(pattern=rf"^{names.PATTERN}$")]
    members: Annotated[list[Annotated[str, Field(pattern=rf"^{names.PATTERN}$")]], Field(min_length=2, max_length=32)]
    scatter: Annotated[float, Field(ge=0.0, le=0.5)]
    residual: tuple[Annotated[float, Field(ge=0.0, le=2.0)], Annotated[float, Field(ge=0.0, le=2.0)]]
    drag: tuple[Annotated[float, Field(gt=0.0, le=2.0)], Annotated[float, Field(gt=0.0, le=2.0)]] | None = None
    fastest: list[Annotated[float, Field(gt=0.0, le=20.0)]] = []  # m/s, of the fastest gait in each member
    commands: list[str] = []  # that made the members


class WaterFamily:
    """Fitted waters of one body.

    Attributes:
        members: the fitted waters. nets: their learnt residuals, each once. net: (M,) int, which is whose.
        base: (M, P) their coefficients, flat, as `_forces`. deviation: (M, E, P) of the ensembles' members from them.
        scatter: largest relative change of a coefficient. residual: bounds of the factor on the residual's share.
        drag: mask (P,) of the drag coefficients. drag_factors: their bounds; default, those of `scatter`.
        fastest: (M,) m/s, speeds of the members' fastest gaits; empty: streams do not restrict the draws.
    Raises:
        ConfigError: members of different bodies or time steps or all the same, residuals of different sizes, another number of
        speeds, or reversed bounds. `where` begins the message: the file, by default the name.
    """

    def __init__(
        self, name: str, members: list[HydroModel], *, scatter: float, residual: tuple[float, float], drag=None, fastest=(),
        where: str = "",
    ):  # fmt: skip
        where = where or f"family {name}"
        if len(fastest) not in (0, len(members)):
            raise ConfigError(f"{where} fastest: got {len(fastest)} speeds, expected one for each of {len(members)} members")
        first = members[0]
        fitted = [f"{one.name!r} for robot {one.robot!r} {(one.body_sha256 or one.robot_sha256)[:12]}" for one in members]
        for other, its in zip(members[1:], fitted[1:], strict=True):
            if other.body_sha256 != first.body_sha256:
                todo = "leave one out, or fit it: fishmj hydro_fit --fish FILE"
                raise ConfigError(f"{where} members: got waters of two bodies, {fitted[0]} and {its}, expected one body; {todo}")
            if other.dt != first.dt:
                got = f"{first.name!r} fitted at dt = {first.dt} s and {other.name!r} at {other.dt} s"
                raise ConfigError(f"{where} members: got {got}, expected one time step; fit one again")
            if _shapes(other) != _shapes(first):
                got = f"the learnt residual of {other.name!r} has another size than that of {first.name!r}"
                for one, beside in ((first, other), (other, first)):
                    got = f"{one.name!r} has no learnt residual, {beside.name!r} has one" if one.learnt is None else got
                todo = "give fits with networks of one size, or the strips of all alone (NAME-base)"
                raise ConfigError(f"{where} members: {got}; {todo}")
        if len({model.sha256 for model in members}) == 1:
            raise ConfigError(f"{where} members: got one water {len(members)} times, expected at least two waters; name another")
        residuals = {_residual_sha256(model): model.learnt for model in members if model.learnt is not None}
        self.nets = tuple(residuals.values())
        self.net = np.array([[*residuals].index(_residual_sha256(model)) if residuals else 0 for model in members])
        self.drag_factors = drag or (1.0 - scatter, 1.0 + scatter)
        for key, bounds in (("residual", residual), ("drag", self.drag_factors)):
            if bounds[0] > bounds[1]:
                raise ConfigError(f"{where} {key}: got {list(bounds)}, expected the smaller number first; exchange the two")
        self.name, self.members, self.scatter, self.residual = name, members, scatter, residual
        self._own = [] if drag is None else [drag]  # hashed only if stated, so that older families keep their hash
        self.names = names_of(len(first.base.k))
        self.base = self._forces(np.stack([flat(model.base) for model in members]))
        count = min(len(model.members) for model in members)
        self.deviation = np.stack([self._forces(model.members[:count]) for model in members]) - self.base[:, None]
        factored = np.array([key not in KEPT for key in self.names])
        self.drag = np.array([key.rstrip("0123456789") in DRAG for key in self.names])
        self.factors = np.where(
            self.drag, np.array(self.drag_factors)[:, None], 1.0 + scatter * np.array([[-1.0], [1.0]]) * factored
        )
        self.fastest = np.asarray(fastest, float)

    @property
    def sha256(self) -> str:
        """Hex digest of all members and of the bounds of the draws."""
        parts = [*(model.sha256 for model in self.members), self.base.tobytes().hex(), self.deviation.tobytes().hex()]
        drawn = [self.scatter, self.residual, *self.fastest.tolist(), *self._own]
        return hashlib.sha256(repr([*parts, *drawn]).encode()).hexdigest()

    @property
    def width(self) -> int:
        """Number of uniforms of a draw."""
        return N_FIXED + len(self.names)

    def draw(self, xp, uniforms, strength: float = 1.0, stream=None):
        """Strip coefficients (B, P) from uniforms (B, width); strength 0 gives the first member.

        stream: (B,) m/s, in which the fish must be able to hold station; None: no restriction.
        """
        u, base, deviation = uniforms, xp.asarray(self.base), xp.asarray(self.deviation)
        a, b, e = self._drawn(xp, u)
        way = xp.where(xp.asarray(self.net)[a] == xp.asarray(self.net)[b], 1.0, 0.5).astype(base.dtype)
        rest, drag = way * u[:, 2], way * u[:, 5]
        w = xp.where(xp.asarray(self.drag), drag[:, None], rest[:, None])
        drawn = (1.0 - w) * base[a] + w * base[b] + deviation[a, e]
        if stream is not None and len(self.fastest):
            speed, top = xp.asarray(self.fastest, dtype=base.dtype), int(np.argmax(self.fastest))
            swims = xp.minimum(*((1.0 - part) * speed[a] + part * speed[b] for part in (rest, drag)))
            share = xp.clip((RESERVE * stream - swims) / xp.maximum(speed[top] - swims, 1e-6), 0.0, 1.0)
            drawn = drawn + share[:, None] * (base[top] - drawn)
        least, most = xp.asarray(self.factors, dtype=base.dtype)
        factor = least + (most - least) * u[:, N_FIXED:]
        low, high = self.residual
        rows = base[0] + strength * (drawn * factor - base[0])
        share = base[0, -1] + strength * (drawn[:, -1] * (low + (high - low) * u[:, 4]) - base[0, -1])
        return self._coefficients(xp, rows, share)

    def warn_beyond(self, slowest: float) -> None:
        """Warns once if every draw is the fastest member in streams of `slowest` m/s or more."""
        if len(self.fastest) and RESERVE * slowest > (top := self.fastest.max()):
            member = self.members[int(np.argmax(self.fastest))].name
            console.warn_once(
                f"water {self.name!r}: in streams from {slowest:g} m/s every fish swims in the fastest member, {member!r}, which"
                f" reaches {top:g} m/s, less than {RESERVE:g} times that; check fastest, or take slower streams"
            )

    def net_of(self, xp, uniforms, strength: float = 1.0):
        """Index (B,) in `nets` of the residual of each water of `draw`."""
        own = xp.asarray(self.net)[self._drawn(xp, uniforms)[0]]
        return xp.where(strength > 0, own, self.net[0]).astype("int32")

    def swimmer(self, robot: Robot, seed: int) -> planar_chain.Swimmer:
        """The nominal fish in a water of this family, for `Sim(robot, water=.., swimmer=..)`."""
        uniforms = np.random.default_rng(seed).random((1, self.width))
        water, net = self.draw(np, uniforms), self.net_of(np, uniforms)
        return planar_chain.nominal(robot)._replace(water=unflat(water[0].tolist()), net=int(net[0]))

    def _drawn(self, xp, u) -> tuple:
        """Indices (B,) of the members A and B, and of the member of A's ensemble."""
        count, size = self.deviation.shape[:2]
        a, b, e = (xp.minimum((u[:, k] * n).astype("int32"), n - 1) for k, n in ((0, count), (1, count), (3, size)))
        if len(self.nets) > 1 and len(u) >= MANY:
            a = (xp.arange(len(u)) // RUN) % count
        return a, b, e

    def _forces(self, rows: np.ndarray) -> np.ndarray:
        """Coefficients (.., P) with k_e a and k_e b in place of a and b, because forces may be averaged, ratios may not."""
        ke, a, b = (self.names.index(key) for key in EDGE)
        made = np.array(rows)
        made[..., a], made[..., b] = rows[..., ke] * rows[..., a], rows[..., ke] * rows[..., b]
        return made

    def _coefficients(self, xp, rows, share):
        """Inverse of `_forces`, with this share of the residual; passive: k, cn, .. >= 0, a + b >= 1/2."""
        columns = [xp.maximum(rows[:, i], 0.0) for i in range(len(self.names))]
        ke, a, b = (self.names.index(key) for key in EDGE)
        steepest = xp.maximum(columns[a], columns[b]) / STEEPEST
        columns[ke] = xp.maximum(xp.maximum(columns[ke], steepest), 1e-6)
        columns[a], columns[b] = columns[a] / columns[ke], columns[b] / columns[ke]
        columns[a] = xp.maximum(columns[a], 0.5 - columns[b])
        columns[-1] = share
        return xp.stack(columns, -1)

    @classmethod
    def load(cls, path: Path) -> "WaterFamily":
        """Reads a family and its members.

        Raises:
            StoreError: it or a member is missing or damaged. ConfigError: not a family, or members that do not belong together.
        """
        try:
            table = calib.read_toml(path)
        except ConfigError as error:
            raise StoreError(str(error)) from error
        where, bounds = calib.shown_path(path), [key for key in ("residual", "drag") if isinstance(table.get(key), list)]
        try:
            found = FamilyFile.model_validate(table | {key: tuple(table[key]) for key in bounds})
        except ValidationError as error:
            raise DescriptionError(_faults(error, table, where)) from error
        members = [_member(path, where, member.removesuffix(".toml")) for member in found.members]
        more = {"drag": found.drag, "fastest": found.fastest}
        return cls(found.name, members, scatter=found.scatter, residual=found.residual, where=where, **more)


def _faults(error: ValidationError, table: dict, where: str) -> list[str]:
    """One line for each wrong key of a family's file."""
    lines = []
    for key in dict.fromkeys(str(entry["loc"][0]) for entry in error.errors()):
        got = (shown(table[key]) if key in EXPECTED else "an unknown key") if key in table else "nothing"
        expected = EXPECTED.get(key) or f"one of {', '.join(EXPECTED)}"
        lines.append(f"{where} {shown(key)[1:-1]}: got {got}, expected {expected}; see docs/simulate/fitted_water.md, Families")
    return lines


def _member(path: Path, where: str, name: str) -> HydroModel:
    """Member of a family: the water of that name beside the file, else the one that comes with fishmj."""
    if any(path.with_name(f"{one}.toml").exists() for one in (name, name.removesuffix("-base"))):
        return HydroModel.load(path.with_name(f"{name}.toml"))
    if name.removesuffix("-base") in shipped():
        return HydroModel.load(name)
    beside = sorted(one.stem for one in path.parent.glob("*.toml") if one.name != path.name)
    holds = f"{calib.shown_path(path.parent)} holds {', '.join(beside[:20]) or 'no other .toml file'}"
    raise StoreError(
        f"{where} members: {name!r}: no such water beside the file; {holds}; fishmj comes with {', '.join(shipped())}"
    )


def _shapes(model: HydroModel):
    return None if model.learnt is None else [np.shape(part) for part in model.learnt.net]


def _residual_sha256(model: HydroModel) -> str:
    return "" if model.learnt is None else residual_hooks.sha256(model.learnt)
