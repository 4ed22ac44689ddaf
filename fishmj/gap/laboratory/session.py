"""Laboratory session: one trial per experiment, in order. The meta data do not reveal the hidden effects."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from fishmj.base.source import made_by
from fishmj.log import SCHEMA, excitation, numbered
from fishmj.log.excitation import Excitation

Effects = Mapping[str, Mapping[str, float]]  # hidden effects: name -> parameter -> value
CLOCKS = {"cmd": "host, sending", "joint": "host, reading", "pose": "camera, frame received", "power": "host, reading"}


def trial_name(index: int, excitation_id: str) -> str:
    """Name of the trial number `index` [from 0] of a session."""
    return f"{index + 1:02d}_{excitation_id}"


def experiments(asked: Iterable[str | Excitation], joints: int) -> Iterator[tuple[Excitation, int, str, str]]:
    """Yields (experiment, index, trial name, name of the repeated trial or ""); library experiments are for `joints` joints."""
    first: dict[str, str] = {}
    for index, item in enumerate(asked):
        what = excitation.get(item, joints) if isinstance(item, str) else item
        name = trial_name(index, what.id)
        yield what, index, name, first.get(what.id, "")
        first.setdefault(what.id, name)


def place_by_hand(what: Excitation, position: float, heading: float, rng: np.random.Generator, noise: float) -> np.ndarray:
    """Start (3,) x, y, yaw of a hand-placed fish. position [m], heading [rad]: standard deviations; noise: factor on them."""
    return np.array(what.start) + noise * rng.standard_normal(3) * np.array([position, position, heading])


def sent_commands(t: np.ndarray, commands: np.ndarray) -> dict:
    """Table `cmd`: commands (T, J) [rad] sent at t (T,) s."""
    return {"t": t, "seq": np.arange(len(t)), **numbered("c#", commands)}


def trial_meta(
    robot: str, water: str, what: Excitation, replicate_of: str, flow: tuple[float, float], *, sigma: Mapping[str, float],
    clock: Mapping[str, str], engine: str, source: str, notes: str, medium: str = "water", after: dict[str, dict] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Meta data of a synthetic trial. flow: speed [m/s] and direction [rad]; after: extra entries by the key that they follow."""
    usual = {
        "schema": SCHEMA,
        "origin": "synthetic",
        "robot": robot,
        "medium": medium,
        "water": water,
        "flow": {"speed": float(flow[0]), "direction": float(flow[1]), "known": True},
        "excitation": what.id,
        "replicate_of": replicate_of,
        "start": list(map(float, what.start)),
        "push": list(map(float, what.push)),
        "sigma": sigma,
        "clock": clock,
        "controller": "open loop",
        **made_by(engine),
        "source": source,
        "licence": "Apache-2.0",
        "notes": f"simulated{notes}; what is hidden in it is kept elsewhere",
    }
    return {name: entry for key, value in usual.items() for name, entry in {key: value, **(after or {}).get(key, {})}.items()}
