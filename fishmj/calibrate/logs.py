"""The trials that a calibration reads: sorted by signal, medium and repeat; what is missing is said in one line."""

from pathlib import Path
from typing import NamedTuple

from fishmj.calib import calib_folder
from fishmj.errors import LogError
from fishmj.gap.records import Record, Sensor, record_of
from fishmj.log import Trial
from fishmj.log.dataset import take

SIGNALS = ("sine", "square", "impulse")  # the paper's
MEDIA = ("air", "water")
FOLDER = Path("data") / "calib" / "trials"


def shipped() -> Path:
    """The trials of this checkout, or those of the installed package."""
    return FOLDER if FOLDER.is_dir() else calib_folder() / "trials"


class Logs(NamedTuple):
    """Trials by name, and their records at the plant's step. broken: trials that were left out, and why. notes: on the folder."""

    folder: Path
    trials: dict[str, Trial]
    broken: dict[str, str] = {}  # noqa: RUF012  never changed
    notes: tuple[str, ...] = ()

    def records(self, dt: float, names: "list[str] | None" = None) -> list[Record]:
        """Records of the named trials, or of all."""
        return [record_of(self.trials[name], dt)._replace(name=name) for name in (names or self.trials)]

    def of(self, medium: str, signals) -> list[str]:
        """Names of the trials of some signals in one medium, repeats together."""
        wanted = lambda t: t.value("medium", "water") == medium and t.value("excitation", "") in signals  # noqa: E731
        return [name for name, trial in self.trials.items() if wanted(trial)]

    def bench(self) -> list[str]:
        """Sine, square and impulse in both media.

        Raises:
            LogError: there is none, or the fish was never under load of the one or the other signal.
        """
        names = [name for medium in MEDIA for name in self.of(medium, SIGNALS)]
        if len(names) < 2:
            raise LogError(
                f"{self.folder}: {len(names)} trials of {', '.join(SIGNALS)}; a servo calibration needs at least two."
                " Record each in air and in water, three times (meta: excitation, medium)"
            )
        return names


def angles(record: Record) -> Sensor:
    """The measured joint angles. Raises LogError where there are none."""
    if record.joint is None:
        raise LogError(f"trial {record.name}: no table joint; a servo is calibrated by its angles")
    return record.joint


def read(folder: "str | Path") -> Logs:
    """All trials of a data set that can be read; what cannot be is in `broken`. Raises LogError, StoreError: none there."""
    found = take(folder)
    return Logs(Path(folder), found.trials, found.broken, found.notes)
