"""Cases of the flow solver: its data sets, some with a hidden effect, and null sets of its own fish.

    data/gap/lbm/nulls/<name>.npz        nothing hidden            `RecordedNull` without the searched set
    data/gap/lbm/planted/<name>.npz      an effect each
    data/gap/lbm/truth.json              {name: {"effects": {..}, "seed": ..}}, opened here only

The search uses the model in the water that was fitted to the solver. The second robot, with and without the effect, gives the
size of a hidden effect (`true_gap`): the same constants and servos in another water.
"""

from functools import cache
from pathlib import Path
from typing import NamedTuple

from fishmj.base.calib import calib_folder
from fishmj.base.errors import StoreError
from fishmj.base.store import read_json
from fishmj.base.store.manifest import SOURCES
from fishmj.engines import in_water
from fishmj.gap.bench.cases import BenchCase
from fishmj.gap.null.null_runs import RecordedNull, SimulatedNull, trials_of
from fishmj.log import Trial
from fishmj.mjcf.reading import load_robot

WATER = "swift-base"


class SolverCase(NamedTuple):
    """A case with its data, and a null without them."""

    case: BenchCase
    trials: list[Trial] | None  # None: the second robot makes them
    null: SimulatedNull

    @property
    def id(self) -> str:
        """Id of the case."""
        return self.case.id


def folder() -> Path:
    """Folder of the shipped data sets."""
    return calib_folder().parent / "gap" / "lbm"


@cache
def plant():
    """The fish in the water fitted to the solver."""
    from fishmj.gap.models.swimming_fish import SwimmingFish

    return SwimmingFish(in_water(load_robot("fish"), WATER))


def draw(where: Path | None = None) -> list[SolverCase]:
    """Every data set as a case, with all of its experiments.

    Raises StoreError: the planted sets are not here, as in an installed package; a data set without its truth, or a truth without
    a set.
    """
    where = where or folder()
    if not (where / "planted").is_dir():
        raise StoreError(f"{where}: no folder `planted`: the solver's cases are not in the installed package, only {SOURCES}")
    truth = read_json(where / "truth.json")
    paths = {path.stem: path for part in ("nulls", "planted") for path in sorted((where / part).glob("*.npz"))}
    if odd := set(paths) ^ set(truth):
        raise StoreError(f"{where}: data sets and truth.json differ: {', '.join(sorted(odd)[:5])}; fetch the folder again")
    out = []
    for name, path in paths.items():
        trials, told = list(trials_of(path)), truth[name]
        logs = tuple(str(trial.value("excitation")) for trial in trials)
        kind = {0: "none", 1: "single"}.get(len(told["effects"]), "pair")
        case = BenchCase(name, kind, told["effects"], 1.0, logs, int(told["seed"]))
        out.append(SolverCase(case, trials, RecordedNull(folder=where / "nulls", without=(name,))))
    return out
