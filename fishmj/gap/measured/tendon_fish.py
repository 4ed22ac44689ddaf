"""Tendon-driven fish at four motor frequencies: three mean speeds fit the water, the fourth is predicted.

The markers give the fundamental of the tail's and the fin's angle. The simulated fish bends in the same way, and the mean speeds
are compared. The fit has one constant of the water, and optionally one term of the catalogue:

    min over grid of sum_three (log(speed / measured))^2
"""

from typing import NamedTuple

import numpy as np

from fishmj import effects
from fishmj.base.calib import read_toml, resolve
from fishmj.base.errors import LogError
from fishmj.gap.measured.folder import trials
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.records.records import Record, Sensor
from fishmj.log import Trial, stacked

HINGES = (2, 7)  # markers at which tail and fin begin; markers in between are sometimes swapped
SECONDS, STEADY = 20.0, 8.0  # s: length of a swim, and of its averaged end
STAMPS = np.arange(0.0, SECONDS, 0.02)  # s, of the simulated tank's sensors
SLOWEST = 0.2  # Hz, lowest beat frequency
MATCHING = 3  # iterations that adapt the commands until the joints follow the markers
WITHIN = 0.15  # largest relative error of a speed
TERMS = ("linear_surge_drag", "wake_memory")
FACTORS = np.geomspace(0.1, 4.0, 41)
AMOUNTS = {"linear_surge_drag": np.linspace(0.0, 0.2, 21), "wake_memory": np.linspace(0.0, 0.3, 11)}  # N s/m; s
ZOOMS = (0.25, 0.06)  # steps of the finer grids over those of the coarse one
CONSTANTS = ("trailing_edge", "added_mass_tail", "form_drag")
CHOSEN = ("trailing_edge", "linear_surge_drag")


class BeatResponse(NamedTuple):
    """Trial: frequency [Hz], complex amplitude of each joint [rad], mean speed [m/s]."""

    name: str
    frequency: float
    joints: np.ndarray
    speed: float


def beat(name: str, trial: Trial) -> BeatResponse:
    """Beat of one trial from the markers."""
    table = trial.table("markers")
    t = table["t"]
    points = np.stack([stacked(table, "p#x"), stacked(table, "p#y")], -1)  # (T, 9, 2)
    a, b = HINGES
    ahead = [points[:, i] - points[:, j] for i, j in ((0, 1), (a, b), (b, 8))]
    angles = [np.unwrap(np.arctan2(d[:, 1], d[:, 0])) for d in ahead]
    bends = np.stack([angles[1] - angles[0], angles[2] - angles[1]], 1)
    bends = np.angle(np.exp(1j * bends))
    bends = bends - bends.mean(0)
    frequency = peak(t, bends[:, 0])
    wave = np.exp(-2j * np.pi * frequency * t)
    track = points[:, :2].mean(1)  # the rigid head
    # the head sways with the beat, so the speed is the slope over all rows
    speed = float(np.hypot(*np.polyfit(t, track, 1)[0]))
    return BeatResponse(name, frequency, 2 * (bends * wave[:, None]).mean(0), speed)


def peak(t: np.ndarray, values: np.ndarray) -> float:
    """Frequency [Hz] of the sine that explains most."""
    rate = 1.0 / float(np.median(np.diff(t)))
    tried = np.arange(SLOWEST, min(5.0, 0.4 * rate), 0.01)
    window = np.hanning(len(t))
    return float(tried[np.argmax(np.abs(np.exp(-2j * np.pi * tried[:, None] * t) @ (window * values)))])


class Tank:
    """Simulated swims of `robot` with the beats of the trials and effects of `catalogue` in the water."""

    def __init__(self, beats: list[BeatResponse], catalogue=(), robot: str = "tendon_fish"):
        self.beats, self.plant = beats, SwimmingFish(robot, catalogue=catalogue)
        self.commands = np.array([b.joints for b in beats])
        for _ in range(MATCHING):
            bent = np.array([self._bent(b, joints) for b, joints in zip(beats, self._swim(self.plant.null), strict=True)])
            self.commands = self.commands * np.array([b.joints for b in beats]) / bent

    def speeds(self, rows) -> np.ndarray:
        """Mean speed (R, L) of every parameter row in every trial."""
        late = STAMPS >= SECONDS - STEADY
        poses = [each["pose"][:, late] for each in self.plant.predict(self.records, np.atleast_2d(rows))]
        slopes = [[np.polyfit(STAMPS[late], track[..., axis].T, 1)[0] for axis in (0, 1)] for track in poses]  # (L, 2, R)
        return np.array([np.hypot(*each) for each in slopes]).T

    @property
    def records(self) -> list[Record]:
        """Swims as records without measurements."""
        return [self._record(b, c) for b, c in zip(self.beats, self.commands, strict=True)]

    def _swim(self, row) -> list[np.ndarray]:
        """Joint angles (K, J) of every trial."""
        return [seen["joint"][0] for seen in self.plant.predict(self.records, row)]

    def _bent(self, b: BeatResponse, joints: np.ndarray) -> np.ndarray:
        """Complex amplitude of the joints over the last whole beats."""
        last = STAMPS >= SECONDS - round(STEADY * b.frequency) / b.frequency
        return 2 * (joints[last] * np.exp(-2j * np.pi * b.frequency * STAMPS[last])[:, None]).mean(0)

    def _record(self, b: BeatResponse, commands: np.ndarray) -> Record:
        dt = self.plant.dt
        t = np.arange(0.0, SECONDS, dt)
        ramp = np.minimum(t * b.frequency, 1.0)[:, None]
        wave = np.real(commands * np.exp(2j * np.pi * b.frequency * t)[:, None])
        none, size = np.full(3, np.nan), len(commands)
        return Record(
            name=b.name,
            excitation=b.name,
            replicate_of="",
            dt=dt,
            commands=ramp * wave,
            joint=Sensor(STAMPS, np.zeros((len(STAMPS), size)), none),
            pose=Sensor(STAMPS, np.zeros((len(STAMPS), 3)), none),
            power=None,
            flow=(0.0, 0.0),
            medium="water",
            place=np.zeros(3),
            start=np.zeros(3),
            push=np.zeros(3),
            joints=np.zeros(size),
            session=0.0,
        )


class CandidateModel(NamedTuple):
    """Model. errors: (L,) relative, of each trial predicted from the others; values: (L, 2) their factor and amount."""

    constant: str
    term: str
    errors: np.ndarray
    values: np.ndarray
    fitted: np.ndarray  # (2,) from all trials
    speeds: np.ndarray  # (L,) with it

    @property
    def worst(self) -> float:
        """Largest relative error of a trial left out."""
        return float(np.abs(self.errors).max())


def left_out(tank: Tank, measured: np.ndarray, constant: str, term: str = "") -> CandidateModel:
    """Predicts each trial from a fit to the others: the best of a grid, then of finer grids around it."""
    grid = np.array([(f, a) for f in FACTORS for a in (AMOUNTS[term] if term else np.zeros(1))])
    speeds = tank.speeds(rows_of(tank, constant, term, grid))
    every = np.ones(len(measured), bool)
    folds = [every & (np.arange(len(measured)) != i) for i in range(len(measured))]
    values, simulated = [], []
    for used in (*folds, every):
        best = int(np.argmin(squares(speeds, measured, used)))
        value, speed = grid[best], speeds[best]
        for zoom in ZOOMS:
            fine = closer(value, term, zoom)
            found = tank.speeds(rows_of(tank, constant, term, fine))
            best = int(np.argmin(squares(found, measured, used)))
            value, speed = fine[best], found[best]
        values.append(value)
        simulated.append(speed)
    errors = np.array([simulated[i][i] / measured[i] - 1.0 for i in range(len(measured))])
    return CandidateModel(constant, term, errors, np.array(values[:-1]), values[-1], simulated[-1])


def rows_of(tank: Tank, constant: str, term: str, grid: np.ndarray) -> np.ndarray:
    """Parameter rows (G, P) of (factor, amount) pairs."""
    plant = tank.plant
    rows = np.tile(plant.null, (len(grid), 1))
    rows[:, [c.name for c in plant.constants].index(constant)] = grid[:, 0]
    if term:
        effect = plant.active.effect(term)
        rows[:, plant.index(term, effect.parameters[0].name)] = grid[:, 1]
    return rows


def closer(value: np.ndarray, term: str, zoom: float) -> np.ndarray:
    """Grid around `value`, with `zoom` times the steps of the coarse one."""
    steps = zoom * np.arange(-4, 5)
    factors = value[0] * (FACTORS[1] / FACTORS[0]) ** steps
    amounts = np.maximum(value[1] + (AMOUNTS[term][1] * steps if term else 0.0 * steps[:1]), 0.0)
    return np.array([(f, a) for f in factors for a in np.unique(amounts)])


def squares(speeds: np.ndarray, measured: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Sum of squares (G,) over the used trials."""
    return np.sum(np.log(speeds[:, used] / measured[used]) ** 2, 1)


def run(say) -> tuple[str, dict]:
    """Text and figures of the set. The chosen model is also compared with the speeds of the description, another average."""
    beats = [beat(name, trial) for name, trial in trials("tendon_fish_markers").items()]
    if len(beats) < 2:
        raise LogError(f"tendon_fish: {len(beats)} trial, expected two at least: each is predicted from the others; add trials")
    said, figures = predicted(beats, say)
    known = read_toml(resolve("tendon_fish"))["measured"]["speed"]
    if len(known) != len(beats):
        return said, figures
    _, other = predicted([b._replace(speed=s) for b, s in zip(beats, known, strict=True)], choices=[CHOSEN])
    figures["against_description"] = {"speed": known, **other["choices"][0]}
    errors = ", ".join(f"{100 * e:+.1f}" for e in other["choices"][0]["errors"])
    return f"{said}\n  against the description's speeds ({', '.join(map(str, known))} m/s): left out {errors} %", figures


def predicted(beats: list[BeatResponse], say=lambda text: None, choices=None) -> tuple[str, dict]:
    """Predicts each trial from the others with each model (constant, term) of `choices`; the first model is the answer."""
    tank = Tank(beats, [effects.get(name) for name in TERMS])
    measured = np.array([b.speed for b in beats])
    before = tank.speeds(tank.plant.null)[0]
    found = []
    for constant, term in choices or [CHOSEN, *((c, t) for c in CONSTANTS for t in ("", *TERMS) if (c, t) != CHOSEN)]:
        found.append(left_out(tank, measured, constant, term))
        say(f"{constant} {term}: worst {found[-1].worst:.0%}")
    answer = found[0]
    figures = {
        "name": "tendon_fish",
        "origin": "measured",
        "frequency": [b.frequency for b in beats],
        "joint_amplitude_deg": [np.degrees(np.abs(b.joints)).tolist() for b in beats],
        "speed": measured.tolist(),
        "speed_before": before.tolist(),
        "choices": [
            {"constant": c.constant, "term": c.term, "errors": c.errors.tolist(), "worst": c.worst, "fitted": c.fitted.tolist()}
            for c in found
        ],
        "folds": answer.values.tolist(),
        "within": WITHIN,
        "holds": answer.worst <= WITHIN,
    }
    message = "within" if answer.worst <= WITHIN else "beyond"
    row = lambda values, form: ", ".join(format(v, form) for v in values)
    lines = [
        "tendon_fish",
        f"  {len(beats)} trials at {row([b.frequency for b in beats], '.2f')} Hz; measured {row(measured, '.3f')} m/s",
        f"  before any fit {row(before, '.3f')} m/s; limit for a trial left out: {WITHIN:.0%}",
        *(
            f"  {c.constant}{' and ' + c.term if c.term else ''}: left out {row(100 * c.errors, '+.1f')} %; on all: factor"
            f" {c.fitted[0]:.2f}" + (f", {c.term} {c.fitted[1]:.3g}" if c.term else "")
            for c in found
        ),
        f"{answer.constant} and {answer.term}: worst {answer.worst:.1%}, {message} the limit",
        f"  the model was chosen among these {len(found)} with all trials in view; four speeds do not name a term",
    ]
    return "\n".join(lines), figures
