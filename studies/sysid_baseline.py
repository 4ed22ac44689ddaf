"""Fits a measured double pendulum by mujoco.sysid: all listed parameters at once, and forward selection by BIC.

    python -m studies.sysid_baseline DIR/design_A.0 --model OUT/A.0_2.0_bare.xml

DIR and OUT as in `studies.double_pendulum`; needs `pip install "mujoco[sysid]"`. mujoco.sysid fits the parameters that one
lists: here friction, damping, rotor inertia and torque gain of both joints, and the mass of both links. Segments of 0.3 s start
from the smoothed positions. BIC takes the parameter that lowers it most, until none lowers it by 10; its residuals are taken for
independent, as the package does.
"""

import argparse
from collections.abc import Sequence
from contextlib import redirect_stdout
from importlib import import_module
from io import StringIO
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.signal import savgol_filter

from fishmj.base import console

sysid: Any = import_module("mujoco.sysid")

SECONDS, SMOOTH = 0.3, 11  # length of a segment; samples of the cubic that gives its first velocity
LEAST = 10.0  # fall of BIC by which a parameter is taken: "very strong", Kass and Raftery 1995
ITERATIONS = 8  # the sum of squares stands still after three to five
JOINTS = ("shoulder", "elbow")
BODIES = ("upper", "lower")


def field(kind: str, name: str, what: str, unit: float = 1.0):
    """Modifier of a specification: sets the field of an object to so many times `unit`."""

    def change(spec, parameter):
        target = getattr(spec, kind)(name)
        value = unit * float(parameter.value[0])
        if what in ("gear", "damping"):  # of several numbers
            getattr(target, what)[0] = value
        else:
            setattr(target, what, value)

    return change


def listed(spec: mujoco.MjSpec) -> list:
    """Parameters in question with their bounds; the model's own value first."""
    made = []
    for joint in JOINTS:
        for what, most in (("frictionloss", 1.0), ("damping", 0.5), ("armature", 0.02)):
            made.append(sysid.Parameter(f"{what}@{joint}", 0.0, 0.0, most, modifier=field("joint", joint, what)))
        made.append(sysid.Parameter(f"gear@{joint}", 1.0, 0.5, 1.5, modifier=field("actuator", joint, "gear")))
    for body in BODIES:
        made.append(sysid.Parameter(f"mass@{body}", 1.0, 0.7, 1.3, modifier=field("body", body, "mass", spec.body(body).mass)))
    return made


def described(path: Path) -> mujoco.MjSpec:
    """The description with a sensor of each joint's angle; afresh for each fit, since mujoco.sysid changes what it is given."""
    spec = mujoco.MjSpec.from_file(str(path))
    for joint in JOINTS:
        spec.add_sensor(name=joint, type=mujoco.mjtSensor.mjSENS_JOINTPOS, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=joint)
    return spec


def segments(paths: Sequence[Path], model: mujoco.MjModel) -> list[tuple]:
    """Name, first state, commands and angles of the segments of the logs."""
    parts = []
    for path in paths:
        table = np.genfromtxt(path, delimiter=",", names=True)
        t, q = table["time"], np.column_stack([table[f"pos_meas{i}"] for i in (1, 2)])
        u = np.column_stack([table[f"tau_meas{i}"] for i in (1, 2)])
        step = float(model.opt.timestep)
        even = np.arange(t[0], t[-1], step)
        on = lambda a, t=t, even=even: np.column_stack([np.interp(even, t, column) for column in a.T])
        q, u = on(q), on(u)
        place = savgol_filter(q, SMOOTH, 3, axis=0)
        rate = savgol_filter(q, SMOOTH, 3, deriv=1, delta=step, axis=0)
        count = round(SECONDS / step)
        for k in range(0, len(even) - count, count):
            times = np.arange(count + 1) * step
            start = sysid.create_initial_state(model, place[k], rate[k])
            control = sysid.TimeSeries(times, u[k : k + count + 1])
            parts.append((f"{path.stem}-{k}", start, control, sysid.TimeSeries.from_names(times, q[k : k + count + 1], model)))
    return parts


def fitted(path: Path, parts: list[tuple], names: Sequence[str]) -> tuple[dict, float, int]:
    """Values with half widths of 90 % by parameter, sum of squares and number of residuals."""
    spec = described(path)
    pieces = sysid.ModelSequences("pendulum", spec, *map(list, zip(*parts, strict=True)))
    chosen = sysid.ParameterDict({one.name: one for one in listed(spec) if one.name in names})
    residual = sysid.build_residual_fn(models_sequences=[pieces])
    if not names:
        found, _, _ = residual(np.zeros(0), chosen)
        flat = np.concatenate([np.ravel(one) for one in found])
        return {}, float(flat @ flat), len(flat)
    chosen.move_off_bounds()
    with redirect_stdout(StringIO()):  # it prints every iteration
        best, result = sysid.optimize(chosen, residual, verbose=False, max_iters=ITERATIONS, x_scale="jac")
    found, _, _ = residual(result.x, best)
    flat = np.concatenate([np.ravel(one) for one in found])
    _, wide = sysid.calculate_intervals([flat], np.asarray(result.jac), alpha=0.1)
    values = {name: (float(best[name].value[0]), float(half)) for name, half in zip(best.keys(), np.ravel(wide), strict=True)}
    return values, float(flat @ flat), len(flat)


def bic(squares: float, count: int, parameters: int) -> float:
    """Bayesian information criterion of residuals of unknown variance."""
    return count * float(np.log(squares / count)) + parameters * float(np.log(count))


def told(values: dict) -> str:
    """Values with their half widths."""
    return ", ".join(f"{name} {value:.3g} +- {half:.2g}" for name, (value, half) in values.items())


def main() -> None:
    """Prints both fits."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path)
    parser.add_argument("--model", type=Path, required=True)
    args = parser.parse_args()
    spec = described(args.model)
    parts, known = segments(sorted(args.logs.glob("*.csv")), spec.compile()), [one.name for one in listed(spec)]
    _, squares, count = fitted(args.model, parts, [])
    console.say(f"{len(parts)} segments, {count} residuals, rms {np.sqrt(squares / count):.4f} rad of the model in question")
    everything, least, _ = fitted(args.model, parts, known)
    console.say(f"all at once: rms {np.sqrt(least / count):.4f} rad: {told(everything)}")
    taken: list[str] = []
    now = bic(squares, count, 0)
    while len(taken) < len(known):
        tried = {name: fitted(args.model, parts, [*taken, name]) for name in known if name not in taken}
        name = min(tried, key=lambda one: tried[one][1])
        values, squares, _ = tried[name]
        then = bic(squares, count, len(taken) + 1)
        if now - then < LEAST:
            break
        taken, now = [*taken, name], then
        console.say(f"BIC takes {name}: {told(values)}; rms {np.sqrt(squares / count):.4f} rad")


if __name__ == "__main__":
    main()
