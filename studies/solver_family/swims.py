"""Swims a plan in the solver, and makes data sets of the swims.

    swum_all(plan, folder, "cuda", tanks=12)      the missing swims, in several tanks; each is written to disk when it is done
    finished(plan, folder) -> lost                data sets of the complete robots, and the visible size of each effect

    FOLDER/plan.json                          models, robots, hidden effects: opened by the score, never by a search
    FOLDER/swims/SET/NAME.npz                 one swim: with its sensors' noise, and without
    FOLDER/sets/ROBOT-free.npz, CASE.npz      free swims for a calibration; a session
    FOLDER/truth.json                         {case: {"effects", "detectable"}}

A swim without a sound part, or that could not begin, leaves NAME.json with the reason.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from fishmj.base import console
from fishmj.base.errors import OracleUnstable
from fishmj.base.store import write_json
from fishmj.gap.bench import calibrated, families
from fishmj.gap.bench.cases import BenchCase
from fishmj.gap.bench.drawn_robots import number_of
from fishmj.gap.bench.family_rows import APART
from fishmj.gap.bench.solver_plan import FREE, SETS, TRUTH, FamilyPlan, PlannedRobot
from fishmj.gap.laboratory.hidden_lbm.hidden import HiddenRun, Job, OwnedJobs, jobs, run_jobs, trial_of
from fishmj.lbm_oracle.fluid.device import devices_of
from fishmj.lbm_oracle.run.spread import GoOn, Waiting, spread
from fishmj.log import Trial, excitation
from fishmj.log.dataset import read_bundle, write_bundle
from fishmj.log.excitation import Excitation
from fishmj.mjcf.description import Robot
from studies.solver_family import solver_detectability
from studies.solver_family.family_plan import session, swims
from studies.solver_family.launches import steadied

SWIMS = "swims"  # folder of what was swum
BARE = "-without_noise"  # of a trial's name
FIRST_FREE = 100  # place of the first free swim, beyond those of the designed experiments


class PlannedSwim(NamedTuple):
    """One swim of a plan. draw: number of the trial that selects the sensors' noise."""

    set: str
    job: Job
    draw: int

    def file(self, folder: Path, ending: str = ".npz") -> Path:
        """Path of the swim's file."""
        return folder / SWIMS / self.set / f"{self.job.name}{ending}"

    def done(self, folder: Path) -> bool:
        """Returns True if it was swum, soundly or not."""
        return self.file(folder).is_file() or self.file(folder, ".json").is_file()


def swims_of(plan: FamilyPlan, one: PlannedRobot, *, off: bool) -> Iterator[PlannedSwim]:
    """Swims of one robot: only the faults outside the catalogue, or only the others."""
    robot = plan.descriptions[one.model]
    if not off:
        yield from _set(plan, f"{one.id}-{FREE}", one, robot, {}, free_swims(plan, one), calibrated.FIRST)
    for case in one.cases:
        if (case.kind == "off") is off:
            runs = session(one, robot, plan.asked.seconds)
            yield from _set(plan, case.id, one, robot, case.effects, runs, APART * (1 + number_of(case)))


def free_swims(plan: FamilyPlan, one: PlannedRobot) -> list[Excitation]:
    """Free swims of one robot."""
    return swims(plan.descriptions[one.model], plan.asked.calibration)


def _set(
    plan: FamilyPlan, name: str, one: PlannedRobot, robot: Robot, effects: dict, runs: list[Excitation], first: int
) -> Iterator[PlannedSwim]:
    """Swims of one set. Placing and packet delays are the same as in every robot's swim of that experiment."""
    made = jobs(effects, runs, one.seed, 1.0, families.NUISANCE, plan.asked.domain, robot=robot)
    for i, job in enumerate(made):
        place = excitation.DESIGNED.index(job.what.id) if job.what.id in excitation.DESIGNED else FIRST_FREE + i
        yield PlannedSwim(name, replace(job, index=place, hand=plan.asked.seed), first + i)


def all_swims(plan: FamilyPlan, shard: tuple[int, int] = (0, 1)) -> list[PlannedSwim]:
    """Swims of every robot in turn, faults outside the catalogue last.

    A shard takes every N-th from the I-th, so that processes which share the swims finish the same robots first.
    """
    index, shards = shard
    return [swim for off in (False, True) for one in plan.robots for swim in swims_of(plan, one, off=off)][index::shards]


def swum_all(plan: FamilyPlan, folder: Path, device: str, tanks: int = 1, shard: tuple[int, int] = (0, 1)) -> int:
    """Swims the missing part; returns the number of time steps.

    device: one, or several as for `devices_of`. tanks: side by side on each.
    """
    todo, done = [swim for swim in all_swims(plan, shard) if not swim.done(folder)], 0
    keys = [((swim.set, swim.job.steps, swim), swim.job) for swim in todo]
    with console.Progress(sum(swim.job.steps for swim in todo), "solver", unit="steps") as bar:
        for name, steps in spread(partial(on_device, folder=folder, tanks=tanks), keys, devices_of(device)):
            done += steps
            bar.update(done, set=name)
    return done


def on_device(waiting: Waiting, device: str, go_on: GoOn, *, folder: Path, tanks: int) -> Iterator[tuple[str, int]]:
    """Swims on one device (`spread`), written to disk when they are done; yields set and steps of each."""
    jobs_of = OwnedJobs(waiting)
    for run in run_jobs(jobs_of, device, tanks):
        name, steps, swim = jobs_of.owner(run)
        keep(swim, run, folder)
        yield name, steps


def keep(swim: PlannedSwim, run: HiddenRun, folder: Path) -> None:
    """Writes a finished swim to disk."""
    try:
        seen, bare = trial_of(run, draw=swim.draw), trial_of(run, noise=0.0, draw=swim.draw)
    except OracleUnstable as error:
        write_json(swim.file(folder, ".json"), {"lost": str(error)})
        return
    write_bundle(swim.file(folder), [seen, Trial(bare.meta, bare.tables, name=seen.name + BARE)])


# --------------------------------------------------------------------------------------------------------------------- data sets
class CompleteSet(NamedTuple):
    """A complete set: its trials as measured, and without noise by experiment."""

    seen: list[Trial]
    bare: dict[str, Trial]


def finished(plan: FamilyPlan, folder: Path, tick: Callable[[int], None] = lambda done: None) -> dict[str, str]:
    """Writes data sets and truth of all complete robots. Returns the lost swims with reasons.

    A robot is complete once its free swims and its healthy session are. tick: receives the number of robots that were read.
    """
    sets: dict[str, CompleteSet] = {}
    lost: dict[str, str] = {}
    for done, one in enumerate(plan.robots, 1):
        for swims_ in _by_set(plan, one).values():
            if all(swim.done(folder) for swim in swims_):
                sets[swims_[0].set] = _read(swims_, folder, lost)
        tick(done)
    truth = {}
    for one in plan.robots:
        plain = next(case.id for case in one.cases if case.kind == "none")
        if plain not in sets or (free := f"{one.id}-{FREE}") not in sets or not sets[free].seen:
            continue
        others = [sets[case.id].bare for same in plan.robots if same.model == one.model for case in _healthy(same, sets)]
        names = {name for bare in others for name in bare}
        healthy = {name: [bare[name] for bare in others if name in bare] for name in names}
        write_bundle(folder / SETS / f"{free}.npz", sets[free].seen)
        for case in one.cases:
            if case.id in sets and sets[case.id].seen:
                swum_, sigma = sets[case.id], sets[case.id].seen[0].meta["sigma"]
                found = solver_detectability.detectable(case.effects, swum_.bare, sets[plain].bare, healthy, sigma)
                write_bundle(folder / SETS / f"{case.id}.npz", swum_.seen)
                truth[case.id] = {"effects": case.effects, "detectable": found}
    write_json(folder / TRUTH, console.plain({"origin": "synthetic", "cases": truth, "lost": lost}))
    return lost


def _by_set(plan: FamilyPlan, one: PlannedRobot) -> dict[str, list[PlannedSwim]]:
    out: dict[str, list[PlannedSwim]] = {}
    for off in (False, True):
        for swim in swims_of(plan, one, off=off):
            out.setdefault(swim.set, []).append(swim)
    return out


def _healthy(one: PlannedRobot, sets: dict[str, CompleteSet]) -> Iterator[BenchCase]:
    yield from (case for case in one.cases if case.kind == "none" and case.id in sets)


def _read(swims_: list[PlannedSwim], folder: Path, lost: dict[str, str]) -> CompleteSet:
    """Trials of a set, with the launches cut; adds missing ones to `lost`."""
    seen, bare = [], {}
    for swim in swims_:
        if not (path := swim.file(folder)).is_file():
            lost[f"{swim.set}/{swim.job.name}"] = "nothing sound was left of it"
            continue
        as_seen, without = read_bundle(path)
        late = swim.job.made.robot.timing.camera_latency
        seen.append(steadied(as_seen, late, without))
        bare[str(as_seen.value("excitation"))] = steadied(without, late)
    return CompleteSet(seen, bare)
