"""Identity of a robot's water, for the header of a policy and the comparison in an evaluation."""

from collections.abc import Mapping
from hashlib import sha256

from fishmj.base import calib
from fishmj.base.store import json_sha256, plain
from fishmj.mjcf.description import Robot
from fishmj.water.choice import STRUCTURED, family_of, label, model_of


def water_identity(robot: Robot) -> dict[str, str]:
    """Water of a robot as names and one hash.

    Returns:
        {"name", "kind"} and, for fitted or stated coefficients, "sha256": of the coefficients of kind `structured`, of
        coefficients and weights of kind `fitted`, or `base` without the learnt residual; of all members of kind `family`.
    Raises:
        UnknownName, StoreError, ConfigError: there is no such fitted water, or its file cannot be read.
    """
    name, model = label(robot), model_of(robot)
    if (family := family_of(name)) is not None:
        return {"name": family.name, "kind": "family", "sha256": family.sha256}
    share = robot.water.get("residual")
    if model is not None:
        return {
            "name": model.name.replace("#", "."),
            "kind": "base" if model.learnt is None else "fitted",
            "sha256": model.sha256
            if share in (None, model.base.residual)
            else sha256(f"{model.sha256} {share}".encode()).hexdigest(),
        }
    if name != STRUCTURED:
        return {"name": name, "kind": name}
    table = {key: value for key, value in robot.water.items() if key not in ("model", "own") and value is not None}
    return {"name": name, "kind": STRUCTURED, "sha256": json_sha256(plain(table))}


def members_of(water: Mapping[str, str]) -> list[dict[str, str]]:
    """Identities of the members of a family that comes with fishmj with the same hash; [] for any other water."""
    known = water["kind"] == "family" and water["name"] in calib.families()
    if not known or (family := family_of(water["name"])) is None or family.sha256 != water.get("sha256"):
        return []
    return [{"name": member.name, "kind": "fitted", "sha256": member.sha256} for member in family.members]
