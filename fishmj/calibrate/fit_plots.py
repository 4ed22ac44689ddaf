"""The paper's overlay: desired, simulated and measured joint angles, one panel for each signal and medium."""

from pathlib import Path

import numpy as np

from fishmj import pages
from fishmj.calibrate.calibration_logs import MEDIA, SIGNALS, angles
from fishmj.calibrate.servo_fit import ServoFit
from fishmj.errors import MissingExtra
from fishmj.gap.records.records import Record, Sensor
from fishmj.store import write_text

DESIRED, SIMULATED, MEASURED = "#5B5B5B", "#D55E00", "#0072B2"  # Okabe and Ito 2008
SHOWN = {"sine": (3.6, 6.0), "square": (1.2, 3.2), "impulse": (1.4, 2.6)}  # s
JOINT = 1  # the middle one
FINE = 0.004  # s
WORDS = "Desired (dashed), measured (dots, every repeat) and simulated joint angle with the calibrated servo."


def pyplot_of(what: str):
    """matplotlib's pyplot without a display. Raises MissingExtra without matplotlib."""
    try:
        import matplotlib
    except ModuleNotFoundError as error:
        raise MissingExtra("matplotlib", "dev", what) from error
    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def draw(found: ServoFit, path: Path) -> Path:
    """Draw into a PNG. Raises MissingExtra without matplotlib."""
    pyplot = pyplot_of("calibrate servo --report")
    media = [m for m in MEDIA if any(r.medium == m for r in found.records)]
    signals = [s for s in SIGNALS if any(r.excitation == s for r in found.records)]
    figure, axes = pyplot.subplots(len(media), len(signals), figsize=(4.4 * len(signals), 2.7 * len(media)), squeeze=False)
    for row, medium in zip(axes, media, strict=True):
        for axis, signal in zip(row, signals, strict=True):
            repeats = [r for r in found.records if r.medium == medium and r.excitation == signal]
            if repeats:
                _panel(axis, found, repeats, SHOWN[signal])
                axis.set_title(f"RMS {rms(found, repeats):.2f} deg", fontsize=8, loc="right")
            axis.set_title(f"{signal}, {medium}", fontsize=10, loc="left")
            axis.spines[["top", "right"]].set_visible(False)
        row[0].set_ylabel(f"joint {JOINT + 1} [deg]")
    for axis in axes[-1]:
        axis.set_xlabel("t [s]")
    lines, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(lines, labels, frameon=False, fontsize=9, ncols=3, loc="upper center")
    figure.tight_layout(rect=(0, 0, 1, 0.95))
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    pyplot.close(figure)
    return path


def _panel(axis, found: ServoFit, repeats: list[Record], span: tuple[float, float]) -> None:
    """One signal in one medium, every repeat as dots, and the RMS that is left."""
    record = repeats[0]
    t = np.arange(*span, FINE)
    sent = np.arange(len(record.commands)) * record.dt
    axis.plot(t, np.degrees(np.interp(t, sent, record.commands[:, JOINT])), color=DESIRED, lw=1.2, ls="--", label="desired")
    for k, each in enumerate(repeats):
        seen = angles(each)
        now = (seen.t >= span[0]) & (seen.t <= span[1])
        axis.plot(
            seen.t[now], np.degrees(seen.values[now, JOINT]), ".", ms=2.5, color=MEASURED, label="measured" if k == 0 else None
        )
    fine = record._replace(
        joint=Sensor(t, np.zeros((len(t), record.commands.shape[1])), angles(record).sigma), pose=None, power=None
    )
    simulated = found.plant.predict([fine], found.row)[0]["joint"][0, :, JOINT]
    axis.plot(t, np.degrees(simulated), color=SIMULATED, lw=1.3, label="simulated")


def rms(found: ServoFit, records: list[Record]) -> float:
    """Of all joints over whole trials, deg."""
    predicted = found.plant.predict(records, found.row)
    squares = [np.mean((angles(r).values - p["joint"][0]) ** 2) for r, p in zip(records, predicted, strict=True)]
    return float(np.degrees(np.sqrt(np.mean(squares))))


def report(
    folder: Path, title: str, tables: dict[str, list[dict]], picture: Path | None, notes: list[str], words: str = WORDS
) -> Path:
    """One self-contained page: tables, and the picture where there is one, with `words` below it."""
    sections = [pages.Section(name, "", [pages.table(rows)]) for name, rows in tables.items()]
    if picture is not None:
        sections.append(pages.Section("", "", [pages.figure(picture.read_bytes(), words)]))
    return write_text(folder / "report.html", pages.report(title, title, sections, notes=notes))
