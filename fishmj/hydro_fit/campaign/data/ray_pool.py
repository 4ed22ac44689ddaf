"""The same campaign on many machines, by the workers of a Ray cluster (`base.ray_cluster`); only the caller writes files.

collect(plan, out, setup, pool=RayPool("auto"))            the cluster that this machine belongs to
collect(plan, out, setup, pool=RayPool("local:2"))         two workers here
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

from fishmj.base.ray_cluster import RayCluster, report
from fishmj.hydro_fit.campaign.data.run_segments import Finished, Setup, on_device
from fishmj.hydro_fit.campaign.data.segment import Segment


@dataclass
class RayPool(RayCluster):
    """Workers of a Ray cluster. tanks: segments side by side in one worker. runner: such as `on_device`."""

    tanks: int = 1
    runner: Callable[..., Iterator[Finished]] = on_device

    def run(self, waiting: deque[Segment], setup: Setup, go_on: Callable[[float], bool]) -> Iterator[Finished]:
        """Yields finished segments as `run_segments.on_device`; errors as `spread`."""
        work = partial(swim, setup=setup, runner=self.runner)
        for _, found in self.spread(work, waiting, device=setup.device, group=self.tanks, go_on=go_on):
            yield found


def swim(segments: list[Segment], setup: Setup, runner: Callable[..., Iterator[Finished]]) -> Iterator[tuple[str, Finished]]:
    """Yields ids and finished segments, which swim side by side in a worker."""
    for found in runner(deque(segments), setup.device, report, setup=setup, tanks=len(segments)):
        yield found.segment.id, found
