"""The slip calibration in one picture: each metric over the slip ratio, what was measured, and the profile J(s)."""

from pathlib import Path

import numpy as np

from fishmj.calibrate.fit_plots import DESIRED, MEASURED, SIMULATED, pyplot_of
from fishmj.calibrate.slip import COAST, RISE, WINDOW, Profile, profile

TICKS = (0.0, 0.002, 0.01, 0.02, 0.05, 0.2, 1.0)  # 1 - s
APART = 0.09  # of the axis, between two of them
TITLES = {"gait": "speed at 1 Hz [m/s]", "gait_slow": "speed at 0.5 Hz [m/s]", COAST: "coasting distance [m]"}
STYLES = {"gait": "-", "gait_slow": "--", COAST: ":"}
HIGHEST = 30.0  # J that is drawn
WORDS = (
    "Metrics of the solver's fish over the slip ratio (vermilion), what was measured (blue), and J above its least:"
    " all together (black) and each metric alone, thrust left free within its tolerance. Grey: the 90 % interval."
)


def draw(found: Profile, path: Path) -> Path:
    """Draw into a PNG. Raises MissingExtra without matplotlib."""
    pyplot = pyplot_of("calibrate slip --report")
    names = [name for name in WINDOW if name in found.predicted]
    figure, axes = pyplot.subplots(1, len(names) + 1, figsize=(3.3 * (len(names) + 1), 2.9), squeeze=False)
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
        axis.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    pyplot.close(figure)
    return path
