"""The same campaign on many machines, by the workers of a Ray cluster (`base.ray_cluster`); only the caller writes files.

collect(plan, out, setup, pool=RayPool("auto"))            the cluster that this machine belongs to
collect(plan, out, setup, pool=RayPool("local:2"))         two workers here
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib import import_module

from fishmj.base.ray_cluster import RayCluster
from fishmj.hydro_fit.campaign.data.run_segments import Finished, Setup
from fishmj.hydro_fit.campaign.data.segment import Segment

RUNNER = "fishmj.hydro_fit.campaign.data.run_segments:on_device"


@dataclass
class RayPool(RayCluster):
    """Workers of a Ray cluster. tanks: segments side by side in one worker. runner: module:function like `on_device`."""

    tanks: int = 1
    runner: str = RUNNER

    def run(self, waiting: deque[Segment], setup: Setup, go_on: Callable[[float], bool]) -> Iterator[Finished]:
        """Yields finished segments as `run_segments.on_device`; errors as `spread`."""
        seen = replace(setup, device="cuda") if setup.device.startswith("cuda") else setup  # a worker sees only its own
        swum = self.spread(f"{__name__}:swim", waiting, seen, self.runner, device=setup.device, group=self.tanks, go_on=go_on)
        for segment, (meta, arrays) in swum:
            yield Finished(segment, meta, arrays)


def swim(segments: list[Segment], setup: Setup, runner: str) -> list[tuple[dict, dict]]:
    """Metadata and arrays of segments, side by side in a worker."""
    module, _, name = runner.partition(":")
    done = getattr(import_module(module), name)(deque(segments), setup.device, setup=setup, tanks=len(segments))
    made = {item.segment.id: (item.meta, item.arrays) for item in done}
    return [made[segment.id] for segment in segments]
