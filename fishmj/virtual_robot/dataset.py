"""Hidden effects on disk: a data set of trials, and its truth in another file.

The truth file is JSON with what was planted, the seed and the hash of the data set's manifest. It may not lie in the data set.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from fishmj.errors import ConfigError, UnknownName
from fishmj.log import Trial, measurements, write_dataset
from fishmj.store import sha256, write_json
from fishmj.virtual_robot import draws
from fishmj.virtual_robot.catalogue import CATALOGUE
from fishmj.virtual_robot.oddities import ODDITIES
from fishmj.virtual_robot.trials import EFFECTS

SCHEMA = "fishmj.truth/1"
LOTTERIES = {"random": CATALOGUE, "random_odd": ODDITIES}


def parse(texts: Iterable[str], seed: int) -> dict[str, dict[str, float]]:
    """What `--plant` says: `NAME`, `NAME=value` (main parameter), `NAME:p=1,q=2`, `random`, `random_odd`.

    Values that are not said are drawn from the seed at typical size; `NAME:p=1` leaves the other parameters at their nulls.

    Raises:
        UnknownName, ConfigError: no such effect or parameter, or no number.
    """
    effects: dict[str, dict[str, float]] = {}
    for position, text in enumerate(texts):
        rng = draws.stream(seed, "lottery", position)
        name, colon, list_ = text.partition(":")
        main = None
        if not colon:
            name, equals, value = text.partition("=")
            main = _number(text, value) if equals else None
        if name in LOTTERIES:
            name = str(rng.choice(sorted(set(LOTTERIES[name]) - set(effects))))
        if name not in EFFECTS:
            raise UnknownName("effect", name, [*EFFECTS, *LOTTERIES])
        effect = EFFECTS[name]
        if main is not None:
            effects[name] = {effect.parameters[0].name: main}
        elif colon:
            pairs = [pair.partition("=") for pair in list_.split(",")]
            effects[name] = {key.strip(): _number(text, value) for key, _, value in pairs}
        else:
            effects[name] = effect.draw(rng)
        effect.fields(effects[name])
    return effects


def write_hidden(
    folder: Path,
    truth: Path,
    trials: list[Trial],
    effects: Mapping,
    facts: Mapping,
    overwrite: bool = False,
    page: Mapping | None = None,
) -> None:
    """Write the data set, with a page of weighings if there is one, then its truth.

    Raises:
        ConfigError: as of `check_places`. StoreError: the disk refuses.
    """
    folder, truth = Path(folder), Path(truth)
    check_places(folder, truth, overwrite)
    if overwrite:
        (folder / measurements.FILE).unlink(missing_ok=True)  # of another robot
    named = {trial.name: trial for trial in trials}
    write_dataset(folder, named, meta={"origin": "synthetic"}, overwrite=overwrite, page=page)
    sealed = {
        "schema": SCHEMA,
        "origin": "synthetic",
        "effects": effects,
        **facts,
        "manifest_sha256": sha256(folder / "manifest.json"),
    }
    write_json(truth, sealed)


def check_places(folder: Path, truth: Path, overwrite: bool = False) -> None:
    """Whether data set and truth may be written there; asked before the trials are made.

    Raises:
        ConfigError: the truth would lie inside the data set, or one of the two is there already.
    """
    if truth.resolve().is_relative_to(folder.resolve()):
        raise ConfigError(f"--truth {truth} lies inside the data set {folder}; choose a file outside, or nothing stays hidden")
    if truth.exists() and not overwrite:
        raise ConfigError(f"--truth {truth} exists; choose another name or pass --overwrite")
    if folder.is_dir() and any(folder.iterdir()) and not overwrite:
        raise ConfigError(f"--out {folder} is not empty; choose another folder or pass --overwrite")


def _number(text: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise ConfigError(
            f"--plant {text}: {value!r} is no finite number; write NAME, NAME=0.03 or NAME:parameter=0.03,other=1 (SI)"
        )
    return number
