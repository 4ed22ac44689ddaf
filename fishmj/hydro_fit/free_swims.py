"""Judges a fitted water by the flow solver's swims, on records outside every fit.

| figure | over | what |
|---|---|---|
| speed_error_mean, speed_error_max | straight gaits | speed along the body, settled: difference over the recorded one |
| yaw_rate_error_mean | gaits that turn by more than 5 deg/s | mean yaw rate, difference over the recorded one |
| yaw_drift_deg_s | straight gaits | mean yaw rate, difference |
| power_error_mean | gaits | servo power, difference over the recorded one (0.05 W at least) |
| thrust_error | held fish with moving joints | mean force along the links, difference over the tow drag at 0.3 m/s |
| freerun_position_error | gaits, from `began` on | distance between the fish after 10 s, m; shorter runs are not judged |
| coverage90 | all free swims | share of episode means inside the 90 % band, by channel |
| guard_rate | all free swims | share of steps outside the fitted range: only the base acts there |

A figure passes at or below max(stated, 2 x the solver's own repeatability), a coverage from 85 to 95 %. One outside cannot be
told where a true 90 % may give it by chance (exact binomial test, 5 %), as with few swims. Repeatability comes from the records
that repeat others with a nudged grid or a finer step, by the same measure.
"""

from collections.abc import Callable, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from fishmj.base.errors import DatasetError
from fishmj.hydro_fit.fit import prediction_interval
from fishmj.hydro_fit.fit.gauss_newton import flaps, thrusts, tow_drag
from fishmj.hydro_fit.fit.regression_rows import RegressionRows, attachment, base_force, rows_of
from fishmj.hydro_fit.fit.rollout import FishBatch, SwimTrack, SwimWindow, fish_batch_of, is_free, padded, recorded
from fishmj.hydro_fit.fit.training_windows import warm_up
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.mjcf.description import Robot
from fishmj.water.dynamics import planar_chain
from fishmj.water.hydro_model import HydroModel
from fishmj.water.prior import flat

SETTLED, FREERUN = 4.0, 10.0  # s
SHORTEST = 1.5  # s, of a free run, and before one
TURNS = np.radians(5.0)  # rad/s
SLOW, WEAK = 0.05, 0.05  # m/s, W: floors of relative errors
STATED = {
    "speed_error_mean": 0.03,
    "speed_error_max": 0.08,
    "yaw_rate_error_mean": 0.05,
    "yaw_drift_deg_s": 2.0,
    "power_error_mean": 0.10,
    "thrust_error": 0.10,
    "freerun_position_error": 0.15,
    "guard_rate": 0.05,
}
COVER = (0.85, 0.95)
GAITS = ("gait", "straight", "turning")


class FreeSwims:
    """All free swims of some records in a model, whole and from `SETTLED` on, with the ensemble's members."""

    def __init__(self, model: HydroModel, robot: Robot, records: Sequence[SegmentRecord]):
        swim = SwimWindow(planar_chain.chain_of(robot), model.swimmer(robot))
        self._swum(swim, robot, records, model)
        self.members = prediction_interval.of_members(swim, self.fleet, model.members, model.learnt)

    def _swum(self, swim: SwimWindow, robot: Robot, records: Sequence[SegmentRecord], model) -> None:
        """Does all swims and free runs of a water; model: its `base` and `learnt`."""
        self.records = [r for r in records if is_free(r)]
        ch, settled = planar_chain.chain_of(robot), round(SETTLED / records[0].tick)
        self.fleet = fish_batch_of(ch, robot, self.records, seconds=1e6)
        self.track = swim.run(self.fleet, flat(model.base), model.learnt)
        self.late, self.seen = (_from(self.fleet, track, settled) for track in (self.track, recorded(self.fleet)))
        self.cruise, self.cruise_track = self._freerun(ch, robot, swim, model)

    def freerun_error(self) -> tuple[float, int]:
        """(mean distance, m, from the recorded fish at the end of its free run, number of free runs)."""
        far = np.linalg.norm(self.cruise_track.q[..., :2] - self.cruise.q[:, 1:, :2], axis=-1)
        last = self.cruise.mask.sum(1).astype(int) - 1
        return float(far[np.arange(len(far)), last].mean()), len(far)

    def _freerun(self, ch, robot, swim, model) -> tuple[FishBatch, SwimTrack]:
        """Repeats the gaits for `FREERUN` s from a recorded state, with the water's memory filled by the record.

        They start at `SETTLED`, or earlier, but not before `SHORTEST`, if the shortest would have less than `FREERUN` s.
        """
        tick = self.records[0].tick
        chosen = [r for r in self.records if r.meta["block"] in GAITS and r.seconds >= 2 * SHORTEST]
        if not chosen:
            raise DatasetError(f"check: no gait of {2 * SHORTEST:g} s or more for a free run; collect the test part")
        self.began = min(SETTLED, max(SHORTEST, min(r.seconds for r in chosen) - FREERUN))
        skip = round(self.began / tick)
        rows = rows_of(ch, chosen)
        starts = np.array([span.start for span in rows.spans()]) + skip
        attached = attachment(rows, ch.strips, model.base, tick)[starts]
        memory = None if model.learnt is None else warm_up(ch, rows, model.base, model.learnt, tick).memory[starts]
        whole = fish_batch_of(ch, robot, chosen, seconds=1e6)
        stop = skip + round(FREERUN / tick)
        cut = lambda a: a[:, skip:stop]
        states = (whole.q[:, skip : stop + 1], whole.v[:, skip : stop + 1])
        fleet = FishBatch._make([*states, *(cut(a) for a in whole[2:-1]), whole.source])
        wide = padded(fleet, self.fleet)
        more, size = len(wide.q) - len(fleet.q), fleet.mask.shape[1]
        attached = np.concatenate([attached, np.full(more, 0.5)])
        if memory is not None:
            memory[:, -1] = 0.0
            memory = np.concatenate([memory, np.zeros((more, memory.shape[1]))])
        track = swim.run(wide, flat(model.base), model.learnt, attached, memory)
        count = len(fleet.q)
        return fleet, SwimTrack._make([*(a[:count, :size] for a in track[:3]), track.outside[:count]])


def _from(fleet: FishBatch, track: SwimTrack, first: int) -> dict[str, np.ndarray]:
    """Means of every swim from tick `first` on (the second half of a shorter one), (B,)."""
    out: dict[str, list] = {"surge": [], "yaw_rate": [], "power": []}
    for b, mask in enumerate(fleet.mask):
        stop = int(mask.sum())
        part = slice(min(first, stop // 2), stop)
        yaw, v = track.q[b, part, 2], track.v[b, part]
        out["surge"].append(float(np.mean(np.cos(yaw) * v[:, 0] + np.sin(yaw) * v[:, 1])))
        out["yaw_rate"].append(float(np.mean(v[:, 2])))
        out["power"].append(float(np.mean(track.power[b, part])))
    return {key: np.array(values) for key, values in out.items()}


def judge(
    model: HydroModel, robot: Robot, records: Sequence[SegmentRecord], repeats: Sequence[tuple[SegmentRecord, SegmentRecord]] = ()
) -> dict:
    """All figures of one model.

    Args:
        records: held-out ones at the model's slip ratio. repeats: pairs (repeat, original) of the solver's records.
    Returns:
        figures, tolerances, repeatability, passed by figure, n by figure, coverage90 by channel, ok.
    """
    swims = FreeSwims(model, robot, records)
    got, n = errors(swims, swims.late)
    held = [r for r in records if flaps(r)]
    got["thrust_error"], n["thrust_error"] = thrust_error(partial(model_force, model), robot, held), len(held)
    got["freerun_position_error"], n["freerun_position_error"] = swims.freerun_error()
    got["guard_rate"], n["guard_rate"] = float(swims.track.outside.mean()), len(swims.fleet.q)
    mean, seen = (prediction_interval.means(track, swims.fleet) for track in (swims.track, recorded(swims.fleet)))
    cover = prediction_interval.covered(mean, swims.members, seen, model.band)
    own = repeatability(robot, repeats) if repeats else {}
    tolerance = {key: max(stated, 2 * own.get(key, 0.0)) for key, stated in STATED.items()}
    ran = float(swims.cruise.mask.sum(1).min() * records[0].tick)
    told = [key for key in STATED if np.isfinite(got[key]) and (key != "freerun_position_error" or ran > FREERUN - 1e-6)]
    passed = {key: bool(got[key] <= tolerance[key]) for key in told}
    covers = [covers_as_stated(value, len(swims.fleet.q)) for value in cover.values()]
    passed |= {} if None in covers and False not in covers else {"coverage90": all(covers)}
    return {
        "model": model.name,
        "figures": got | {"coverage90": cover},
        "tolerances": tolerance | {"coverage90": list(COVER)},
        "repeatability": own,
        "n": n | {"coverage90": len(swims.fleet.q)},
        "freerun_s": ran,
        "passed": passed,
        "not_told": sorted({*STATED, "coverage90"} - set(passed)),
        "ok": all(passed.values()),
    }


def covers_as_stated(share: float, n: int) -> bool | None:
    """Verdict on the share of n swims inside the band; None if it is outside `COVER`, but may be so by chance."""
    from scipy.stats import binomtest

    chance = binomtest(round(share * n), n, prediction_interval.COVER).pvalue
    return True if COVER[0] <= share <= COVER[1] else None if chance >= 0.05 else False


def errors(swum: "FreeSwims | Any", late: dict[str, np.ndarray]) -> tuple[dict[str, float], dict[str, int]]:
    """Errors of the late means of gaits, and their numbers; nan if no record applies."""
    seen = swum.seen
    gait = np.array([r.meta["block"] in GAITS for r in swum.records])
    still = np.array([float(np.abs(r.flow).max()) < 1e-6 for r in swum.records])
    turning = gait & still & (np.abs(seen["yaw_rate"]) > TURNS)
    straight = gait & still & np.array([_bias(r) < 1e-6 for r in swum.records])
    speed = np.abs(late["surge"] - seen["surge"])[straight] / np.maximum(np.abs(seen["surge"][straight]), SLOW)
    yaw = np.abs(late["yaw_rate"] - seen["yaw_rate"])
    power = np.abs(late["power"] - seen["power"])[gait] / np.maximum(seen["power"][gait], WEAK)
    mean = lambda a: float(np.mean(a)) if len(a) else float("nan")
    figures = {
        "speed_error_mean": mean(speed),
        "speed_error_max": float(speed.max()) if len(speed) else float("nan"),
        "yaw_rate_error_mean": mean(yaw[turning] / np.maximum(np.abs(seen["yaw_rate"][turning]), TURNS)),
        "yaw_drift_deg_s": float(np.degrees(mean(yaw[straight]))),
        "power_error_mean": mean(power),
    }
    count = {"speed_error_mean": len(speed), "speed_error_max": len(speed), "yaw_rate_error_mean": int(turning.sum())}
    return figures, count | {"yaw_drift_deg_s": len(speed), "power_error_mean": int(gait.sum())}


def _bias(record: SegmentRecord) -> float:
    """Mean commanded bend after `SETTLED`, rad, sum over the joints; over whole beats the wave cancels."""
    drive = record.meta["segment"].get("drive", {})
    if "bias" in drive:
        return abs(float(drive["bias"]))
    late = record.command[min(round(SETTLED / record.tick), len(record.command) // 2) :]
    bend = abs(float(late.sum(1).mean()))
    return 0.0 if bend < 0.1 * float(np.abs(late).max() + 1e-9) else bend


def model_force(model: HydroModel, ch: planar_chain.Chain, rows: RegressionRows, tick: float) -> np.ndarray:
    """Force of the model, (3, N, M), with that of the acceleration."""
    force = base_force(rows, ch.strips, model.base, attachment(rows, ch.strips, model.base, tick))
    return force if model.learnt is None else force + warm_up(ch, rows, model.base, model.learnt, tick).force


def thrust_error(force_of: Callable, robot: Robot, held: Sequence[SegmentRecord]) -> float:
    """Mean error of the mean thrust of held fish, over the tow drag. force_of(chain, rows, tick): force of the model."""
    if not held:
        return float("nan")
    ch = planar_chain.chain_of(robot)
    rows = rows_of(ch, held)
    force = force_of(ch, rows, held[0].tick)
    return float(np.abs(thrusts(rows, force) - thrusts(rows, rows.force)).mean() / tow_drag(ch, robot))


def repeatability(robot: Robot, repeats: Sequence[tuple[SegmentRecord, SegmentRecord]]) -> dict[str, float]:
    """The same figures between the solver's own repeats: the limit of any agreement."""
    ch = planar_chain.chain_of(robot)
    out: dict[str, float] = {}
    free = [(a, b) for a, b in repeats if is_free(a) and len(a.q) == len(b.q)]
    if free:
        again, first = (fish_batch_of(ch, robot, [pair[i] for pair in free], seconds=1e6) for i in (0, 1))
        settled = round(SETTLED / free[0][0].tick)
        pair = SimpleNamespace(records=[b for _, b in free], seen=_from(first, recorded(first), settled))
        figures, _ = errors(pair, _from(again, recorded(again), settled))  # a repeat in the place of the model
        out |= {key: value for key, value in figures.items() if np.isfinite(value)}
    held = [(a, b) for a, b in repeats if flaps(a)]
    if held:
        force = [thrusts(r := rows_of(ch, [pair[i] for pair in held]), r.force) for i in (0, 1)]
        out["thrust_error"] = float(np.abs(force[0] - force[1]).mean() / tow_drag(ch, robot))
    return out
