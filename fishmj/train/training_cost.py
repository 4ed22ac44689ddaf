"""Estimate of a training run's cost before it starts: time from measured rates, memory from the sizes of its arrays.

    seconds = steps (1 / engine rate + operations per step / arithmetic rate)

Operations are those of the matrix products: 2 per weight in a forward pass, 6 forwards and backwards.
"""

from collections.abc import Sequence
from typing import Any

from fishmj.base import cost
from fishmj.base.cores import usable_cores
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import preset
from fishmj.mjcf.reading import load_robot
from fishmj.train.build import config_of, pick_engine, robot_for
from fishmj.train.settings import Settings
from fishmj.water.choice import LBM, residuals_of

CPU, GPU = "cpu", "gpu"
ENGINE = {  # control steps per second of one core, and of one H200 (`fishmj bench engine_...`; README)
    CPU: {"compiled": 395e3, "planar": 5e3, "batch": 4e3, "mjx": 650.0},
    GPU: {"compiled": 395e3, "planar": 46e6, "batch": 4e3, "mjx": 1e6},
}
LEARNT = {  # the same in a water with a learnt force; on a GPU with the batch of the preset `paper`
    CPU: {"compiled": 60e3, "planar": 1e3, "batch": 2.4e3, "mjx": 300.0},
    GPU: {"compiled": 60e3, "planar": 2.4e6, "batch": 2.4e3, "mjx": 0.8e6},
}
ARITHMETIC = {CPU: 27e9, GPU: 10e12}  # operations per second of one core and of one H200, from studies/training/NOTES.md


def agree(runs: Sequence[Settings], *, together: bool, yes: bool, devices: int = 1) -> None:
    """Asks the user before runs of more than a week or more memory than there is; without a terminal it raises TooMuch.

    Raises TooMuch: the user did not agree; UnknownName, ConfigError: an invalid setting.
    """
    estimated = [(s, c) for s in runs if hasattr(c := config_of(s), "operations") and hasattr(c, "bytes")]
    if not estimated:
        return  # the cost of the user's own algorithm is unknown
    needs = [config.bytes(widths(s), s.steps) * (len(runs) if together else 1) / devices for s, config in estimated]
    settings, config = estimated[needs.index(max(needs))]
    sizes = f"{config.envs:,} fish that see {settings.task.get('memory', 1)} observations"
    less = "take fewer --envs, a shorter --memory"
    cost.memory("train", max(needs), sizes, instead=less, flag="--yes", agreed=yes, there=_memory())
    if settings.engine == LBM:
        work = [(preset(s.solver["domain"]), s.steps * s.control_dt) for s, _ in estimated]
        asked: dict[str, Any] = {"instead": "take fewer --steps; --domain laptop is a preview", "flag": "--yes", "asked": yes}
        return solver_cost.agree("train", settings.solver["device"], work, tanks=config.envs, **asked)
    algorithms = ", ".join(dict.fromkeys(s.algo for s, _ in estimated))
    what = f"{sum(s.steps for s, _ in estimated):,.4g} control steps by {algorithms}"
    took = sum(seconds(s) for s, _ in estimated) / devices
    cost.time("train", took, what, instead="take fewer --steps", flag="--yes", agreed=yes)


def seconds(settings: Settings) -> float:
    """Estimated time of one run on this machine, s, without assessments."""
    kind = _kind()
    cores = usable_cores() if kind == CPU else 1
    work = config_of(settings).operations(widths(settings))
    engine = (LEARNT if residuals_of(robot_for(settings)) else ENGINE)[kind][pick_engine(settings)]
    return settings.steps * (1 / engine + work / ARITHMETIC[kind]) / cores


def widths(settings: Settings) -> tuple[int, int, int]:
    """Widths of an observation, of the policy's input, and of an action."""
    joints, memory = load_robot(settings.robot).n_joints, settings.task.get("memory", 1)
    seen = 5 + 2 * joints
    return seen, memory * seen + (memory - 1) * joints, joints


def machine() -> str:
    """Device of a training, `NVIDIA H100 80GB HBM3`, or the number of CPU cores."""
    import jax

    return f"{usable_cores()} CPU cores" if _kind() == CPU else jax.devices()[0].device_kind


def _kind() -> str:
    import jax

    return CPU if jax.default_backend() == "cpu" else GPU


def _memory() -> float | None:
    """Memory of the accelerator, bytes; None on a CPU."""
    import jax

    stats = {} if _kind() == CPU else jax.devices()[0].memory_stats() or {}
    return stats.get("bytes_limit")
