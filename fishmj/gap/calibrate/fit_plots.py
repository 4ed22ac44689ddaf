"""Pictures and pages of a calibration.

servo   the paper's overlay: desired, simulated and measured joint angles, one panel for each signal and medium
water   speed and yaw rate of every swim, measured and simulated
slip    each metric over the slip ratio, what was measured, and the profile J(s)
"""

from pathlib import Path

import numpy as np

from fishmj.base import pages
from fishmj.base.figures import BLUE, GREY, VERMILION, canvas, save, style
from fishmj.base.store import write_text
from fishmj.gap.calibrate.calibration_logs import MEDIA, SIGNALS, angles
from fishmj.gap.calibrate.servo_fit import ServoFit
from fishmj.gap.calibrate.slip import COAST, RISE, WINDOW, Profile, profile
from fishmj.gap.calibrate.water_fit import WaterFit
from fishmj.gap.records.records import Record, Sensor

DESIRED, SIMULATED, MEASURED = GREY, VERMILION, BLUE
SHOWN = {"sine": (3.6, 6.0), "square": (1.2, 3.2), "impulse": (1.4, 2.6)}  # s
JOINT = 1  # the middle one
FINE = 0.004  # s
WORDS = "Desired (dashed), measured (dots, every repeat) and simulated joint angle with the calibrated servo."
TICKS = (0.0, 0.002, 0.01, 0.02, 0.05, 0.2, 1.0)  # 1 - s
APART = 0.09  # of the axis, between two of them
TITLES = {"gait": "speed at 1 Hz [m/s]", "gait_slow": "speed at 0.5 Hz [m/s]", COAST: "coasting distance [m]"}
STYLES = {"gait": "-", "gait_slow": "--", COAST: ":"}
HIGHEST = 30.0  # J that is drawn
WATER_WORDS = (
    "Speed and yaw rate of every swim, measured and simulated: in the water as it was described (grey), and in the calibrated"
    " water, each swim predicted by a fit to the other kinds (vermilion). On the dashed line both agree."
)
SLIP_WORDS = (
    "Metrics of the solver's fish over the slip ratio (vermilion), what was measured (blue), and J above its least:"
    " all together (black) and each metric alone, thrust left free within its tolerance. Grey: the 90 % interval."
)


@style()
def draw(found: ServoFit, path: Path) -> Path:
    """Draw into a PNG."""
    media = [m for m in MEDIA if any(r.medium == m for r in found.records)]
    signals = [s for s in SIGNALS if any(r.excitation == s for r in found.records)]
    figure, axes = canvas(len(media), len(signals), (4.4 * len(signals), 2.7 * len(media)), layout=None)
    for row, medium in zip(axes, media, strict=True):
        for axis, signal in zip(row, signals, strict=True):
            repeats = [r for r in found.records if r.medium == medium and r.excitation == signal]
            if repeats:
                _panel(axis, found, repeats, SHOWN[signal])
                axis.set_title(f"RMS {rms(found, repeats):.2f} deg", fontsize=8, loc="right")
            axis.set_title(f"{signal}, {medium}", fontsize=10, loc="left")
        row[0].set_ylabel(f"joint {JOINT + 1} [deg]")
    for axis in axes[-1]:
        axis.set_xlabel("t [s]")
    lines, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(lines, labels, frameon=False, fontsize=9, ncols=3, loc="upper center")
    figure.tight_layout(rect=(0, 0, 1, 0.95))
    return save(figure, path)


def _panel(axis, found: ServoFit, repeats: list[Record], span: tuple[float, float]) -> None:
    """Draws one signal in one medium, every repeat as dots, and the remaining RMS."""
    record = repeats[0]
    t = np.arange(*span, FINE)
    sent = np.arange(len(record.commands)) * record.dt
    axis.plot(t, np.degrees(np.interp(t, sent, record.commands[:, JOINT])), color=DESIRED, lw=1.2, ls="--", label="desired")
    for k, each in enumerate(repeats):
        seen = angles(each)
        now = (seen.t >= span[0]) & (seen.t <= span[1])
        label = "measured" if k == 0 else None
        axis.plot(seen.t[now], np.degrees(seen.values[now, JOINT]), ".", ms=2.5, color=MEASURED, label=label)
    joint = Sensor(t, np.zeros((len(t), record.commands.shape[1])), angles(record).sigma)
    fine = record._replace(joint=joint, pose=None, power=None)
    simulated = found.plant.predict([fine], found.row)[0]["joint"][0, :, JOINT]
    axis.plot(t, np.degrees(simulated), color=SIMULATED, lw=1.3, label="simulated")


def rms(found: ServoFit, records: list[Record]) -> float:
    """Root mean square error of all joints over whole trials, deg."""
    predicted = found.plant.predict(records, found.row)
    squares = [np.mean((angles(r).values - p["joint"][0]) ** 2) for r, p in zip(records, predicted, strict=True)]
    return float(np.degrees(np.sqrt(np.mean(squares))))


def report(
    folder: Path, title: str, tables: dict[str, list[dict]], picture: Path | None, notes: list[str], words: str = WORDS
) -> Path:
    """Writes one self-contained page: tables, and the picture if there is one, with `words` below it."""
    sections = [pages.Section(name, "", [pages.table(rows)]) for name, rows in tables.items()]
    if picture is not None:
        sections.append(pages.Section("", "", [pages.figure(picture.read_bytes(), words)]))
    return write_text(folder / "report.html", pages.report(title, title, sections, notes=notes))


@style()
def draw_water(found: WaterFit, path: Path) -> Path:
    """Draw into a PNG."""
    figure, axes = canvas(1, 2, (8.4, 3.9), layout=None)
    shown = (("as described", "#AAAAAA", found.before), ("calibrated, swim left out", SIMULATED, found.after))
    for axis, quantity, unit in zip(axes[0], ("speed", "yaw_rate"), ("m/s", "rad/s"), strict=True):
        made = "simulated" if quantity == "speed" else f"simulated_{quantity}"
        for label, colour, swims in shown:
            x, y = ([getattr(swim, key) for swim in swims] for key in (quantity, made))
            axis.plot(x, y, "o", ms=5, color=colour, label=label)
        ends = [f(*axis.get_xlim(), *axis.get_ylim()) for f in (min, max)]
        axis.plot(ends, ends, color=DESIRED, lw=0.8, ls="--")
        axis.set_xlabel(f"measured {quantity.replace('_', ' ')} [{unit}]")
        axis.set_ylabel(f"simulated [{unit}]")
    axes[0, 0].legend(frameon=False, fontsize=8)
    figure.tight_layout()
    return save(figure, path)


@style()
def draw_slip(found: Profile, path: Path) -> Path:
    """Draw into a PNG."""
    names = [name for name in WINDOW if name in found.predicted]
    figure, axes = canvas(1, len(names) + 1, (3.3 * (len(names) + 1), 2.9), layout=None)
    x = np.sqrt(1.0 - found.s)  # as wide near s = 1 as the speed changes there
    for axis, name in zip(axes[0], names, strict=False):
        axis.plot(x, found.predicted[name], color=SIMULATED, label="solver")
        axis.axhline(found.measured[name][0], color=MEASURED, lw=1.2, label="measured")
        axis.set_title(TITLES[name], fontsize=10, loc="left")
    axis = axes[0, -1]
    axis.plot(x, found.cost - found.cost.min(), color="black", lw=1.6, label="all")
    for name in names if len(names) > 1 else ():
        one = profile({name: found.measured[name]}, found.grid)
        axis.plot(np.sqrt(1.0 - one.s), one.cost - one.cost.min(), color=DESIRED, lw=1.0, ls=STYLES[name], label=name)
    axis.axhline(RISE, color=DESIRED, lw=0.6)
    axis.set_ylim(0, HIGHEST)
    axis.set_title("J(s) above its least", fontsize=10, loc="left")
    axis.legend(frameon=False, fontsize=8)
    axes[0, 0].legend(frameon=False, fontsize=8)
    ticks: list[float] = []
    for d in TICKS:  # those that fit beside each other
        if np.sqrt(d) <= x.max() + 0.01 and (not ticks or np.sqrt(d) - np.sqrt(ticks[-1]) > APART * x.max()):
            ticks.append(d)
    for axis in axes[0]:
        axis.axvspan(np.sqrt(1.0 - found.estimate.high), np.sqrt(1.0 - found.estimate.low), color="#DDDDDD", zorder=0)
        axis.set_xticks(np.sqrt(ticks), [f"{1 - d:g}" for d in ticks], fontsize=7)
        axis.set_xlabel("slip ratio s")
        axis.set_xlim(-0.02 * x.max(), 1.02 * x.max())
    figure.tight_layout()
    return save(figure, path)
