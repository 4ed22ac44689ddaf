"""Where a fitted model goes: into its place only if it is not worse than what stands there."""

from pathlib import Path

from fishmj import console
from fishmj.errors import ConfigError, FishmjError
from fishmj.store import sha256
from fishmj.water.hydro_model import HydroModel


def promote(model: HydroModel, folder: Path, *, score: float, standing: float | None) -> tuple[Path, bool]:
    """Write `model` to `folder`, or beside it as `rejected-<hash>` when the standing model does better on the same validation.

    Args:
        score, standing: squared error of the validation swims of the new and of the standing model; None where there is none.
    Returns:
        (path of the TOML, whether the model took the place).
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


def standing_model(folder: Path, name: str, robot_sha256: str) -> HydroModel | None:
    """What stands in the place, if it is for the same robot and of the present form."""
    path = Path(folder) / f"{name}.toml"
    if not path.is_file():
        return None
    try:
        model = HydroModel.load(path)
    except ConfigError as error:
        console.warn(f"what stands in the place cannot be compared and will be replaced: {error}")
        return None
    return model if model.robot_sha256 == robot_sha256 else None
