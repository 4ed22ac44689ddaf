"""Ways to compute the learnt force in JAX, side by side: `python -m studies.fitted_water.residual_ways`, one line a way.

    strips         no learnt force: the upper limit                products       matrix products in float32, as on a CPU
    rounded        the same, rounded to ten bits where the device may      split     the same, in three products of ten bits
    kernel B/W     one Pallas kernel, B fish a program of W warps (residual_kernel.py), on an NVIDIA GPU alone
    tick B/W/U     the physics of a whole tick in such a kernel (engines/planar_kernel.py), U hidden units a round of its loop

Rates are control steps (0.2 s) a second, best of the rounds. `off` is the error of a way, mm: the greatest distance of a fish of
a school after `SECONDS` from its position with `products` in double precision.
"""

import argparse
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from typing import Any
from unittest.mock import patch

import numpy as np

from fishmj.base import console
from studies.benchmarks import hydro, surrogate_speed

SECONDS, SWUM = 10.0, 64  # of the swims that are compared, and fish
BLOCKS = ((256, 4), (512, 16))  # fish a program and warps, of the kernel of a step
TICKS = ((128, 4, 8), (128, 4, 1), (64, 2, 4), (256, 4, 1), (256, 8, 4), (512, 16, 4))  # and of that of a tick; hidden units


def ways(gpu: bool) -> dict[str, dict]:
    """Settings of each way, by name."""
    from jax.lax import DotAlgorithmPreset

    found: dict[str, dict] = {"products": {"kernel": False}}
    if gpu:
        found["rounded"] = {"kernel": False, "PRECISION": "default"}
        found["split"] = {"kernel": False, "PRECISION": DotAlgorithmPreset.TF32_TF32_F32_X3}
        few = {"FEWEST": 1}  # the fish whose swim is compared are few
        found |= {f"kernel {b}/{w}": {**few, "tick kernel": False, "BLOCK": b, "WARPS": w} for b, w in BLOCKS}
        found |= {f"tick {b}/{w}/{u}": {**few, "tick BLOCK": b, "tick WARPS": w, "tick UNITS": u} for b, w, u in TICKS}
    return found


@contextmanager
def chosen(settings: dict[str, Any]) -> Iterator[None]:
    """Makes engines inside the context use these settings."""
    from fishmj.engines import planar, planar_kernel
    from fishmj.water import residual_kernel, residual_network, residual_step

    rooms = {"kernel": residual_step, "PRECISION": residual_network, "FEWEST": residual_step, "tick kernel": planar}
    rooms |= {"BLOCK": residual_kernel, "WARPS": residual_kernel}
    rooms |= {f"tick {name}": planar_kernel for name in ("BLOCK", "WARPS", "UNITS")}
    with ExitStack() as patches:
        for name, value in settings.items():
            patches.enter_context(patch.object(rooms[name], name.removeprefix("tick "), value))
        yield


def timed(name: str, learnt: bool, fish: int, unroll: int, rounds: int) -> dict:
    """Rate and seconds of the first run of one engine."""
    start = time.perf_counter()
    work = surrogate_speed.swim_work(name, False, learnt, fish, unroll=unroll)
    first = time.perf_counter() - start
    rates = []
    for _ in range(rounds):
        start = time.perf_counter()
        work.run()
        rates.append(work.amount / surrogate_speed.CONTROL / (time.perf_counter() - start))
    return {"M steps/s": f"{max(rates) / 1e6:.3g}", "first run, s": f"{first:.1f}"}


def places(double: bool) -> np.ndarray:
    """Positions of the fish of a school after `SECONDS` in turbulence, (B, 3) m and rad."""
    import jax

    from fishmj import engines
    from studies.benchmarks.engines import _school

    robot = hydro.robot_of(True, made_up=False)
    chunks = round(SECONDS / robot.timing.control_dt)
    with jax.enable_x64(True) if double else nullcontext():
        cast = lambda a: np.asarray(a, np.float64 if double else np.float32) if np.asarray(a).dtype == float else a
        state, commands, params, current, tick = jax.tree.map(cast, _school(robot, SWUM))
        given, _ = engines.make("planar", robot).advance(state, np.concatenate([commands] * chunks, 1), params, current, tick)
        return np.asarray(given.q, float)[:, :3]


def _words(error: Exception) -> str:
    """Text of a fault in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"


def main(argv: list[str] | None = None) -> int:
    """Prints the table."""
    import jax

    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("--engine", nargs="*", default=["planar"], choices=("planar", "mjx"))
    parser.add_argument("--fish", type=int, nargs="*", default=[surrogate_speed.FISH], help="of a batch; fewer on a CPU")
    parser.add_argument("--unroll", type=int, nargs="*", default=[1], help="physics steps that a round of the loop holds")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", nargs="*", metavar="WAY", help='of the ways above, such as "tick 128/4/8"; default: all')
    args = parser.parse_args(argv)
    device = jax.devices()[0]
    console.say(f"{device.device_kind}, jax {jax.__version__}")
    there = {way: set_to for way, set_to in ways(device.platform == "gpu").items() if args.only is None or way in args.only}
    todo = [("strips", None), *there.items()]
    with chosen({"kernel": False}):
        exact = places(double=True)
    off = {}
    for way, settings in there.items():
        try:
            with chosen(settings):
                off[way] = f"{1e3 * np.abs(places(double=False) - exact)[:, :2].max():.3g}"
        except Exception as error:  # noqa: BLE001  one way that fails does not take the others with it
            off[way] = _words(error)
    for engine in args.engine:
        for fish in args.fish:
            for unroll in args.unroll:
                for way, setting in todo:
                    row = {"engine": engine, "fish": fish, "unroll": unroll, "way": way, "off, mm": off.get(way, "")}
                    try:
                        with chosen(setting) if setting else nullcontext():
                            row |= timed(engine, setting is not None, fish, unroll, args.rounds)
                    except Exception as error:  # noqa: BLE001
                        row["failed"] = _words(error)
                    console.say(", ".join(f"{key} {value}" for key, value in row.items()))
    return console.OK


if __name__ == "__main__":
    raise SystemExit(main())
