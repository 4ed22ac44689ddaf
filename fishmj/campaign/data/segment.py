"""A segment: one fish in one box of water for some seconds, said in plain numbers; it can be sent to another machine."""

import hashlib
import json
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from fishmj.errors import ConfigError
from fishmj.flow import Flow
from fishmj.hydro_fit.segment_dataset import SPLITS


@dataclass(frozen=True, kw_only=True)
class Segment:
    """What is run and kept as one record. SI units, radians.

    episode: segments of one episode share its split; they differ in slip, nudge or time step. drive: kind and settings of
    `joint_commands`. settle: s before the record begins. pose (3,), joints (J,), velocity (3 + J,): at the start, velocity at
    rest when empty. nudge: cells by which the fish is shifted. finer: time steps in one of the domain's.
    """

    id: str
    block: str
    episode: str
    split: str
    seconds: float
    drive: dict[str, Any]
    settle: float = 0.0
    slip: float = 1.0
    flow: Flow = field(default_factory=Flow)
    pose: tuple[float, ...] = (0.0, 0.0, 0.0)
    joints: tuple[float, ...] = ()
    velocity: tuple[float, ...] = ()
    nudge: tuple[float, float] = (0.0, 0.0)
    finer: int = 1
    replicate_of: str = ""

    def __post_init__(self):
        if self.split not in SPLITS:
            raise ConfigError(f"segment {self.id}: split = {self.split!r}; expected one of {', '.join(SPLITS)}")
        if not (self.seconds > 0 and self.settle >= 0 and 0 <= self.slip <= 1 and self.finer >= 1):
            got = f"seconds = {self.seconds}, settle = {self.settle}, slip = {self.slip}, finer = {self.finer}"
            raise ConfigError(f"segment {self.id}: {got}; expected > 0 s, >= 0 s, 0 to 1, >= 1")

    @property
    def water(self) -> float:
        """Seconds of water that it takes, in steps of the domain."""
        return (self.settle + self.seconds) * self.finer

    def table(self) -> dict:
        """Plain numbers, for JSON and for other machines."""
        return asdict(self)

    @classmethod
    def of(cls, table: dict) -> "Segment":
        """The inverse of `table`, after JSON, too."""
        known = {item.name for item in fields(cls)}
        values: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in table.items() if key in known
        }
        values["flow"] = Flow(**table["flow"])
        return cls(**values)

    @property
    def sha256(self) -> str:
        """Of everything that decides what happens in it."""
        return hashlib.sha256(json.dumps(self.table(), sort_keys=True).encode()).hexdigest()
