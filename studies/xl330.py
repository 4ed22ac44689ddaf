"""Logs and descriptions of a measured XL330 servo on a pendulum, for `fishmj gap find --model`.

    python -m studies.xl330 DIR --out OUT                    DIR: the JSON logs, of `fishmj gap fetch servo_xl330`
    fishmj gap find OUT/logs --model OUT/M6_bare.xml --yes --out REPORT
    fishmj gap find OUT/M6 --model OUT/M6_bare.xml --yes     the same targets by the authors' model M6: *synthetic*; M3 likewise

The logs are of github.com/Rhoban/bam (Apache-2.0), `bam/data.bak/raw`: 0.49 kg at 0.1 m, three gains, four trajectories. The
command is the voltage at the motor, duty cycle times supply, while its torque is on:

    tau = k_t / R (V - k_t w)

k_t, R, rotor inertia, viscous and constant friction of *_bare.xml are those of the authors' models at commit 1b5a1ce, which have
a load friction besides: M6 of 0.267 of the motor's torque and 0.081 of the outer torque below 2.9 rad/s, M3 of 0.122 of their
difference. OUT/M3 and OUT/M6 are these models, held by the servo's own proportional controller to the targets of each log, with
the noise of the encoder.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from fishmj.gap.laboratory.articulated.bam_servo import friction_budget, servos
from studies.robot_files import pendulum, write_robot_files

MASS, LENGTH, GRAVITY = 0.49, 0.1, 9.81  # kg, m, m/s2
SERVO = servos()["xl330"]
MODELS = ("M3", "M6")
NATIVE_GAIN = 400  # at which the servo has `SERVO.stiffness`
SIGN = 1 << 15  # of the duty cycle in a word of 16 bits
STEP, NOISE = 2e-4, 4.4e-4  # s, rad
TABLE = "t,q_servo,cmd_servo"


def description(p: Mapping[str, float]) -> str:
    """MJCF of the pendulum with the motor of some constants, without load friction."""
    friction = f'damping="{p["viscous"] + p["k_t"] ** 2 / p["r"]:.6g}" frictionloss="{p["base"]}" armature="{p["armature"]}"'
    return pendulum("servo", MASS, LENGTH, own=1e-5, friction=friction, gear=p["k_t"] / p["r"])


def files(data: Path) -> Iterator[tuple[str, str]]:
    """The descriptions, and each log as CSV, measured and simulated: t s, q rad, cmd V, rows with the torque on."""
    for model in MODELS:
        yield f"{model}_bare.xml", description(SERVO.laws[model])
    for number, path in enumerate(sorted(data.glob("*.json"))):
        log = json.loads(path.read_text(encoding="utf-8"))
        rows = [e for e in log["entries"] if e["torque_enable"]]
        column = lambda key, rows=rows: np.array([e[key] for e in rows])
        t, q, goal, supply = (column(key) for key in ("timestamp", "position", "goal_position", "input_volts"))
        duty = ((column("load") + SIGN) % (2 * SIGN) - SIGN) / 1000
        name = f"{log['trajectory']}_{log['kp']}.csv"
        yield f"logs/{name}", csv(t, q, duty * supply)
        for model in MODELS:
            rng = np.random.default_rng(number)
            yield f"{model}/{name}", csv(t, *simulated(SERVO.laws[model], t, q[0], goal, supply, log["kp"], rng))


def csv(t: np.ndarray, q: np.ndarray, volts: np.ndarray) -> str:
    """Text of a table."""
    return "\n".join([TABLE, *(f"{a:.6f},{b:.6f},{c:.4f}" for a, b, c in zip(t, q, volts, strict=True))]) + "\n"


def simulated(p: Mapping[str, float], t, q: float, goal, supply, gain: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """(angles with noise, voltages) of an authors' model under the servo's controller, at stamps t (T,)."""
    inertia, v, now = MASS * LENGTH**2 + p["armature"], 0.0, t[0]
    angles, sent = [], []
    for stamp, target, volts in zip(t, goal, supply, strict=True):
        while now < stamp:
            drive = volts * np.clip(SERVO.stiffness * gain / NATIVE_GAIN * (target - q), -SERVO.duty, SERVO.duty)
            motor = p["k_t"] / p["r"] * (drive - p["k_t"] * v)
            outer = -MASS * GRAVITY * LENGTH * np.sin(q)
            most = p["base"] + p["viscous"] * abs(v) + friction_budget({0: p}, [v], [motor], [outer])[0]
            stop = inertia / STEP * v + motor + outer  # torque that would bring the joint to rest within the step
            v += STEP / inertia * (motor + outer - np.clip(stop, -most, most))
            q += STEP * v
            now += STEP
        angles.append(q)
        sent.append(volts * np.clip(SERVO.stiffness * gain / NATIVE_GAIN * (target - q), -SERVO.duty, SERVO.duty))
    return np.array(angles) + NOISE * rng.standard_normal(len(t)), np.array(sent)


if __name__ == "__main__":
    write_robot_files(__doc__, files)
