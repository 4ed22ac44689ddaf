"""Speed of the fitted water relative to the flow solver: simulated seconds per second on the same device.

The baseline is the solver's coupled fish in one tank, as in `oracle_tank`. Seconds are summed over the batch. Nominal fish, one
gait, still water.
"""

from functools import partial

import numpy as np

from fishmj.base.calib import constant
from studies.benchmarks import BenchmarkWork, NotHere, add, benchmark, oracle
from studies.benchmarks import hydro as water
from studies.benchmarks.engines import finite_work, on_device

FISH, FISH_MJX, FISH_CPU, FISH_QUICK = 2**17, 2**14, 1024, 64
CHUNKS = 10  # control steps a run, in one compiled scan
CONTROL = constant("timing", "control_dt")  # s


def coupled_tank(quick: bool) -> BenchmarkWork:
    """One coupled fish in the flow solver, simulated seconds."""
    domain, device, ticks = oracle._place(quick)
    return oracle._resting(domain, device, ticks, 1, domain.dt)


def swim_work(name: str, quick: bool, learnt: bool = False, fish: int = FISH, **options) -> BenchmarkWork:
    """Swims `fish` fish for `CHUNKS` control steps by an engine with these options, in the shipped water."""
    import jax
    from jax import lax

    from fishmj import engines
    from fishmj.water.flow import Flow, stack

    robot = water.robot_of(learnt, made_up=False)  # XLA leaves out weights that are zero
    engine, device = engines.make(name, robot, **options), jax.devices()[0]
    if device.platform == "cpu":
        fish = min(fish, FISH_QUICK if quick else FISH_CPU)
    timing, (_, ticks) = robot.timing, engines.ticks_per(robot)
    chunks = 1 if quick else CHUNKS
    beat = water._beat(np.arange(chunks * ticks) * timing.bus_dt, robot.n_joints).reshape(chunks, ticks, -1)
    still = stack([Flow()])
    wide = lambda a: np.repeat(a, fish, 0)
    current = still._replace(**{key: wide(getattr(still, key)) for key in ("mean", "rms", "row", "offset", "turn")})
    school = (engines.at_rest(robot, np.zeros((fish, 3))), engines.nominal_params(robot, fish), current)
    state, params, current = on_device(school)

    @jax.jit
    def swim(state, params, current, beat):
        def chunk(carry, commands):
            now, tick = carry
            now, _ = engine.advance(now, jax.numpy.broadcast_to(commands, (fish, *commands.shape)), params, current, tick)
            return (now, tick + ticks), None

        (now, _), _ = lax.scan(chunk, (state, jax.numpy.zeros(fish, int)), beat)
        return now.q

    beat = jax.device_put(beat.astype(np.float32))
    seconds = fish * chunks * timing.control_dt
    return finite_work(lambda: np.asarray(swim(state, params, current, beat)), name, seconds, device.device_kind)


UNIT, planar = "simulated s/s", partial(swim_work, "planar")
add("surrogate_strips", UNIT, "Closed form in JAX, strips alone, a full batch.", planar, coupled_tank)
add("surrogate", UNIT, "Closed form in JAX with a learnt residual, a full batch.", partial(planar, learnt=True), coupled_tank)


@benchmark("surrogate_mjx", UNIT, baseline=coupled_tank)
def surrogate_mjx(quick: bool) -> BenchmarkWork:
    """MuJoCo in JAX, strips alone; not with --quick."""
    if quick:
        raise NotHere("compiling MJX takes half a minute of CPU; run it without --quick")
    return swim_work("mjx", quick, fish=FISH_MJX)
