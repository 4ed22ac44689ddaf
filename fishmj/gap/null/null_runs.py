"""Null runs: the experiments of the records repeated in an independent simulator without any hidden effect.

    residuals(model, records, layout) -> (n, m)      the model's residuals on n simulated fish with the same commands

The simulator is `virtual_robot`. It has its own equations for water, servos, network and camera; the searched model's links,
servos and timing, without the effects that the model lists; the sensors of the logs (second_robot.py); and constants drawn within
their tolerance, the same in all experiments of one fish. Results are cached on disk under the hash of all inputs, including the
code of simulator and model (`digest`), so a standard experiment is run once per machine.

`RecordedNull` uses recorded runs (data/gap/lbm/nulls: of the flow solver). It makes no new ones, so an experiment outside the
sets has no null.
"""

import ast
import hashlib
import json
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from zlib import crc32

import numpy as np

import fishmj
from fishmj.base.calib import resolve
from fishmj.base.compile_cache import cache_folder
from fishmj.base.errors import LogError, SimDiverged, StoreError
from fishmj.base.store import read_npz, sha256, write_npz
from fishmj.gap.laboratory.virtual_robot.robot_constants import AS_IT_IS, WaterScales
from fishmj.gap.null.second_robot import log_sensors, scales_for
from fishmj.gap.progress import Bars, silent_bar
from fishmj.gap.records import mass_properties
from fishmj.gap.records.records import WINDOW, Record, ResidualLayout, record_of
from fishmj.log import Trial
from fishmj.log.dataset import read_bundle
from fishmj.log.excitation import Excitation
from fishmj.mjcf.description import Robot

Tick = Callable[[int], None]
SEED = 1_000_000  # first seed of null runs, above those of data sets
RUNS = 96
MOST_RUNS, LOUDEST, LAST_SEED = 4096, 100.0, 2**31 - 1  # largest allowed settings
FEWEST = 12  # least number of fish in recorded runs
ALIKE = 1e-3  # rad between two commands, m and rad between two starts
SIMULATOR = ("fishmj.gap.laboratory.virtual_robot.trials", "fishmj.gap.null.second_robot")
SOURCES = Path(fishmj.__file__).resolve().parent


@dataclass(frozen=True)
class SimulatedNull:
    """Settings of the null runs.

    runs: per experiment. nuisance: relative half width of the unmeasured constants. noise: factor on the radio's jitter, and on
    the sensors' noise unless the logs state it. session: another number repeats the experiments with the same fish and new noise.
    """

    runs: int = RUNS
    nuisance: float = 0.1
    noise: float = 1.0
    seed: int = 0
    without: str | tuple[str, ...] = ""  # family whose fish are left out
    session: int = 0

    @property
    def text(self) -> str:
        """Words for the runs."""
        return f"{self.runs} runs of every record in an independent simulator without any hidden effect"

    def residuals(self, model, records: list[Record], layout: ResidualLayout, bars: Bars = silent_bar) -> np.ndarray:
        """(n, m) residuals of the present model on every null run, in the windows of `layout`. bars: progress of new runs."""
        self.prepare(model, records, bars)
        out = np.empty((self.runs, layout.size))
        for i, record in enumerate(records):
            kept = self.experiment(model, record)
            if record.weighed is not None:
                kept |= mass_properties.null(record.weighed, self.runs, self.seed)
            for b in layout.blocks:
                if b.record == i:
                    if (values := kept.get(f"{b.sensor}{b.column}")) is None:
                        raise LogError(f"record {record.name}: the null runs of its experiment have no sensor {b.sensor!r}")
                    grid = np.arange(values.shape[1])
                    for run in range(self.runs):
                        out[run, b.where] = np.interp(b.window, grid, values[run])
        return out

    def prepare(self, model, records: list[Record], bars: Bars) -> None:
        """Makes the missing runs under one progress bar; equal experiments are run once."""
        whats = {self._key(model, record, what): record for record in records for what in (as_excitation(record),)}
        anew = [record for key, record in whats.items() if not cache_path(key).is_file()]
        if not anew:
            return
        self.scales_of_water(model, bars)  # has its own progress bar
        with bars(self.runs * len(anew), "null runs", "runs") as bar:
            for i, record in enumerate(anew):

                def tick(done: int, before: int = i * self.runs) -> None:
                    bar.update(before + done)

                self.experiment(model, record, tick)

    def scales_of_water(self, model, bars: Bars = silent_bar) -> WaterScales:
        """Scales by which the simulator swims like the model."""
        return scales_for(model, bars)

    def holds(self, excitation: str) -> bool:
        """Returns True if null runs of that experiment are possible."""
        return True

    def experiment(self, model, record: Record, tick: Tick = lambda done: None) -> dict[str, np.ndarray]:
        """{sensor and column: (n, windows)} residuals of one experiment, cached or new. tick: gets the number of runs."""
        what = as_excitation(record)
        path = cache_path(self._key(model, record, what))
        try:
            return read_npz(path)
        except StoreError:
            pass
        runs = self._run(model.robot, what, record, tick, self.scales_of_water(model))
        predictions = model.predict(runs, getattr(model, "nothing", model.null))  # the floor of a model without any effect
        rows: dict[str, list] = {}
        for run, prediction in zip(runs, predictions, strict=True):
            layout = ResidualLayout([run])
            residual = layout.residuals([prediction])[0]
            for b in layout.blocks:
                grid = np.arange(int(b.window[-1]) + 1)
                rows.setdefault(f"{b.sensor}{b.column}", []).append(np.interp(grid, b.window, residual[b.where]))
        least = {name: min(len(r) for r in given) for name, given in rows.items()}
        made = {name: np.array([r[: least[name]] for r in given], np.float32) for name, given in rows.items()}
        write_npz(path, made)
        return made

    def _run(
        self, robot: Robot, what: Excitation, record: Record, tick: Tick = lambda done: None, scales: WaterScales = AS_IT_IS
    ) -> list[Record]:
        """Records of the experiment with every fish: `robot` with its own constants each. scales: of its water."""
        from fishmj.gap.laboratory.virtual_robot.trials import plant, trial_of

        flow = (float(np.hypot(*record.flow)), float(np.arctan2(record.flow[1], record.flow[0])))
        stream = {"tank.flow_x": record.flow[0], "tank.flow_y": record.flow[1]}
        sensors = log_sensors(record, robot, self.noise)
        told = (what.id, what.start) if not self.session else (what.id, what.start, self.session)
        index = crc32(repr(told).encode()) % 100_000  # independent noise for each experiment

        def one(run: int) -> Record:
            for attempt in range(10):  # a diverged fish is drawn again
                seed = SEED + self.seed * 100_000 + run + attempt * 10_000
                made = plant({}, seed, nuisance=self.nuisance, robot=robot, medium=record.medium, scales=scales).with_fields(
                    stream | sensors.fields
                )
                try:
                    return record_of(trial_of(made, what, seed, index, self.noise, what.id, "", flow, sensors.stamps), record.dt)
                except SimDiverged as error:
                    last = error
            raise last

        with ThreadPoolExecutor(2) as pool:
            out = []
            for made in pool.map(one, range(self.runs)):
                out.append(made)
                tick(len(out))
            return out

    def _key(self, model, record: Record, what: Excitation) -> str:
        drawn = [self.runs, self.nuisance, self.noise, self.seed, log_sensors(record, model.robot, self.noise).key]
        drawn += [self.session] if self.session else []
        done = [*WINDOW, record.dt, record.medium, *record.flow, *what.start, *what.push]
        swims = hashlib.sha256(repr(model.robot).encode()).hexdigest()[:16]  # neither uses the effects that it lists
        made = [digest(*SIMULATOR), sha256(resolve("virtual_robot")), model_digest(model)]
        text = json.dumps([*made, swims, model.fingerprint, what.id, drawn, done])
        return hashlib.sha256(text.encode() + what.commands.tobytes()).hexdigest()[:32]


def cache_path(key: str) -> Path:
    """Path of an experiment's cached residuals."""
    return cache_folder() / "null" / f"{key}.npz"


def model_digest(model) -> str:
    """Hash of the code that predicts the null runs and takes their residuals."""
    return digest(type(model).__module__, "fishmj.gap.records.records")


def as_excitation(record: Record) -> Excitation:
    """The commands of a record as a repeatable experiment."""
    stride, (x, y, yaw), (u, w, r) = round(0.02 / record.dt), record.place, record.push
    return Excitation(
        id=record.excitation or record.name,
        commands=record.commands[::stride],
        about="a record repeated",
        start=(round(float(x), 3), round(float(y), 3), round(float(yaw), 3)),
        push=(float(u), float(w), float(r)),
    )


@dataclass(frozen=True)
class RecordedNull(SimulatedNull):
    """folder: one bundle (.npz) per fish. without: names of bundles to leave out. The draws of `SimulatedNull` are unused."""

    folder: Path = Path()
    without: tuple[str, ...] = ()

    def __post_init__(self):
        object.__setattr__(self, "runs", len(self.bundles))  # of a frozen dataclass

    @property
    def bundles(self) -> list[Path]:
        """Bundles of the fish in use. Raises LogError: too few."""
        found = [path for path in sorted(self.folder.glob("*.npz")) if path.stem not in self.without]
        if len(found) < FEWEST:
            raise LogError(f"{self.folder}: {len(found)} null sets; at least {FEWEST} fish are needed")
        return found

    def scales_of_water(self, model, bars: Bars = silent_bar) -> WaterScales:
        """Returns unit scales, since the runs exist already."""
        return AS_IT_IS  # the runs are there

    def holds(self, excitation: str) -> bool:
        """Returns True if the sets hold that experiment."""
        return any(trial.value("excitation") == excitation for trial in trials_of(self.bundles[0]))

    def _run(
        self, robot: Robot, what: Excitation, record: Record, tick: Tick = lambda done: None, scales: WaterScales = AS_IT_IS
    ) -> list[Record]:
        """Recorded trials of the experiment, one per fish, with the noise, constants and water of the recording."""
        out = [record_of(trial, record.dt) for path in self.bundles for trial in trials_of(path) if _same(trial, what, record)]
        if len(out) != len(self.bundles):
            held = ", ".join(sorted({str(t.value("excitation")) for t in trials_of(self.bundles[0])}))
            did = f"experiment {what.id!r} of record {record.name} exists for {len(out)} of {len(self.bundles)} fish"
            raise LogError(f"{self.folder}: {did}; expected all. The sets hold {held}")
        return out

    def _key(self, model, record: Record, what: Excitation) -> str:
        made = [[sha256(path) for path in self.bundles], digest("fishmj.log.dataset"), model_digest(model)]
        text = json.dumps([*made, model.fingerprint, what.id, *WINDOW, record.dt, *what.start])
        return hashlib.sha256(text.encode() + what.commands.tobytes()).hexdigest()[:32]


@cache
def trials_of(path: Path) -> tuple[Trial, ...]:
    """The trials of one fish, read once."""
    return tuple(read_bundle(path))


def _same(trial: Trial, what: Excitation, record: Record) -> bool:
    """Returns True if a trial is that experiment, with the same name, commands and start."""
    if str(trial.value("excitation", "")) != what.id:
        return False
    other = record_of(trial, record.dt)
    rows = min(len(other.commands), len(record.commands))
    moved = np.abs(np.subtract([*other.place, *other.push, *other.flow], [*record.place, *record.push, *record.flow])).max()
    return bool(moved < ALIKE and np.mean(np.abs(other.commands[:rows] - record.commands[:rows])) < ALIKE)


def null_of(drawn: dict) -> SimulatedNull:
    """Settings of the null runs from a report or a version (reported.py): runs, noise, seed, folder of recorded ones."""
    return RecordedNull(**drawn | {"folder": Path(drawn["folder"])}) if "folder" in drawn else SimulatedNull(**drawn)


# ------------------------------------------------------------------------------------------------------------------ source digest
@cache
def digest(*modules: str) -> str:
    """Hash of the source of `modules` (dotted names within fishmj) and of everything in fishmj that they import.

    Imports are read from the source, including those inside functions, so no list must be maintained. A package counts with its
    `__init__.py` and its imported modules. Modules found by name at run time (the effects of the catalogue) are not included.
    """
    files = reached(*modules)
    text = b"".join(name.encode() + b"\0" + files[name].read_bytes() + b"\0" for name in sorted(files))
    return hashlib.sha256(text).hexdigest()[:16]


def reached(*modules: str) -> dict[str, Path]:
    """Module -> file, of `modules` and everything in fishmj that they import."""
    todo, found = list(modules), {}
    while todo:
        name = todo.pop()
        path = None if name in found else _file(name)
        if path is not None:
            found[name] = path
            todo += [*_imports(path), name.rpartition(".")[0]]
    return found


def _file(name: str) -> Path | None:
    """Path of a module of fishmj; None for other names, such as a function of a module."""
    first, *rest = name.split(".")
    place = SOURCES.joinpath(*rest)
    files = (place / "__init__.py", place.with_suffix(".py")) if first == "fishmj" else ()
    return next((path for path in files if path.is_file()), None)


def _imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
