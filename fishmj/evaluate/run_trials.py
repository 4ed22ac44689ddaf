"""Runs a controller over all trials at once: observe -> controller -> engine -> record.

`run` is the loop of an evaluation, with batched MuJoCo by default; all engines compute the same motion. `judge_in_solver` runs
the same trials in the flow solver, one tank each, and saves finished trials, so that an interrupted evaluation can continue.
"""

import gc
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fishmj import control, engines
from fishmj.base import console, interrupt, store
from fishmj.base.calib import calib_folder, constant
from fishmj.base.errors import ConfigError, SimDiverged, StoreError
from fishmj.base.options import checked, checked_array, checked_kind, shown_value
from fishmj.base.source import package_sha256
from fishmj.control.learned import LearnedController
from fishmj.control.policy import Policy
from fishmj.control.policy_meta import effects_drawn
from fishmj.evaluate import protocol
from fishmj.evaluate.metrics import Result, frozen
from fishmj.evaluate.protocol import Trials
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.tasks import station_hold as task
from fishmj.tasks.episode import ControlLoop, Scenario
from fishmj.water.choice import LBM, in_water
from fishmj.water.flow import stack
from fishmj.water.water_identity import water_identity

if TYPE_CHECKING:
    from fishmj.lbm_oracle.run.solver_water import SolverWater
    from fishmj.lbm_oracle.run.spread import GoOn, Waiting

KEPT = "lbm"  # folder of finished trials in the flow solver
OF_A_TRIAL = ("pose", "velocity", "joint", "rate", "power", "command", "obs", "action", "distance", "left")
ARRAYS = (
    "t", "target", "pose", "velocity", "joint", "rate", "power", "command", "obs", "action", "distance", "left", "corrections",
)  # fmt: skip


def run(
    controller,
    robot: "Robot | str" = "fish",
    trials: Trials | None = None,
    engine="batch",
    seed: int | None = None,
    shift: tuple[float, float] = (0.0, 0.0),
    progress: Callable[[int], object] = lambda step: None,
) -> Result:
    """Evaluates one controller.

    Args:
        controller: name, policy file, or an object with `name`, `reset` and `__call__` (see `fishmj.control`).
        robot: a description uses the water of a given engine, otherwise its own or the default one.
        trials: default, the 72 trials with `seed` (default 0).
        engine: name or engine; None is the fastest one here.
        shift: offset [m] of every fish from the start of its trial, which the camera sees only after its latency.
        progress: called with the number of control steps done.

    Raises SimDiverged: names the trial. ConfigError: an invalid argument, or an engine whose fish swims in another water.
    """
    chosen_here = engine is None or isinstance(engine, str) or not isinstance(robot, Robot)
    robot = in_water(load_robot(robot)) if chosen_here else load_robot(robot)
    if trials is not None and seed is not None:
        raise ConfigError(f"evaluate.run: seed = {shown_value(seed)} beside trials, which have their own; leave one of them out")
    trials = checked_kind("evaluate.run: trials", trials, Trials) or protocol.trials(seed=0 if seed is None else seed)
    bound = constant("task", "bound")
    for offset in checked_array("evaluate.run: shift", shift, (2,)):
        checked("evaluate.run: shift", offset, -bound, bound)
    if not callable(progress):
        raise ConfigError(f"evaluate.run: progress = {shown_value(progress)}; expected a function of the number of control steps")
    controller = control.make(controller, robot) if isinstance(controller, str | Path) else _checked_controller(controller)
    return engines.drained(running(controller, robot, trials, engine, shift, progress))


def _checked_controller(controller):
    """Returns an object that steers. Raises ConfigError, for example for a `Policy` or a class."""
    if isinstance(controller, Policy):
        raise ConfigError("evaluate.run: controller is a Policy; expected its name or file: save it with policy.save(FILE)")
    steers = callable(controller) and callable(getattr(controller, "reset", None)) and hasattr(controller, "name")
    if isinstance(controller, type) or not steers:
        what = "a name, a policy file, or an object (no class) with `name`, `reset(n)` and `__call__(obs)`"
        raise ConfigError(f"evaluate.run: controller = {shown_value(controller)}; expected {what}")
    return controller


def running(controller, robot: Robot, trials: Trials, engine, shift, progress: Callable[[int], object]) -> engines.Steps[Result]:
    """Does `run` as a generator, which yields while the engine waits for a device, so that other trials can continue."""
    loop = ControlLoop(robot, engine)
    n, steps = len(trials), task.control_steps(trials.duration, robot)
    params, camera = trials.fish(robot)
    (start, target), noise = trials.ends(), trials.sensor_noise(robot, steps)
    aims = trials.targets(np.arange(steps) * robot.timing.control_dt)
    loop.start(start, Scenario(params, camera, stack(trials.flows())))
    loop.fish.q[:, :2] += shift
    rows: list[tuple] = []
    controller.reset(n)
    for k in range(steps):
        now = loop.scenario.current
        loop.scenario = loop.scenario._replace(current=trials.stream(now, k * robot.timing.control_dt))
        obs = loop.observe(aims[:, k], noise[:, k])
        loop.inform(controller)
        command = _checked(controller, controller(obs), (n, loop.ticks, robot.n_joints))
        try:
            trace = yield from loop.acting(command)
        except SimDiverged as error:
            raise _named(error, trials, k * robot.timing.control_dt) from error
        rows.append((*trace, command, obs[:, None], _action(controller)))
        progress(k + 1)
    return _result(controller, robot, trials, loop.engine, start, target, rows)


def _result(controller, robot, trials, engine, start, target, rows) -> Result:
    """Result from rows of control steps; the start is tick 0."""
    join = lambda i: np.concatenate([row[i] for row in rows], 1)
    first = lambda x, like: np.concatenate([np.broadcast_to(x, (len(start), like.shape[2]))[:, None], like], 1)
    pose, joint, rate, velocity = first(start, join(0)), first(0.0, join(1)), first(0.0, join(2)), first(0.0, join(3))
    out = task.outside(np, pose)
    left = np.where(out.any(1), out.argmax(1), pose.shape[1])
    t = np.arange(pose.shape[1]) * robot.timing.bus_dt
    distance = np.linalg.norm(pose[:, :, :2] - trials.targets(t), axis=-1)
    name, hybrid = engines.name_of(engine), getattr(engine, "hybrid", None)
    return Result(
        controller=controller.name,
        policy_sha256=getattr(controller, "sha256", ""),
        policy=trained(controller, solved(robot) if name == LBM else robot, trials.effects),
        robot=robot,
        trials=trials,
        engine=name,
        t=t,
        target=target,
        pose=pose,
        velocity=velocity,
        joint=joint,
        rate=rate,
        power=join(4) + robot.servo.idle_power,
        command=join(5),
        obs=join(6),
        action=None if rows[0][7] is None else join(7),
        distance=frozen(distance, left),
        left=left,
        corrections=None if hybrid is None else np.array([json.dumps(hybrid.report(i)) for i in range(len(start))]),
    )


def _action(controller):
    action = getattr(controller, "action", None)
    return None if action is None else np.array(action)[:, None]


def _checked(controller, command, shape) -> np.ndarray:
    """Checked output of the controller, which may be the user's own. Raises one clear error."""
    command = np.asarray(command, float)
    if command.shape != shape or not np.isfinite(command).all():
        what = "" if np.isfinite(command).all() else " with values that are not finite"
        raise ConfigError(
            f"controller {controller.name}: gave an array of shape {command.shape}{what};"
            f" expected finite bus commands {shape} in rad"
        )
    return command


def _named(error: SimDiverged, trials: Trials, time: float) -> SimDiverged:
    """The same error with the first bad trial's condition."""
    bad = np.atleast_1d(error.states if error.states is not None else [0])
    trial = trials.items[int(bad[0])]
    where = f"{trial.speed} m/s, los {np.degrees(trial.los):.0f} deg, repeat {trial.repeat}, after {time:.1f} s"
    return SimDiverged(f"trial at {where}: {error}", time=time, term=error.term, states=error.states)


class FinishedTrials:
    """Saved results of finished controllers, with which the same command continues an interrupted evaluation.

    A file is reused only for the same controller, robot, water, trials, engine, code and constants of this package, whose hash is
    in its name. A complete evaluation removes its files.
    folder: --out; None keeps nothing. engine: its name.
    """

    def __init__(self, folder: Path | None, robot: Robot, trials: Trials, engine: str, names: list[str]):
        self.folder, self.robot, self.trials, self.engine = folder, robot, trials, engine
        self.names = names
        self.done: set[str] = set()

    def find(self, brain) -> Result | None:
        """Finished judgement of a controller, if there is one; prints a note."""
        path = self._path(brain)
        if path is None or not path.is_file():
            return None
        try:
            arrays = store.read_npz(path)
            given: dict[str, Any] = {name: arrays.get(name) for name in ARRAYS}
        except StoreError:  # damaged: judged again
            return None
        console.warn(f"{brain.name} was evaluated before under the same conditions: reusing {path}")
        known: dict[str, Any] = {"controller": brain.name, "policy_sha256": getattr(brain, "sha256", ""), "engine": self.engine}
        return Result(
            robot=self.robot, trials=self.trials, policy=trained(brain, self.robot, self.trials.effects), **known, **given
        )

    def keep(self, brain, result: Result) -> Result:
        """Keeps the arrays of a finished controller, and returns its result."""
        self.done.add(brain.name)
        path = self._path(brain)
        if path is not None and len(self.names) > 1 and not path.is_file():
            store.write_npz(path, {name: value for name in ARRAYS if (value := getattr(result, name)) is not None})
        return result

    @property
    def unfinished(self) -> list[str]:
        """Controllers that are not judged yet."""
        return [name for name in self.names if name not in self.done]

    def words(self) -> str:
        """Text of an interrupted judgement: the kept controllers, and the command that continues."""
        if self.folder is None:
            return "nothing was saved; with --out DIR every finished controller is saved"
        return f"{self.folder} holds {len(self.done)} of {len(self.names)} controllers; {interrupt.again()}"

    def end(self) -> None:
        """Removes the kept files; call it when all controllers are reported."""
        if self.folder is not None:
            shutil.rmtree(self.folder / "judged", ignore_errors=True)

    def _path(self, brain) -> Path | None:
        if self.folder is None:
            return None
        what = {
            "controller": [brain.name, getattr(brain, "sha256", "")],
            "robot": [repr(self.robot), repr(self.robot.effects)],
            "water": water_identity(self.robot),
            "trials": asdict(self.trials),
            "engine": self.engine,
            "code": package_sha256(),
        }
        mark = store.json_sha256(what)[:16]
        return self.folder / "judged" / f"{brain.name}_{mark}.npz"


def trained(controller, robot: Robot, effects: tuple[str, ...] = ()) -> dict | None:
    """Training of a policy and the differences here; None for a controller that is not a policy. effects: drawn here."""
    if not isinstance(controller, LearnedController):
        return None
    told = controller.trained(robot)
    if said := drawn_otherwise(controller, effects):
        told["differs"]["effects drawn"] = [list(effects_drawn(controller.policy.meta)), list(effects)]
        told["said"] = "; ".join(filter(None, (told["said"], said)))
    return told


def drawn_otherwise(controller, effects: tuple[str, ...]) -> str:
    """Effects that a policy's training drew, and those drawn here, in one clause; "" if they are the same, or for no policy."""
    drawn = effects_drawn(controller.policy.meta) if isinstance(controller, LearnedController) else effects
    listed = lambda names: ", ".join(names) or "none"
    return "" if set(drawn) == set(effects) else f"effects drawn: {listed(drawn)}; here {listed(effects)}"


def solved(robot: Robot) -> Robot:
    """Robot in the flow solver."""
    return in_water(robot, LBM, can=(LBM,))


class Variation(NamedTuple):
    """Variation of trials that should give the same result: a shift of every fish by so many cells, and a number of time steps in
    one of the domain's.
    """

    name: str = ""
    nudge: tuple[float, float] = (0.0, 0.0)
    finer: int = 1


UNCHANGED = Variation()


def judge_in_solver(brain, robot: Robot, trials: Trials, folder: Path | None = None, **options: Any) -> Result:
    """Judges one controller in the flow solver; options and errors as `judge_each_in_solver`."""
    (result,) = judge_each_in_solver([brain], robot, trials, folder, **options)
    return result


def judge_each_in_solver(
    brains: Sequence[Any],
    robot: Robot,
    trials: Trials,
    folder: Path | None = None,
    *,
    water: "SolverWater | None" = None,
    domain: str | None = None,
    slip: float | None = None,
    device: str = "auto",
    tanks: int = 1,
    ray: str | None = None,
    variation: Variation = UNCHANGED,
    progress: Callable[[int], None] = lambda done: None,
) -> Iterator[Result]:
    """Judges controllers in the flow solver: the same trials and figures, `tanks` trials at a time on each device.

    Yields the results in the order of the controllers, each as soon as its last trial has ended.

    Every trial is kept in <folder>/lbm as one npz as soon as it ends, and its tank starts the next one. An interrupted judgement
    continues with the trials that had not ended. A file made with another controller, robot or box of water is not used.

    Args:
        folder: folder of finished trials; None keeps nothing. variation: variation of all trials.
        water: water of the solver, by default the plain one. domain, slip: in place of the water's.
        ray: address of a Ray cluster whose workers swim, one on each of its devices; by default this machine does.
        progress: called with the number of control steps done, summed over trials and controllers.

    Raises:
        OracleUnstable, ConfigError: the set-up would not run, the stream changes within a trial, or no worker ended some trials.
    """
    if not trials.steady:
        raise ConfigError("judge_in_solver: the solver's stream is steady; trials whose stream changes run in the fitted water")
    from fishmj.lbm_oracle.fluid.device import devices_of
    from fishmj.lbm_oracle.run.solver_water import PLAIN
    from fishmj.lbm_oracle.run.spread import ray_device, spread, spread_over_ray

    steps = round(trials.duration / robot.timing.control_dt)
    water = PLAIN if water is None else water
    water = water._replace(domain=domain or water.domain, slip=water.slip if slip is None else slip)
    box: dict[str, Any] = {"domain": water.domain, "slip": water.slip, "finer": variation.finer} | water.immersed
    box |= {"dx": water.dx, "nu": water.nu}
    keys = [(k, i) for k in range(len(brains)) for i in range(len(trials))]
    names = {(k, i): f"{brains[k].name}_{trials.items[i].name}" for k, i in keys}
    paths: dict[tuple[int, int], Path] = {}
    if folder is not None:
        labels = ["_".join(filter(None, (fingerprint(brain, robot, trials, water), variation.name))) for brain in brains]
        paths = {(k, i): folder / KEPT / f"{names[k, i]}_{labels[k]}.npz" for k, i in keys}
    found: dict[tuple[int, int], dict] = {key: store.read_npz(path) for key, path in paths.items() if path.is_file()}
    waiting = [key for key in keys if key not in found]

    def told(done: float) -> bool:
        progress(len(found) * steps + round(done))
        return True

    work = partial(in_tanks, brains=brains, robot=robot, trials=trials, box=box, tanks=tanks, nudge=variation.nudge)
    if ray is None:
        made = spread(work, waiting, (device,) if device == "auto" else devices_of(device), told)
    else:
        made = spread_over_ray(ray, work, {names[key]: key for key in waiting}, ray_device(device), tanks=tanks, go_on=told)
    for k, brain in enumerate(brains):
        mine = [(k, i) for i in range(len(trials))]
        while any(key not in found for key in mine):
            key, row = next(made)
            if "stopped" in row:
                console.warn(f"{names[key]}: truncated: {row['stopped']}")
            if key in paths:
                store.write_npz(paths[key], row)
            found[key] = row
        yield merged(brain, robot, trials, f"tanks, {water.label}", [found[key] for key in mine])
    for _ in made:  # nothing is left; it reports its progress and ends its workers
        pass


def in_tanks(
    waiting: "Waiting",
    device: str,
    go_on: "GoOn",
    *,
    brains,
    robot: Robot,
    trials: Trials,
    box: dict[str, Any],
    tanks: int,
    nudge,
) -> Iterator[tuple[tuple[int, int], dict]]:
    """Runs trials by numbers (controller, trial), `tanks` at a time on one device; yields numbers and arrays of each (`spread`).

    Every trial has a tank and a copy of the controller; a controller that cannot be copied has one trial at a time.

    Args:
        box: options of `engines.lbm.LbmEngine`. nudge: cells by which every fish is shifted.
    """
    from fishmj.engines.lbm import LbmEngine

    alone = [k for k, brain in enumerate(brains) if not _copies(brain, tanks)]
    held: tuple[int, int] | None = None  # waits until its controller is free
    busy: dict[tuple[int, int], tuple[Any, engines.Steps[Result]]] = {}
    done: dict[tuple[int, int], int] = {}
    seen, emptied = -1, 0
    while busy or held or waiting:
        while len(busy) < tanks and (held or waiting):
            key, held = held or waiting.popleft(), None
            if key[0] in alone and any(key[0] == k for k, _ in busy):
                held = key
                break
            one = replace(trials, items=(trials.items[key[1]],))
            engine = LbmEngine(robot, one.flows(), device=device, **box)
            x, y = (cells * engine.domain.dx for cells in nudge)
            own = brains[key[0]] if tanks == 1 or key[0] in alone else deepcopy(brains[key[0]])
            busy[key] = engine, running(own, robot, one, engine, (x, y), partial(done.__setitem__, key))
        for key, (engine, steps) in list(busy.items()):
            try:
                next(steps)
            except StopIteration as end:
                del busy[key]
                done.pop(key, None)
                yield key, _arrays(end.value, engine)
                emptied += 1
                del engine, steps
        # captured launches and their tank form reference cycles: without collection old tanks fill the GPU's memory
        if emptied >= tanks and not device.startswith("cpu"):
            gc.collect()
            emptied = 0
        if (now := sum(done.values())) != seen:
            seen = now
            if not go_on(now):
                return


def _copies(brain, tanks: int) -> bool:
    """Returns True if a controller can be copied; prints the reason if not."""
    try:
        deepcopy(brain)
    except Exception as error:  # noqa: BLE001  somebody else's: whatever it holds
        if tanks > 1:
            console.warn(f"{brain.name}: cannot be copied ({error!r}), so its trials run one after another")
        return False
    return True


def _arrays(result: Result, engine) -> dict:
    """Arrays of one trial that are kept."""
    row = {key: getattr(result, key)[0] for key in OF_A_TRIAL if getattr(result, key) is not None}
    row |= {"t": result.t, "target": result.target[0]}
    return ended(row, engine.stopped[0], engine.ticks[0]) if engine.stopped[0] else row


def ended(row: dict, why: str, ticks: int) -> dict:
    """Arrays of a trial whose tank stopped after `ticks` bus ticks; the fish stays at its last pose.

    It counts as one that left the domain at the next tick. If its water or its motion failed, its later distance from the target
    is not known: NaN, so that no figure over that time looks better than it is.
    """
    left, distance = min(int(row["left"]), ticks + 1), row["distance"].copy()
    if not why.startswith("left_domain"):
        distance[left:] = np.nan
    return row | {"left": np.array(left), "distance": distance, "stopped": np.array(why)}


def merged(brain, robot: Robot, trials: Trials, engine: str, rows: list[dict]) -> Result:
    """One result from the arrays of every trial."""
    join: dict[str, Any] = {key: np.stack([row[key] for row in rows]) if key in rows[0] else None for key in OF_A_TRIAL}
    target = np.stack([row["target"] for row in rows])
    return Result(
        controller=brain.name,
        robot=robot,
        trials=trials,
        engine=engine,
        policy_sha256=getattr(brain, "sha256", ""),
        policy=trained(brain, solved(robot), trials.effects),
        t=rows[0]["t"],
        target=target,
        **join,
    )


def fingerprint(brain, robot: Robot, trials: Trials, water: "SolverWater") -> str:
    """Eight characters that change with everything that would change a trial's result."""
    from fishmj.engines.lbm import HELD
    from fishmj.hydro_fit.campaign.data.solver_hash import SHIPPED, solver_sha256
    from fishmj.lbm_oracle.run.solver_water import PLAIN

    solver = solver_sha256(water.box, water.sharpness)
    what = {
        "controller": [brain.name, getattr(brain, "sha256", store.sha256(calib_folder() / "controllers.toml"))],
        "robot": repr(robot),
        "trials": {
            k: v
            for k, v in asdict(replace(trials, items=())).items()
            if k != "items" and (k, v) not in (("task", protocol.HOLD), ("effects", ()))
        },
        "seed": trials.items[0].seed[:2],
        "water": [water.domain, water.slip, HELD, *([] if water.dx is None else [water.dx])],
        **({} if solver == SHIPPED else {"solver": solver}),
        **({} if water.nu == PLAIN.nu else {"nu": water.nu}),
        **({"immersed": {k: repr(v) for k, v in water.immersed.items()}} if water.immersed != PLAIN.immersed else {}),
        **({"effects": repr(robot.effects)} if robot.effects else {}),
        **({"hull": robot.hull} if robot.hull != "turbulent" else {}),
        **({"drawn": trials.drawn_as} if trials.drawn_as else {}),
    }
    return store.json_sha256(what)[:8]
