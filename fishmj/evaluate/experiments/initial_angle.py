"""Angle of attack: the fish starts on its target, turned by -180, -90, 0 or 90 deg from upstream, at 0.2 m/s."""

from collections.abc import Callable
from dataclasses import fields
from typing import ClassVar

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.figures import canvas, png, style
from fishmj.evaluate.experiments.experiment_figures import compared, counted, figures_row, read, series_row
from fishmj.evaluate.experiments.paper_experiment import ExperimentFindings, ExperimentPart, ExperimentSetup, PaperExperiment, Row
from fishmj.evaluate.plots import COLOURS, FAINT, INK, STYLE
from fishmj.evaluate.protocol import ANGLE, Trials
from fishmj.mjcf.description import Robot
from fishmj.tasks.station_hold import mirror_signs


class MirroredTrials(Trials):
    """Trials without turbulence, mirror images of other trials about the stream: start, joint zeros and noise."""

    drawn_as: ClassVar[str] = "mirrored"

    @classmethod
    def of(cls, some: Trials) -> "MirroredTrials":
        """Mirror images of trials, with the same draws."""
        known = {field.name: getattr(some, field.name) for field in fields(Trials)}
        return cls(**known | {"items": tuple(item._replace(los=-item.los) for item in some.items)})

    def fish(self, robot: Robot):
        """Randomised fish of the originals with their joint zeros negated."""
        params, camera = super().fish(robot)
        return params._replace(zero=-params.zero), camera

    def sensor_noise(self, robot: Robot, steps: int) -> np.ndarray:
        """Noise of the originals, mirrored."""
        return super().sensor_noise(robot, steps) * mirror_signs(robot.n_joints)


def parts(setup: ExperimentSetup) -> list[ExperimentPart]:
    """Trials in turbulence, and pairs of mirrored trials without."""
    row = lambda result: figures_row(result) | series_row(result)
    calm = setup.trials(task=ANGLE, repeats=setup.of(8, 2), turbulence="none")
    return [
        setup.part("turbulent", setup.policy, setup.trials(task=ANGLE, repeats=setup.of(16, 6)), row),
        setup.part("calm", setup.policy, calm, row),
        setup.part("mirrored", setup.policy, MirroredTrials.of(calm), row),
    ]


def asymmetry(one: Row, other: Row) -> np.ndarray:
    """RMS distance (n,) m between tracks and the mirror images of others."""
    off = [read(one[key]) - sign * read(other[key]) for key, sign in (("upstream", 1), ("side", -1))]
    square = off[0] ** 2 + off[1] ** 2
    return np.sqrt(over_known(np.nanmean, square.T))


def over_known(middle: Callable, values: np.ndarray) -> np.ndarray:
    """`middle` (such as np.nanmedian) over axis 0 of (n, m) values; NaN where no row has one."""
    found, there = np.full(values.shape[1], np.nan), np.isfinite(values).any(0)
    found[there] = middle(values[:, there], 0)
    return found


def findings(setup: ExperimentSetup, rows: dict[str, Row]) -> ExperimentFindings:
    """Settling times by angle, and the difference of mirrored pairs."""
    row, limit = rows["turbulent"], constant("experiments", "aoa_converge")
    angles, times = np.array(row["los"]), read(row["figures"]["settling_time"])
    found = [
        compared(f"settling time from {angle:d} deg", f"about {limit:g} s", times[angles == angle], "s", digits=1, median=True)
        for angle in np.unique(angles)
    ]
    found.append(counted("trials that settle", "all", row["figures"]["settled"]))
    found.append(counted("trials that leave the tank", "none", np.arange(len(angles)) < row["left"]))
    off = asymmetry(rows["calm"], rows["mirrored"])
    found.append(compared("distance between mirrored tracks, RMS", "symmetric", off, "m"))
    apart = read(rows["calm"]["figures"]["settling_time"]) - read(rows["mirrored"]["figures"]["settling_time"])
    found.append(compared("difference of settling times, mirrored pairs", "symmetric", apart, "s"))
    return ExperimentFindings(
        found, [(picture(row), "Distance to the target, and tracks seen from it, from the dot to the crosses; upstream is up.")]
    )


@style(STYLE)
def picture(row: Row) -> bytes:
    """Distance over time and tracks, one panel for each angle."""
    angles, t = np.array(row["los"]), read(row["t"])
    every = np.unique(angles)
    figure, axes = canvas(2, len(every), (3.4 * len(every), 6.4))
    for k, (angle, colour) in enumerate(zip(every, COLOURS, strict=False)):
        some, (above, below) = angles == angle, axes[:, k]
        distance = read(row["distance"])[some]
        above.plot(t, distance.T, color=colour, linewidth=0.5, alpha=0.5)
        above.plot(t, over_known(np.nanmedian, distance), color=colour, linewidth=2.2)
        above.axhline(constant("protocol", "arrival_radius"), color=FAINT, linewidth=1)
        above.set(title=f"{angle:d} deg", xlabel="time [s]", ylim=(0, None), ylabel="distance [m]" if k == 0 else "")
        below.plot(-read(row["side"])[some].T, read(row["upstream"])[some].T, color=colour, linewidth=0.8, alpha=0.7)
        below.plot(0, 0, "o", color=INK, markersize=5)
        below.plot(-read(row["side"])[some, -1], read(row["upstream"])[some, -1], "x", color=INK, markersize=6)
        below.set(xlim=(-1, 1), ylim=(-1.6, 0.4), aspect="equal", xlabel="right [m]", ylabel="upstream [m]" if k == 0 else "")
    return png(figure)


EXPERIMENT = PaperExperiment(
    ANGLE,
    "15, initial angles of attack",
    "starts on the target at four angles to the stream, with mirrored pairs",
    "none of it",
    parts,
    findings,
)
