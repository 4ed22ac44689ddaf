"""Writes trials with hidden effects as a data set, and the truth to a separate file.

The truth file is JSON with the planted effects, the seed and the hash of the data set's manifest. It lies outside the data set.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.names import checked
from fishmj.base.store import Manifest, sha256, write_json
from fishmj.base.store.manifest import MANIFEST
from fishmj.gap.laboratory import random_streams
from fishmj.gap.laboratory.effect_text import check_range, finite_number, split_text
from fishmj.gap.laboratory.virtual_robot.catalogue import CATALOGUE, ODDITIES, EntryParameter
from fishmj.gap.laboratory.virtual_robot.trials import EFFECTS
from fishmj.log import Trial, measurements, write_dataset
from fishmj.log.trial_folder import META_FILE

SCHEMA = "fishmj.truth/1"
WIDEST, BELOW = 10.0, 0.2  # range of a value above its null, and below it if unsigned; times the largest typical size
Limits = Callable[[str, EntryParameter], tuple[float, float]]
OWN = re.compile(r"([^:=]+\.py|[A-Za-z_]\w*(\.[A-Za-z_]\w*)+):[A-Za-z_][\w.]*")  # an effect's name has no dot
INSTEAD = (
    "list it in a fish (docs/simulate/your_own_code.md) and make logs of that with fishmj evaluate --robot FISH.toml --effects,"
    " or, if it acts on what sensors report alone, put it on logs that are there: fishmj gap plant --generator log --from DATA"
)
EXAMPLE = "NAME, NAME=0.03 or NAME:parameter=0.03,other=1"
LOTTERIES = {"random": CATALOGUE, "random_odd": ODDITIES}


def parse(texts: Iterable[str], seed: int, limits: "Limits | None" = None) -> dict[str, dict[str, float]]:
    """Parses `NAME`, `NAME=value` (main parameter), `NAME:p=1,q=2`, `random`, `random_odd`.

    Missing values are drawn from the seed at typical size; `NAME:p=1` leaves the other parameters at their nulls.
    limits(name, parameter): (low, high) of a value; default, `bounds`.

    Raises:
        UnknownName: no such effect or parameter. ConfigError: no number, a value out of range, a repeated
            effect, or the user's own effect.
    """
    effects: dict[str, dict[str, float]] = {}
    for position, text in enumerate(texts):
        if own := own_reference(text):
            raise ConfigError(f"effect {own[:60]}: the second robot cannot hide it, with equations of its own; {INSTEAD}")
        rng = random_streams.stream(seed, "lottery", position)
        asked, (name, main, listed) = f"effect {text[:60]}", split_text(text)
        first = None if main is None else finite_number(asked, main, EXAMPLE)
        if name in LOTTERIES:
            left = sorted(set(LOTTERIES[name]) - set(effects))
            if not left or main is not None or listed is not None:
                raise ConfigError(f"{asked}: {name} draws effect and size, so give no value; {len(left)} effects are left")
            name = str(rng.choice(left))
        if name not in EFFECTS:
            raise UnknownName("effect", name[:60], [*EFFECTS, *LOTTERIES])
        if name in effects:
            raise ConfigError(f"{asked}: {name} is given twice; write all its parameters in one NAME:p=1,q=2")
        effect = EFFECTS[name]
        if first is not None:
            effects[name] = {effect.parameters[0].name: first}
        elif listed is not None:
            effects[name] = {key: finite_number(asked, value, EXAMPLE) for key, value in listed}
        else:
            effects[name] = effect.draw(rng)
        effect.fields(effects[name])
        for parameter in effect.parameters:
            value, (low, high) = effects[name].get(parameter.name, parameter.null), (limits or bounds)(name, parameter)
            check_range(asked, parameter.name, value, low, high, parameter.unit)
    return effects


def own_reference(text: str) -> str:
    """Returns the `package.module:Name` or `file.py:Name` that `text` begins with; "" for a plain name."""
    found = OWN.match(text)
    return found[0] if found else ""


def bounds(name: str, parameter: EntryParameter) -> tuple[float, float]:
    """Range of a planted value: the possible one, within WIDEST largest typical sizes of the null, BELOW under an unsigned 0."""
    size = max(abs(t - (0.0 if parameter.default else parameter.null)) for t in parameter.typical)
    below = WIDEST if parameter.signed or parameter.null else BELOW
    low, high = max(parameter.least, parameter.null - below * size), min(parameter.most, parameter.null + WIDEST * size)
    return low, high


def placed(folder: Path, truth: Path, names: Iterable[str], overwrite: bool) -> tuple[Path, Path]:
    """Checks the places of a data set and its truth; returns them as absolute paths.

    Raises ConfigError: an invalid name, an existing file, or a place inside another data set.
    """
    folder, truth = Path(folder).absolute(), Path(truth).absolute()
    checked(folder.resolve().name, "data set", "--out")
    if truth.is_dir():
        raise ConfigError(f"--truth {truth}: is a folder; name a file outside the data set")
    apart(folder, truth)
    if truth.exists() and not overwrite:
        raise ConfigError(f"--truth {truth} exists; choose another name or pass --overwrite")
    above = next((p for p in folder.resolve().parents if any((p / f).is_file() for f in (MANIFEST, META_FILE))), None)
    if above is not None:
        raise ConfigError(f"--out {folder} lies inside {above}, which is a data set or a trial; choose a folder outside")
    if not folder.exists() or not any(folder.iterdir()):
        return folder, truth
    if not overwrite:
        raise ConfigError(f"--out {folder} exists; choose another name or pass --overwrite")
    if not (folder / MANIFEST).is_file():
        raise ConfigError(f"--out {folder} is no data set, and --overwrite replaces only data sets; choose another folder")
    old = {str(Path(file).parent) for file in Manifest.read(folder).files if Path(file).name == META_FILE} - set(names)
    if old:
        held = f"{len(old)} trials that this run does not write ({', '.join(sorted(old)[:3])})"
        raise ConfigError(f"--out {folder} holds {held}; remove the folder, or choose another")
    return folder, truth


def apart(folder: Path, truth: Path) -> None:
    """Raises ConfigError if the truth lies inside its data set."""
    if truth.resolve().is_relative_to(folder.resolve()):
        raise ConfigError(f"--truth {truth} lies inside the data set {folder}; choose a file outside it")


def write_hidden(
    folder: Path, truth: Path, trials: list[Trial], effects: Mapping, facts: Mapping, overwrite: bool = False,
    page: Mapping | None = None,
) -> None:  # fmt: skip
    """Writes the data set, with the weighing table if given, then its truth.

    Raises ConfigError: the truth would lie inside the data set; StoreError: a file exists, or cannot be written.
    """
    folder, truth = Path(folder), Path(truth)
    apart(folder, truth)
    if truth.exists() and not overwrite:
        raise ConfigError(f"--truth {truth} exists; choose another name or pass --overwrite")
    if overwrite:
        (folder / measurements.FILE).unlink(missing_ok=True)  # that of another robot
    named = {trial.name: trial for trial in trials}
    write_dataset(folder, named, meta={"origin": "synthetic"}, overwrite=overwrite, page=page)
    sealed = {"schema": SCHEMA, "origin": "synthetic", "effects": effects, **facts}
    write_json(truth, sealed | {"manifest_sha256": sha256(folder / MANIFEST)})
