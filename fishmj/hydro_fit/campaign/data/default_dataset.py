"""Default segments of the bare `fishmj hydro_fit`: those at hand, else those that can be solved here.

| data set | here | solved segments |
|---|---|---|
| complete by its own plan | anything | none |
| incomplete | accelerator or Ray | the rest of its plan, in its own box |
| incomplete | CPU | the rest, if that takes `CPU_TIME` at most or --budget allows it |
| none | accelerator or Ray | the whole plan, in the existing model's domain, otherwise `collect.BOX` |
| none | CPU | a preview: the plan's first segments at one slip, in a small box, `PREVIEW_TIME` on two idle cores |

On a CPU --budget sets the number of segments of a preview; a budget for the whole plan solves the whole plan.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from fishmj.base import console, interrupt
from fishmj.base.cores import usable_cores
from fishmj.base.errors import ConfigError, DatasetError
from fishmj.base.store import Manifest, read_json
from fishmj.base.store.manifest import MANIFEST
from fishmj.hydro_fit.campaign.data import plan as plans
from fishmj.hydro_fit.campaign.data.collect import (
    BOX,
    ON_GPU,
    Local,
    Pool,
    collect,
    domain_there,
    missing,
    report,
    warn_of_cells,
)
from fishmj.hydro_fit.campaign.data.plan import CampaignPlan
from fishmj.hydro_fit.campaign.data.run_segments import Finished, Setup
from fishmj.hydro_fit.campaign.data.segment import Segment
from fishmj.hydro_fit.segment_dataset import PREVIEW, SPLIT, same_fish
from fishmj.lbm_oracle.fluid.device import accelerator, devices_of, several
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import LEAD, Domain, preset
from fishmj.lbm_oracle.run.spread import ray_device
from fishmj.lbm_oracle.run.stability import CLEARANCE
from fishmj.mjcf.description import Robot

PREVIEW_BOXES = ("laptop", "window_coarse")  # the first that holds the fish
# s of solving on so many idle cores, so that every machine has the same plan; whole campaigns on a CPU took 1.5 to 1.9 times
# the estimate (studies/fitted_water/NOTES.md), because it leaves out set-up and repeated ticks
PREVIEW_CORES, PREVIEW_TIME = 2, 1000.0
CPU_TIME = 1800.0  # s of wall clock that a CPU is given unasked


@dataclass(frozen=True, kw_only=True)
class Request:
    """Options of the command.

    folder: the data set, or None for `home`/<robot>. grid: domain of the existing model, or empty. budget: s of wall clock.
    slip: of a preview's segments.
    """

    robot: Robot
    home: Path
    folder: Path | None = None
    grid: str = ""
    device: str = "auto"
    ray: str = ""
    budget: float | None = None
    slip: float = plans.DEFAULT_SLIP
    seed: int = 0
    quiet: bool = False

    @property
    def solves_fast(self) -> bool:
        """Returns True if there is more than a CPU."""
        return bool(self.ray) or self.device.startswith("cuda") or (self.device == "auto" and accelerator())

    def setup(self, domain: Domain) -> Setup:
        """Set-up of the segments in a box."""
        return Setup(robot=self.robot, domain=domain, device=self.devices[0])

    @property
    def devices(self) -> tuple[str, ...]:
        """Devices of the tanks. Raises ConfigError for several devices with the workers of a Ray cluster."""
        if self.ray:
            return (ray_device(self.device),)
        return devices_of(self.device) if self.solves_fast or several(self.device) else ("cpu",)

    @property
    def pool(self) -> Pool:
        """Pool that runs the segments: on this machine, or on a Ray cluster."""
        tanks = ON_GPU if self.solves_fast else 1
        if not self.ray:
            return Local(tanks, self.devices)
        from fishmj.hydro_fit.campaign.data.ray_pool import RayPool

        return RayPool(self.ray, tanks=ON_GPU if self.device.startswith("cuda") else 1)


def segments_at_hand(asked: Request) -> Path:
    """Folder of the data set to fit, after solving the segments of the table above; prints a line for every decision.

    Raises ConfigError: the data set is of another fish, the fish fits no box, or the budget is too small for any fit.
    """
    robot, budget = asked.robot, asked.budget
    own = asked.folder or asked.home / robot.name
    small = asked.folder or asked.home / f"{robot.name}{PREVIEW}"
    if (own / SPLIT).is_file():
        return _continued(own, asked)
    whole, box = plans.full(robot, seed=asked.seed), preset(asked.grid or BOX)
    takes = solver_cost.cpu_seconds([(box, whole.water)])
    if (small / SPLIT).is_file() and not asked.solves_fast and (budget is None or budget < takes):
        return _continued(small, asked)
    console.say(f"no segments of {robot.name} in {own}; --data DIR names a data set that is elsewhere")
    if asked.solves_fast or (budget is not None and budget >= takes):
        console.say(f"solving the whole plan, {_size(whole)} in the box {box.name}")
        return _solve(whole, own, asked, box)
    console.say(
        f"the whole plan, {_size(whole)} in the box {box.name}, would take about {takes / 3600:.0f} hours"
        f" on {usable_cores()} cores, and no accelerator is used"
    )
    box = preview_box(robot)
    plan = preview(whole.at([asked.slip]), box, budget)
    takes = solver_cost.cpu_seconds([(box, plan.water)])
    console.say(
        f"solving a preview instead: {_size(plan)} in the box {box.name}, about {console.duration(takes)} on idle cores,"
        f" {console.duration(budget or CPU_TIME)} at most; --budget SECONDS makes it larger or smaller"
    )
    return _solve(plan, small, asked, box, limit=budget or CPU_TIME)


def preview(plan: CampaignPlan, box: Domain, budget: float | None = None, there: frozenset[str] = frozenset()) -> CampaignPlan:
    """First segments of a plan that can be solved in `PREVIEW_TIME` on two idle cores, or on this machine within a budget.

    Args:
        there: ids of segments that are already solved and cost nothing.
    Raises:
        ConfigError: the budget is too small for the smallest fit.
    """
    time, cores = (PREVIEW_TIME, PREVIEW_CORES) if budget is None else (budget, usable_cores())
    cost: Callable[[Segment], float] = lambda s: 0.0 if s.id in there else solver_cost.cpu_seconds([(box, s.water)], cores)
    needed = sum(map(cost, plans.least(plan.segments)))
    if needed > time and not there:
        raise ConfigError(
            f"--budget {time:g}: the least that a water can be fitted to, {len(plans.least(plan.segments))} segments, takes about"
            f" {needed:.0f} s here; give {needed * 1.2:.0f} or more, or --data DIR with segments that are there"
        )
    count, spent = 0, 0.0
    for segment in plans.spanning(plan.segments):
        spent += cost(segment)
        if spent > time:
            break
        count += 1
    return plan.first(count)


def preview_box(robot: Robot) -> Domain:
    """First of `PREVIEW_BOXES` in which the straight fish has its margin from every face at any heading.

    Raises ConfigError: it fits none of them.
    """
    for box in map(preset, PREVIEW_BOXES):
        wide = min(box.size[:2])
        if robot.length / 2 + LEAD * wide + CLEARANCE * box.dx <= wide / 2:
            return box
    raise ConfigError(
        f"{robot.name} is {robot.length:g} m long and fits none of the boxes {', '.join(PREVIEW_BOXES)} with its margin;"
        " collect its segments yourself (fishmj hydro_fit collect --domain paper) and name them with --data"
    )


def _continued(folder: Path, asked: Request) -> Path:
    """Existing data set, completed by its own plan as far as this machine can."""
    table, robot = read_json(folder / SPLIT), asked.robot
    if "plans" in table:
        same_fish(table.get("robot", {}), robot, folder)
    whole = (folder / MANIFEST).is_file() and not Manifest.read(folder).meta.get("missing", 0)
    rows = [row for row in table.get("plans", []) if not row["label"].startswith("on policy")]
    if not rows:
        return folder
    label, seed = rows[-1]["label"], rows[-1]["seed"]
    base, cut, _ = label.partition(", first ")
    if whole and not (cut and asked.budget is not None):
        console.say(f"{folder}: complete by its plan ({label}), nothing is solved")
        return folder
    plan, box = plans.planned(label, robot, seed), domain_there(folder)
    if cut and asked.budget is not None:
        all_of = plans.planned(base, robot, seed)
        there = frozenset(s.id for s in all_of.segments) - {s.id for s in missing(all_of, folder)}
        more = preview(all_of, box, asked.budget, there)
        plan = more if len(more.segments) > len(plan.segments) else plan
    left = missing(plan, folder)
    takes = solver_cost.cpu_seconds([(box, sum(segment.water for segment in left))])
    done = f"{folder}: {len(plan.segments) - len(left)} of {len(plan.segments)} segments are there"
    if left and not asked.solves_fast and asked.budget is None and takes > CPU_TIME:
        console.say(
            f"{done}; the rest would take about {console.duration(takes)} on {usable_cores()} cores, and no accelerator is used:"
            " going on with these, --budget SECONDS solves more"
        )
        return folder if (folder / MANIFEST).is_file() else _solve(plan, folder, asked, box, pool=_Nothing())
    console.say(f"{done}; solving the rest" if left else done)
    return _solve(plan, folder, asked, box, limit=asked.budget or (None if asked.solves_fast else CPU_TIME))


class _Nothing:
    """A pool that runs no segment: it turns the existing segments into a data set."""

    def run(self, waiting: deque[Segment], setup: Setup, go_on: Callable[[float], bool]) -> Iterator[Finished]:
        return iter(())


def _solve(
    plan: CampaignPlan, folder: Path, asked: Request, box: Domain, limit: float | None = None, pool: Pool | None = None
) -> Path:
    """Collects within `limit` s; finished segments are kept even after an error."""
    again = f"{folder} holds every segment that was finished; {interrupt.again()}"
    if pool is None:
        warn_of_cells(asked.robot, box)
        console.say(f"every finished segment is kept in {folder}: after Ctrl-C the same command goes on there")
    with interrupt.keeping(lambda: again):
        budget = limit if limit is not None else asked.budget
        found = collect(plan, folder, asked.setup(box), pool=pool or asked.pool, budget=budget, quiet=asked.quiet)
    report(found)
    if found.missing == found.segments:
        raise DatasetError(f"{folder}: no segment was finished in {console.duration(found.wall_s)}; the same command goes on")
    return folder


def _size(plan: CampaignPlan) -> str:
    return f"{len(plan.segments)} segments, {plan.water:.0f} s of water"
