"""Evaluation on the workers of a Ray cluster: each evaluates a controller over all trials, with the results of one machine.

Trials of a controller are not split, because engines and networks may round differently in a smaller batch.
"""

from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

from fishmj import engines
from fishmj.base.ray_cluster import RayCluster, RayTask, report
from fishmj.evaluate.metrics import Result
from fishmj.evaluate.protocol import Trials
from fishmj.evaluate.run_trials import run
from fishmj.mjcf.description import Robot

if TYPE_CHECKING:
    from fishmj.engines.hybrid import HybridOptions

ON_CPU = ("batch", "compiled")  # engines that use no GPU


def with_corrections(engine: Any, robot: Robot, trials: Trials, hybrid: "HybridOptions | None") -> Any:
    """Engine whose water the flow solver corrects, if `hybrid` is given."""
    if hybrid is None:
        return engine
    from fishmj.engines.hybrid.engine import HybridEngine

    return HybridEngine(robot, trials.flows()[0], hybrid, inner=engine)


def judge_over_ray(
    address: str,
    brains: list,
    robot: Robot,
    trials: Trials,
    engine: str,
    hybrid: "HybridOptions | None" = None,
    progress: Callable[[float], None] = lambda done: None,
) -> Iterator[tuple[Any, Result]]:
    """Yields controllers and results as workers finish them.

    Args:
        engine: its name. hybrid: schedule of its corrections. progress: called with simulated seconds, summed over everything.

    Raises ConfigError: no such cluster; or, after all other results, controllers that no worker finished. Errors as `run`.
    """
    cluster, done = RayCluster(address), 0
    each = trials.duration * len(trials)
    tasks = deque(RayTask(brain.name, brain) for brain in brains)
    work = partial(judge_controllers, robot=robot, trials=trials, engine=engine, hybrid=hybrid)
    device = hybrid.device if hybrid is not None else "cpu" if engine in ON_CPU else "auto"

    def show_progress(under_way: float) -> bool:
        if done < len(brains):
            progress(done * each + under_way)
        return True

    for task, found in cluster.spread(work, tasks, device=device, go_on=show_progress):
        done += 1
        progress(done * each)
        yield task.given, found._replace(robot=robot, trials=trials)
    cluster.check()


def judge_controllers(
    tasks: list[RayTask], robot: Robot, trials: Trials, engine: str, hybrid: "HybridOptions | None"
) -> Iterator[tuple[str, Result]]:
    """Yields names and results of controllers in a worker."""
    step = robot.timing.control_dt * len(trials)
    for name, brain in tasks:
        made = with_corrections(engines.make(engine, robot), robot, trials, hybrid)
        yield name, run(brain, robot, trials, made, progress=lambda k: report(k * step))
