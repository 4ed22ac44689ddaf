"""Is a gap so large that no missing effect is meant by it? Other units, a sign, another frame, another robot: seen from the data.

    likely(e)     what each channel looks like against the model, in words: ratio of amplitudes, correlation, turn, offset
    admit(e)      stops a search of such a gap unless the user says that it is meant

One or two effects of the catalogue, at up to one and a half times their typical size, reach a gap of 1000 in nine of 1440 blind
sets of the benchmark (tethers, stiff skins, up to 18,946: docs/figures/gap/bench_2010.json, bench_2011.json). So a search stops
where a cause is recognised, from FAR on in one channel, and in any case from BEYOND on; docs/results/gap_benchmark.md says
how often that is wrong.
"""

from typing import NamedTuple

import numpy as np

from fishmj import console
from fishmj.errors import FishmjError
from fishmj.gap.search.likelihood import Likelihood

FAR, BEYOND = 1e3, 1e5  # mean squares over the floor: of the worst channel, of all
UNITS = {
    "joint": ((57.3, "degrees"),),
    "yaw": ((57.3, "degrees"),),
    "path": ((1000.0, "mm"), (100.0, "cm")),
    "power": ((1000.0, "mW"),),
}
NEAR = 1.35  # a ratio of amplitudes within this factor of a unit's is that unit
AGAINST, ALIKE, STILL = -0.6, 0.8, 0.1  # correlations; part of the model's amplitude
BENT, TURNED, AWAY = 0.35, 0.5, 0.5  # rad of a joint's mean, rad of a path's direction, m from where it was put
JUMP = 0.4  # rad between two frames, in a tenth of them
MOVES = {"joint": 0.02, "yaw": 0.05, "path": 0.05, "power": 0.2}  # rad, rad, m, W: less says nothing about a ratio


class TooDifferent(FishmjError):
    """Model and logs are so far apart that a search would only name what imitates the mistake."""

    def __init__(self, gap: float, channels: dict[str, float], causes: list[str]):
        parts = ", ".join(f"{name} {value:.3g}" for name, value in channels.items())
        super().__init__(f"the gap is {gap:.3g} times the floor (mean square; {parts}): too different to tell what is missing")
        self.gap, self.channels, self.causes = gap, channels, causes

    def plain(self) -> dict:
        """For JSON."""
        return {"reason": str(self), "gap": self.gap, "channels": self.channels, "causes": self.causes}


class Pair(NamedTuple):
    """One channel, measured and predicted, each record less its own mean; records end to end."""

    measured: np.ndarray
    predicted: np.ndarray
    offset: float  # mean of measured less predicted

    @property
    def ratio(self) -> float:
        """Of amplitudes."""
        return float(np.std(self.measured) / max(np.std(self.predicted), 1e-12))

    @property
    def correlation(self) -> float:
        scale = float(np.std(self.measured) * np.std(self.predicted))
        return float(np.mean(self.measured * self.predicted)) / scale if scale > 0 else 0.0


def admit(e: Likelihood, anyway: bool = False) -> None:
    """Let a search go on, or not. anyway: the user has said that such a gap is meant.

    Raises:
        TooDifferent: the gap is beyond BEYOND, or beyond FAR with a cause that is recognised, and nobody agreed to it.
    """
    gap, channels = e.gap(e.model.null)
    if anyway or max(gap, *channels.values()) <= FAR:
        return
    causes = likely(e)
    if not causes and gap <= BEYOND:
        return
    found = TooDifferent(gap, channels, causes or ["no usual cause is recognised; is it the data of this robot?"])
    if console.confirmed("\n".join([str(found), *(f"  {c}" for c in found.causes), "Search all the same?"])):
        return
    raise found


def likely(e: Likelihood) -> list[str]:
    """Likely causes, channel by channel."""
    predictions = e.model.predict(e.records, e.model.null)
    sets = [(r, p) for r, p in zip(e.records, predictions, strict=True)]
    joints = [pair(sets, "joint", i) for i in range(e.model.joints)]
    out = [text for i, p in enumerate(joints) for text in of_joint(i, p, joints)]
    yaw = pair(sets, "pose", 2)
    jump = max(
        (float(np.quantile(np.abs(np.diff(r.pose.values[:, 2])), 0.9)) for r in e.records if r.pose is not None), default=0
    )
    if jump > JUMP:
        out.append(f"heading: turns by {jump:.1f} rad from frame to frame: in degrees?")
    elif yaw is not None and moves(yaw, "yaw"):
        out += units("heading", yaw, "yaw")
        if yaw.correlation < AGAINST:
            out.append(f"heading: turns against the model (correlation {yaw.correlation:.2f}): a mirrored yaw or image")
    out += of_path(sets)
    power = pair(sets, "power", 0)
    return out + (units("power", power, "power") if power is not None and moves(power, "power") else [])


def pair(sets, sensor: str, column: int) -> Pair | None:
    """One column over all records that have it."""
    measured, predicted, offsets = [], [], []
    for record, prediction in sets:
        given = getattr(record, sensor)
        if given is not None and given.values.shape[1] > column:
            m, p = given.values[:, column], prediction[sensor][0][:, column]
            offsets.append(float(np.mean(m - p)))
            measured.append(m - m.mean())
            predicted.append(p - p.mean())
    if not measured:
        return None
    return Pair(np.concatenate(measured), np.concatenate(predicted), float(np.median(offsets)))


def moves(p: Pair, kind: str) -> bool:
    """Whether the model moves enough for a ratio to say something."""
    return float(np.std(p.predicted)) > MOVES[kind]


def units(name: str, p: Pair, kind: str) -> list[str]:
    """Whether the amplitudes have the ratio of two units."""
    for factor, unit in UNITS[kind]:
        for ratio, text in ((p.ratio, f"in {unit}"), (1 / max(p.ratio, 1e-12), f"divided by {factor:g} once too often")):
            if factor / NEAR < ratio < factor * NEAR:
                return [f"{name}: moves {p.ratio:.3g} times as far as the model: {text}?"]
    return []


def of_joint(i: int, p: Pair | None, joints: list) -> list[str]:
    """Unit, sign, order, zero, power."""
    name = f"joint {i + 1}"
    if p is None:
        return []
    if not moves(p, "joint"):
        return [f"{name}: {np.degrees(p.offset):.0f} deg off on average: its zero"] if abs(p.offset) > BENT else []
    out = units(name, p, "joint")
    if p.correlation < AGAINST:
        return [
            *out,
            f"{name}: runs against the model (correlation {p.correlation:.2f}): the sign of its angle or of its command",
        ]
    if out:
        return out
    if p.ratio < STILL:
        return [f"{name}: moves {p.ratio:.0%} of what it was told: unpowered, or another column"]
    across = [-1.0 if q is None or k == i else _across(p, q) for k, q in enumerate(joints)]
    if p.correlation < ALIKE < max(across) and max(across) > p.correlation + 0.2:
        return [f"{name}: follows the command of joint {int(np.argmax(across)) + 1}: the order of the joints"]
    return [f"{name}: {np.degrees(p.offset):.0f} deg off on average: its zero"] if abs(p.offset) > BENT else []


def _across(p: Pair, other: Pair) -> float:
    """Correlation of what one joint does with what another was predicted to do."""
    if len(p.measured) != len(other.predicted):
        return -1.0
    return p._replace(predicted=other.predicted).correlation


def of_path(sets) -> list[str]:
    """Unit, mirror, turn of the frame, and the place where the fish was put."""
    steps, away = [], []
    for record, prediction in sets:
        if record.pose is None:
            continue
        m, p = record.pose.values[:, :2], prediction["pose"][0][:, :2]
        steps.append((m - m[0], p - p[0]))
        away.append(float(np.hypot(*(record.start[:2] - record.place[:2]))))
    if not steps:
        return []
    measured, predicted = (np.concatenate([s[k] for s in steps]) @ np.array([1.0, 1.0j]) for k in (0, 1))
    far = max(away)
    origin = [f"position: the fish begins {far:.2g} m from where it was put: another origin of the frame"] if far > AWAY else []
    sizes = [float(np.sqrt(np.mean(np.abs(path) ** 2))) for path in (measured, predicted)]
    if sizes[1] < MOVES["path"]:
        return origin
    scaled = units("position", Pair(np.array([0.0, sizes[0]]), np.array([0.0, sizes[1]]), 0.0), "path")
    straight, mirrored = (
        np.mean(measured * np.conj(q)) / max(sizes[0] * sizes[1], 1e-12) for q in (predicted, np.conj(predicted))
    )
    out = scaled or origin
    if abs(mirrored) > ALIKE and abs(mirrored) > abs(straight) + 0.2:
        out.append(f"position: fits the model's mirror image (coherence {abs(mirrored):.2f} in place of {abs(straight):.2f})")
    elif abs(straight) > ALIKE and abs(np.angle(straight)) > TURNED:
        out.append(f"position: goes {np.degrees(np.angle(straight)):.0f} deg beside the model's path: a turned frame, or heading")
    return out
