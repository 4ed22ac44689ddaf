"""One healthy robot: the residual of its calibrated model in the designed experiments, and the parts that may explain it."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj.base.errors import FishmjError, StoreError
from fishmj.base.store import read_json, read_npz, write_json, write_npz
from fishmj.base.store.manifest import SOURCES
from fishmj.effects import STAGES
from fishmj.gap.bench import calibrated, families, solver
from fishmj.gap.bench.drawn_robots import BenchRobot, describe_robot
from fishmj.gap.calibrate.water_fit import calibrate_trials
from fishmj.gap.models.strip_water import strips_of
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null import structural_error
from fishmj.gap.null.null_runs import SimulatedNull, trials_of
from fishmj.gap.null.structural_error import StructuralErrorScales
from fishmj.gap.null.variances import Sample
from fishmj.gap.null.whitening import leftover, smooth
from fishmj.gap.records import mass_properties
from fishmj.gap.records.records import ResidualLayout, record_of
from fishmj.gap.search.fit import drop_effect, on_records
from fishmj.gap.search.likelihood import Likelihood, relinearise
from fishmj.gap.search.stepwise import is_absent, shortlist
from fishmj.gap.thresholds import frozen
from fishmj.log import Trial, excitation
from fishmj.mjcf.description import Robot

SOLVER = "solver"
CHANNELS = ("joint", "heading", "position", "power")
WATER = "k_head k_body k_tail cn_head cn_body cn_tail cf ca_forward ca_backward ke lift_a lift_b stall_angle stall_lag suction"
NUMBERS = tuple(f"{WATER} edge_place tail_held linear_drag".split())
EFFECTS: dict[str, dict[str, float]] = {  # that healthy robots may have a little of, and where its width begins, SI
    "joint_sensor_delay": {"delay": 0.001},
    "command_latency": {"delay": 0.001},
    "camera_latency": {"delay": 0.001},
    "coulomb_friction": {"torque": 0.004},
    "viscous_friction": {"damping": 0.004},
    "servo_gain": {"gain": 0.01},
    "power_offset": {"power": 0.01},
    "surge_added_mass": {"mass": 0.01},
    "sway_added_mass": {"mass": 0.02},
    "yaw_added_mass": {"inertia": 0.0005},
    "linear_surge_drag": {"coefficient": 0.02},
    "quadratic_drag": {"coefficient": 0.05},
    "crossflow_drag": {"gain": 0.02},
    "tail_normal_force": {"gain": 0.02},
    "body_lift": {"coefficient": 0.5},
    "munk_moment": {"gain": 0.02},
    "yaw_drag": {"coefficient": 0.0005},
    "joint_hydro_damping": {"coefficient": 0.0005},
    "wake_memory": {"time": 0.01},
}
BEGIN = 0.8  # w of every number of the strips
WHITE = 0.05  # rho of every channel
FEW = 4  # effects of a stage that are fitted to all records


class SolverFish(NamedTuple):
    """Healthy fish of the flow solver that did the designed experiments.

    half: 0 or 1, half of the experiments on which it is compared; its model is calibrated to the other half.
    """

    id: str
    path: Path
    half: int
    family: str = SOLVER


def solver_fish(many: int) -> list[SolverFish]:
    """First so many fish of data/gap/lbm/nulls, in halves in turn.

    Raises:
        StoreError: they are not here, as in an installed package.
    """
    folder = solver.folder() / "nulls"
    found = sorted(folder.glob("*.npz"))[:many]
    if len(found) < many:
        raise StoreError(f"{folder}: {len(found)} fish of the flow solver, expected {many}: they are in {SOURCES} only")
    return [SolverFish(f"{SOLVER}-{path.stem}", path, i % 2) for i, path in enumerate(found)]


def measured(one: "BenchRobot | SolverFish", folder: Path) -> dict:
    """Swims, calibrates and compares; arrays go into `folder`. A robot that cannot be searched has the reason in its row."""
    about = {"robot": one.id, "family": one.family, "file": str(folder / f"{one.id}.npz")}
    if Path(about["file"]).is_file():
        return about
    try:
        believed, trials = questioned(one)
        write_npz(Path(about["file"]), arrays(SwimmingFish(believed), trials))
    except FishmjError as error:
        return about | {"reason": str(error)}
    return about


def questioned(one: "BenchRobot | SolverFish") -> tuple[Robot, list[Trial]]:
    """Calibrated description of a healthy robot, and trials outside its calibration."""
    if isinstance(one, SolverFish):
        trials = list(trials_of(one.path))
        believed, _ = calibrate_trials(trials[1 - one.half :: 2], "fish")
        return believed, trials[one.half :: 2]
    known, _, _ = describe_robot(one)
    believed, _ = calibrated.calibrate_robot(one.family, one.seed, known)
    return believed, families.trials(one.family, {}, excitation.DESIGNED, one.seed, known)


def calibrated_to(one: BenchRobot) -> tuple[Robot, list[Trial]]:
    """Calibrated description, and the free swims of its calibration."""
    known, _, _ = describe_robot(one)
    believed, _ = calibrated.calibrate_robot(one.family, one.seed, known)
    return believed, calibrated.swims(one.family, one.seed, known)


def own_left(asked: tuple[BenchRobot, dict[str, StructuralErrorScales]], folder: Path, mark: str) -> dict:
    """|z|^2 / m of a healthy robot's model on the swims of its calibration, with each of these scales.

    Kept in `folder` under `mark`.
    """
    one, tables = asked
    path = folder / f"{one.id}.own-{mark}.json"
    if path.is_file():
        return read_json(path)
    believed, trials = calibrated_to(one)
    model = SwimmingFish(believed)
    records = [record_of(trial, model.dt) for trial in trials]
    runs = SimulatedNull().residuals(model, records, ResidualLayout(records))
    left = {name: Likelihood(model, records, runs, widths=given).gap(model.null)[0] for name, given in tables.items()}
    write_json(path, row := {"robot": one.id, "family": one.family, "own": left})
    return row


def stage_gains(asked: "tuple[BenchRobot | SolverFish, dict[str, StructuralErrorScales]]", folder: Path, mark: str) -> dict:
    """Gains per record of the best effect of each stage on a healthy robot, with each of these scales.

    Kept in `folder` under `mark`.
    """
    one, tables = asked
    path = folder / f"{one.id}.gains-{mark}.json"
    if path.is_file():
        return read_json(path)
    believed, trials = questioned(one)
    model = SwimmingFish(believed)
    records = [record_of(trial, model.dt) for trial in trials]
    records = mass_properties.with_page(records, mass_properties.sensor({}, model))
    null = SimulatedNull().residuals(model, records, ResidualLayout(records))
    gains = {name: by_stage(Likelihood(model, records, null, widths=widths)) for name, widths in tables.items()}
    write_json(path, row := {"robot": one.id, "family": one.family, "gains": gains})
    return row


def by_stage(e: Likelihood) -> dict[str, float]:
    """Fall of |z|^2 per record by the best effect of each stage, as `decide.support_of` counts it."""
    gates, base, gains = replace(frozen(), shortlist=FEW), e.subset().base(), {}
    for stage in STAGES:
        short = shortlist(e, base, [x for x in e.model.active.effects if x.stage == stage and is_absent(e.model, x)], gates)[0]
        near, best = relinearise(e, short[0], 1)
        whole = near.subset()
        best = on_records(whole, best)
        gains[stage] = max(drop_effect(whole, best, best.names[-1]).cost - best.cost, 0.0) / len(e.records)
    return gains


def arrays(model: SwimmingFish, trials: list) -> dict[str, np.ndarray]:
    """Arrays of a `Sample`, with the tangents not yet split by record."""
    records = [record_of(trial, model.dt) for trial in trials]
    layout = ResidualLayout(records)
    null = SimulatedNull().residuals(model, records, layout)
    strips = strips_of(model, tuple(EFFECTS))
    moved = structural_error.tangents(strips, records, layout, EFFECTS)
    return {
        "null": (null / np.sqrt(len(null))).astype(np.float32),
        "shared": moved.shared.astype(np.float32),
        "names": np.array(moved.names),
        **{f"part{i}": part.astype(np.float32) for i, part in enumerate(moved.parts)},
        "leftover": leftover(null, layout),
        "rms": smooth(np.sqrt(np.mean(null**2, 0)), layout),
        "record": layout.record,
        "channel": layout.channel.astype(str),
        "residual": layout.residuals(model.predict(records, model.null))[0],
    }


def sample(file: Path) -> Sample:
    """Reads a robot's arrays. A number of the strips has two variances: over a whole record, and from moment to moment."""
    a = read_npz(file)
    names, count = [NUMBERS.index(str(name)) for name in a["names"]], len(NUMBERS)
    parts = [a[f"part{i}"].astype(float) for i in range(int(a["record"].max()) + 1)]
    groups = [np.concatenate([names, np.tile(names, len(part) // len(names) - 1) + count]) for part in parts]
    channel = np.array([CHANNELS.index(c) if c in CHANNELS else len(CHANNELS) for c in a["channel"].tolist()])
    return Sample(
        null=a["null"].astype(float),
        shared=a["shared"].astype(float),
        group=2 * count + np.arange(len(a["shared"])),
        parts=parts,
        groups=groups,
        record=a["record"],
        variance=a["leftover"] ** 2,
        spread=np.where(channel < len(CHANNELS), a["rms"] ** 2, 0.0),
        channel=channel,
        residual=a["residual"].astype(float),
    )
