"""What every algorithm reports of the control steps that it took, in one definition for NumPy and JAX."""

from typing import Any, NamedTuple

from fishmj.calib import constant


class StepRecord(NamedTuple):
    """One control step of B fish, or a rollout of T, (T, B)."""

    reward: Any
    distance: Any  # m, at the end of the step
    late: Any  # bool, in the second half of the episode's time, where the way in is over
    done: Any  # bool, the episode ends for whatever reason
    terminated: Any  # bool, it left the tank
    diverged: Any  # bool, the episode was dropped


def record_of(after, limit: int) -> StepRecord:
    """Of the environment's state after a step; `limit` control steps are an episode's time."""
    done = after.terminated | after.truncated | after.diverged
    late = (after.count > limit // 2) & ~done
    return StepRecord(after.reward, after.distance, late, done, after.terminated, after.diverged)


def metrics_of(xp, r: StepRecord) -> dict:
    """Scalars: reward a step, distance and share of arrived in the late steps, share of ends outside, episodes ended, dropped."""
    late, ended = xp.maximum(r.late.sum(), 1), xp.maximum(r.done.sum(), 1)
    return {
        "reward": r.reward.mean(),
        "late_distance": xp.sum(xp.where(r.late, r.distance, 0.0)) / late,
        "late_arrived": xp.sum((r.distance < constant("protocol", "arrival_radius")) & r.late) / late,
        "left_tank": r.terminated.sum() / ended,
        "episodes": r.done.sum(),
        "diverged": r.diverged.sum(),
    }
