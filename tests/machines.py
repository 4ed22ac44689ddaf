"""Machines of the tests' own, written in another form than the package's: forces in a frame that does not move, small steps.

Each writes tables as a laboratory would. All data are synthetic.
"""

import math
from pathlib import Path

import numpy as np

BOAT = dict(mass=14.0, inertia=1.5, thrust=20.0, torque=1.2, drag=6.0, yaw_drag=1.5)


def boat(rng, throttle, rudder, seconds=24.0, current=(0.0, 0.0), linear=0.0, lift=0.0, noise=(0.01, 0.005), h=0.01, every=10):
    """(T, 6) t, x, y, yaw, throttle, rudder of a boat with one propeller. throttle, rudder: functions of t; current: m/s."""
    b = BOAT
    p, v, yaw, r = np.zeros(2), np.zeros(2), rng.uniform(-3, 3), 0.0
    rows, a, d = [], 0.0, 0.0
    for k in range(int(seconds / h)):
        t = k * h
        ahead, left = np.array([math.cos(yaw), math.sin(yaw)]), np.array([-math.sin(yaw), math.cos(yaw)])
        if k % every == 0:
            a, d = throttle(t), rudder(t)  # written once a row, held between
            rows.append([t, *p, yaw, a, d])
        seen = v - np.array(current)
        u, w = seen @ ahead, seen @ left
        force = (b["thrust"] * abs(a) * a - linear * u) * ahead - b["drag"] * np.hypot(*seen) * seen - lift * u * w * left
        moment = b["torque"] * abs(a) * a * d - b["yaw_drag"] * abs(r) * r
        v = v + h * force / b["mass"]
        r += h * moment / b["inertia"]
        p, yaw = p + h * v, yaw + h * r
    rows = np.array(rows)
    rows[:, 1:3] += rng.normal(0, noise[0], (len(rows), 2))
    rows[:, 3] += rng.normal(0, noise[1], len(rows))
    return rows


def boats(folder: Path, seed=0, days=2, settings=(0.4, 0.7, 1.0), runs=1, **hidden) -> Path:
    """Files d1_s40_1.csv: time in ms, positions in cm, heading in degrees by the compass (clockwise from y)."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    for day in range(days):
        for setting in settings:
            for run in range(runs):
                f, phase = rng.uniform(0.1, 0.25), rng.uniform(0, 6)
                turn = lambda t, f=f, phase=phase: 0.6 * math.sin(2 * math.pi * f * t + phase)
                rows = boat(rng, lambda t, s=setting: s, turn, **hidden)
                rows[:, 0] = 1e3 * rows[:, 0] + 5e4
                rows[:, 1:3] *= 100.0
                rows[:, 3] = (90.0 - np.degrees(rows[:, 3])) % 360.0
                write(folder / f"d{day + 1}_s{100 * setting:.0f}_{run + 1}.csv", "time,px,py,compass,throttle,rudder", rows)
    return folder


def write(path: Path, header: str, rows: np.ndarray) -> None:
    """A table."""
    path.write_text(
        "\n".join([header, *(",".join(f"{x:.6g}" if i else f"{x:.9g}" for i, x in enumerate(r)) for r in rows)]) + "\n"
    )


def servo(rng, goal, gain, seconds=6.0, coulomb=0.0, noise=5e-4, h=2e-4, every=25):
    """(T, 4) t, goal, angle, duty of a pendulum of 0.5 kg at 0.1 m on a servo of 0.8 N m. coulomb: dry friction, N m."""
    angle, rate, rows, wanted, inertia = 0.0, 0.0, [], 0.0, 0.5 * 0.1**2 + 0.003
    for k in range(int(seconds / h)):
        wanted = goal(k * h) if k % every == 0 else wanted  # the bus writes it once a row
        duty = min(max(gain * (wanted - angle), -0.9), 0.9)
        if k % every == 0:
            rows.append([k * h, wanted, angle + rng.normal(0, noise), duty])
        drive = 0.8 * duty - (0.03 + 0.025) * rate - 0.5 * 9.80665 * 0.1 * math.sin(angle)
        free = rate + h * drive / inertia
        stop = h * coulomb / inertia  # friction takes what moves, at most to rest
        rate = math.copysign(max(abs(free) - stop, 0.0), free)
        angle += h * rate
    return np.array(rows)


def servos(folder: Path, seed=0, gains=(1.0, 1.5, 2.0, 3.0, 4.0, 6.0), **hidden) -> Path:
    """Files sine_g2.csv and steps_g2.csv: degrees, duty in thousandths."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    for gain in gains:
        a, f = rng.uniform(0.5, 0.9), rng.uniform(0.4, 0.8)
        for name, goal in {
            "sine": lambda t, a=a, f=f: a * math.sin(2 * math.pi * f * t),
            "steps": lambda t, a=a: a * (1 if int(t / 1.5) % 2 else -1),
        }.items():
            rows = servo(rng, goal, gain, **hidden)
            rows[:, 1:3] = np.degrees(rows[:, 1:3])
            rows[:, 3] *= 1000.0
            write(folder / f"{name}_g{gain:g}.csv", "time,goal,angle,pwm", rows)
    return folder


def coasts(folder: Path, seed=0, runs=7, quadratic=2.0, linear=0.0, mass=14.0, noise=0.01) -> Path:
    """Files c1.csv: speed of a boat that coasts, from the closed form of du/dt = -(c1 u + c2 u^2) / m."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    for k in range(runs):
        u, t = rng.uniform(1.2, 2.2), np.arange(0.0, 30.0, 0.4)
        if linear:
            decay = np.exp(-linear * t / mass)
            speed = linear * u * decay / (linear + quadratic * u * (1 - decay))
        else:
            speed = u / (1 + quadratic * u * t / mass)
        write(folder / f"c{k + 1}.csv", "t,v", np.stack([t, speed + rng.normal(0, noise, len(t))], 1))
    return folder
