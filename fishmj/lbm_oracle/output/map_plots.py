"""Pictures of force maps and drifts: PNG, one idea each."""

from collections.abc import Sequence
from math import degrees
from pathlib import Path

import numpy as np

from fishmj.errors import MissingExtra
from fishmj.mjcf.skin import posed, skin

COLOURS = ("#0B3C5D", "#328CC1", "#3A9D5D", "#D9902F", "#B3392F", "#7A4B94")
LABELS = (("drag", "drag [N]", "N"), ("lateral", "lateral force [N]", "N"), ("yaw", "yaw moment [N m]", "Nm"))
STYLE = {"font.size": 10, "axes.spines.top": False, "axes.spines.right": False, "axes.titlesize": 11}


def pyplot():
    try:
        import matplotlib
    except ModuleNotFoundError as error:
        raise MissingExtra("matplotlib", "dev", "pictures of the oracle") from error
    matplotlib.use("Agg")
    matplotlib.rcParams.update(STYLE)
    from matplotlib import pyplot

    return pyplot


def _save(figure, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    pyplot().close(figure)
    return path


def forces(rows: Sequence[dict], folder: Path) -> list[Path]:
    """One picture a map: drag, lateral force and yaw moment with standard errors against the angle, a line a speed."""
    plt, drawn = pyplot(), []
    for what, key, label in (("joint", "joint_deg", "joint angle [deg]"), ("aoa", "aoa_deg", "angle of attack [deg]")):
        here = sorted((row for row in rows if row["what"] == what), key=lambda row: row[key])
        if not here:
            continue
        figure, axes = plt.subplots(1, 3, figsize=(12, 3.8), layout="constrained")
        for i, speed in enumerate(sorted({row["speed"] for row in here})):
            line = [row for row in here if row["speed"] == speed]
            for axis, (name, title, unit) in zip(axes, LABELS, strict=True):
                x, y = [row[key] for row in line], [row[f"{name}_{unit}"] for row in line]
                error = np.nan_to_num([row[f"{name}_sem_{unit}"] for row in line])
                colour = COLOURS[i % len(COLOURS)]
                axis.errorbar(x, y, error, color=colour, marker="o", ms=3, lw=1.4, capsize=2, label=f"{speed:g} m/s")
                early = [row["status"] != "ok" for row in line]  # crossed: the run stopped before its time
                axis.plot(np.array(x)[early], np.array(y)[early], "x", color="#222222", ms=8)
                axis.set(xlabel=label, ylabel=title)
        for axis in axes:
            axis.axhline(0, color="#C9CED6", lw=0.8, zorder=0)
        held = "AoA 0 deg" if what == "joint" else f"joints {here[0]['joint_deg']:g} deg"
        axes[0].set_title(held, loc="left")
        axes[0].legend(frameon=False, fontsize=8)
        drawn.append(_save(figure, folder / f"forces_{what}.png"))
    return drawn


def outline(run) -> list[np.ndarray]:
    """The hull seen from above, one closed line (P, 2) m."""
    hull = skin(run.robot, spacing=0.01, around=4, smooth=True, details=False)
    rings = posed(hull, np.concatenate([run.pose[:3], run.angles()]))[:-2, :2].reshape(-1, 4, 2)
    return [np.concatenate([rings[:, 0], rings[::-1, 2]])]


def drifts(tracks: Sequence[np.ndarray], path: Path, title: str) -> Path:
    """Tracks (T, 4) of t s, x m, y m, heading rad: seen from above, and heading against time since release."""
    plt = pyplot()
    figure, (above, turn) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    for i, track in enumerate(tracks):
        colour = plt.get_cmap("viridis")(i / max(len(tracks) - 1, 1))
        above.plot(track[:, 1], track[:, 2], color=colour, lw=1)
        turn.plot(track[:, 0] - track[0, 0], np.degrees(track[:, 3]), color=colour, lw=1)
    above.set(xlabel="x [m]", ylabel="y [m]", title=title)
    above.set_aspect("equal", adjustable="datalim")
    for limit in (-degrees(2 * np.pi), degrees(2 * np.pi)):
        turn.axhline(limit, color="#B3392F", lw=0.8, ls="--")
    turn.set(xlabel="time since release [s]", ylabel="heading [deg]", title="dashed: one full turn")
    return _save(figure, path)


def swims(rows: Sequence[dict], path: Path, title: str) -> Path:
    """Speed of free swims against the slip ratio, a line a frequency and depth; the slip axis is stretched towards 1."""
    plt = pyplot()
    figure, axis = plt.subplots(figsize=(6, 4), layout="constrained")
    lines = sorted({(row["frequency"], row["depth"]) for row in rows})
    slips = sorted({row["slip"] for row in rows})
    for i, line in enumerate(lines):
        here = sorted((row for row in rows if (row["frequency"], row["depth"]) == line), key=lambda row: row["slip"])
        label = f"{line[0]:g} Hz" + (f", {line[1]:g} m deep" if len({depth for _, depth in lines}) > 1 else "")
        places, speeds = [slips.index(row["slip"]) for row in here], [row["speed_m_s"] for row in here]
        axis.plot(places, speeds, marker="o", ms=4, lw=1.4, color=COLOURS[i % len(COLOURS)], label=label)
    axis.set_xticks(range(len(slips)), [f"{slip:g}" for slip in slips])
    axis.set(xlabel="slip ratio, at the paper's grid", ylabel="speed [m/s]", ylim=(0, None))
    axis.set_title(title, loc="left")
    axis.legend(frameon=False, fontsize=8)
    return _save(figure, path)
