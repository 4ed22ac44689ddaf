"""A small bus servo on a pendulum: three gains, four trajectories, and a supply that sags.

A gain is a group: each fold leaves one out. The trajectory `sin_sin` is kept aside whole. Stamps are those of the log.
"""

from collections.abc import Sequence

import numpy as np

from fishmj.gap.models.swimming_fish import Constant
from fishmj.gap.records.records import Sensor
from fishmj.log import Trial
from fishmj.studies.measured_robots.answer import solved
from fishmj.studies.measured_robots.folder import trials
from fishmj.studies.measured_robots.servo_model import DT, OneServo, Pendulum, PendulumLog, ServoMotor
from fishmj.studies.measured_robots.study import Study

ASIDE = "sin_sin"
# Rough: a fit adapts all four. Stall torque from the pendulum that full duty holds up, the rest by order of magnitude.
MOTOR = ServoMotor(stall=0.7, back_emf=0.02, viscous=0.02, armature=0.002)
STEP = 2 * np.pi / 4096  # rad, one count of the encoder
UNSATURATED = 0.9  # of the largest duty in the log


def study(aside: int | None = None, without: str = "") -> Study:
    """The set as a study.

    Args:
        aside: number of another trajectory to keep aside, of those in alphabetical order, counted round. without: a constant that
        is deleted from the baseline.
    """
    found = trials("servo_xl330")
    most = max(float(np.abs(t.table("joint")["load1"]).max()) for t in found.values())
    records = [bench(name, trial, most) for name, trial in found.items()]
    shape = {name: str(trial.value("rig.trajectory")) for name, trial in found.items()}
    shapes = sorted(set(shape.values()))
    kept = ASIDE if aside is None else shapes[aside % len(shapes)]
    learn = [r for r in records if shape[r.name] != kept]
    gains = sorted({r.group for r in learn})
    rig = next(iter(found.values())).meta["rig"]
    motor = MOTOR._replace(**{without: 0.0}) if without else MOTOR
    constants = tuple(Constant(n, 0.3) for n in ServoMotor._fields if n != without)
    plant = OneServo(motor, Pendulum(mass=rig["mass"], length=rig["length"], voltage=rig["vin"]), constants)
    return Study(
        name="servo_xl330",
        plant=plant,
        learn=learn,
        aside=[r for r in records if shape[r.name] == kept],
        fold=np.array([gains.index(r.group) for r in learn]),
        error=lambda rs, row: error(plant, rs, row),
        floor=STEP**2 / 12,
        floor_of="rounding to an encoder count",
        unit="mrad",
        factor=1e3,
        protocol=(
            f"{len(records)} logs of {len(gains)} gains; those of trajectory {kept} kept aside, one gain left out a fold",
            "error: rms of measured minus simulated angle at the log's own stamps, free run from the first row",
            "baseline: proportional controller with its duty limit, back-EMF, viscous friction, armature",
        ),
    )


def bench(name: str, trial: Trial, most: float) -> PendulumLog:
    """One log at the plant's steps. most: the largest duty that the firmware sets."""
    cmd, joint, power = (trial.table(t) for t in ("cmd", "joint", "power"))
    begin = float(cmd["t"][0])
    error, duty, on = cmd["c1"] - joint["j1"], joint["load1"], cmd["on1"] > 0
    inside = on & (np.abs(duty) < UNSATURATED * most)
    gain = float(error[inside] @ duty[inside] / (error[inside] @ error[inside]))
    steps = int(np.ceil((joint["t"][-1] - begin) / DT)) + 1
    i = np.maximum(np.searchsorted(cmd["t"] - begin, np.arange(steps) * DT + 1e-9, side="right") - 1, 0)
    held = [cmd["c1"][i], on[i].astype(float), power["V"][i], np.full(steps, gain), np.full(steps, most)]
    return PendulumLog(
        name=name,
        group=f"kp{trial.value('rig.kp'):g}",
        dt=DT,
        commands=np.stack(held, 1),
        joint=Sensor(joint["t"] - begin, joint["j1"][:, None], np.array([STEP / np.sqrt(12)])),
        start=(float(joint["j1"][0]), float(joint["w1"][0])),
        session=0.0,
    )


def error(plant: OneServo, records: Sequence[PendulumLog], row: np.ndarray) -> float:
    """Mean over the logs of the mean square error, rad^2."""
    seen = plant.predict(list(records), row)
    return float(np.mean([np.mean((p["joint"][0] - r.joint.values) ** 2) for p, r in zip(seen, records, strict=True)]))


def run(say) -> tuple[str, dict]:
    """Words and figures of the set."""
    return solved(study(), say, most=3)
