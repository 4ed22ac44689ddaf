"""Throughput of the engines in control steps (0.2 s) per second, with randomised fish, latency, turbulence and water.

The baseline of each is bare MuJoCo on one core: `mj_step` of the same robot without water, randomisation or latency,
physics steps counted as control steps.
"""

from functools import partial

import numpy as np

from fishmj.base.calib import constant
from fishmj.water.choice import in_water, label
from studies.benchmarks import BenchmarkWork, NotHere, add, benchmark

SEED = 5
WATER: list[str | None] = [None]  # of the engines and the environment: `fishmj bench --water`


def swimming():
    """Shipped robot in the water of --water."""
    from fishmj.mjcf import load_robot

    return in_water(load_robot("fish"), WATER[0], who="bench")


def bare_mujoco(quick: bool) -> BenchmarkWork:
    """`mj_step` of the robot alone, one core."""
    import mujoco

    from fishmj import mjcf
    from fishmj.mjcf import load_robot

    model, timing = mjcf.build("fish", bare=True), load_robot("fish").timing
    data = mujoco.MjData(model)
    steps = round(timing.control_dt / timing.physics_dt)
    control = 40 if quick else 200

    def run():
        mujoco.mj_step(model, data, control * steps)

    run()
    return BenchmarkWork(run, control)


def _school(robot, fish: int):
    """(state, commands, params, current, tick) of `fish` randomised fish beating their tails in turbulent flow, NumPy."""
    from fishmj import engines
    from fishmj.tasks import station_hold as task
    from fishmj.water import flow

    rng = np.random.default_rng(SEED)
    params, _ = task.draw_fish(np, robot, rng.random((fish, task.n_fish(robot))))
    start = task.draw_start(np, rng.random((fish, task.N_START)))
    table, cell = flow.table_of("default")
    intensity = np.full(fish, constant("turbulence", "intensity"))
    current = flow.draw(np, "default", table, cell, start.speed, start.direction, intensity, rng.random((fish, task.N_FLOW)))
    _, ticks = engines.ticks_per(robot)
    clock = np.arange(ticks) * robot.timing.bus_dt
    lag = np.arange(robot.n_joints) * np.radians(constant("calibration", "phase_lag_second_deg")[0])
    swing = np.radians(constant("calibration", "amplitude_deg"))
    beat = swing * np.sin(2 * np.pi * constant("calibration", "frequency") * clock[:, None] - lag)
    commands = np.broadcast_to(beat, (fish, *beat.shape)).copy()
    return engines.at_rest(robot, start.pose), commands, params, current, np.zeros(fish, np.int32)


def _engine(name: str, fish: int, chunks: int) -> BenchmarkWork:
    """`chunks` control steps of `fish` fish per run; on an engine that jits, all in one compiled scan."""
    from fishmj import engines

    robot = swimming()
    try:
        engine = engines.make(name, robot)
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("fishmj."):
            raise
        raise NotHere(f"this build has no engine {name}") from error
    state, commands, params, current, tick = _school(robot, fish)
    run, where = (_compiled if getattr(engine, "jittable", False) else _stepped)(
        engine, state, commands, params, current, tick, chunks
    )
    return finite_work(run, name, fish * chunks, f"{where}, water {label(robot)}")


def finite_work(run, what: str, amount: float, where: str = "cpu") -> BenchmarkWork:
    """Runs the work once as a warm-up. Raises NotHere if the state of the fish is not finite."""
    if not np.all(np.isfinite(run())):
        raise NotHere(f"the state of {what} is not finite, so its rate means nothing")
    return BenchmarkWork(run, amount, where)


def _stepped(engine, state, commands, params, current, tick, chunks):
    def run():
        now, clock = state, tick
        for _ in range(chunks):
            now, _ = engine.advance(now, commands, params, current, clock)
            clock = clock + commands.shape[1]
        return np.asarray(now.q)

    return run, "cpu"


def on_device(tree):
    """The tree on JAX's device, its floats in single precision."""
    import jax

    single = lambda a: np.asarray(a, np.float32) if np.asarray(a).dtype == float else a
    return jax.device_put(jax.tree.map(single, tree))


def _compiled(engine, state, commands, params, current, tick, chunks):
    import jax
    from jax import lax

    state, commands, params, current = on_device((state, commands, params, current))

    @jax.jit
    def swim(state, commands, params, current, tick):
        def chunk(carry, _):
            now, clock = carry
            now, _ = engine.advance(now, commands, params, current, clock)
            return (now, clock + commands.shape[1]), None

        (now, _), _ = lax.scan(chunk, (state, tick), None, length=chunks)
        return now.q

    device = jax.devices()[0]
    return lambda: np.asarray(swim(state, commands, params, current, tick)), device.device_kind


def _on_gpu() -> bool:
    import jax

    return jax.default_backend() == "gpu"


def _sized(name: str, gpu: int, cpu: int, fast: int, chunks: int, few: int, quick: bool) -> BenchmarkWork:
    """`_engine` with the fish count for a GPU, a CPU, or --quick (fast), and `chunks` control steps, or `few` with --quick."""
    return _engine(name, gpu if gpu and _on_gpu() else fast if quick else cpu, few if quick else chunks)


for _name, _said, _sizes in (
    ("planar", "Closed-form planar fish in JAX.", (131072, 256, 256, 10, 2)),
    ("compiled", "Closed-form planar fish compiled for the CPU.", (0, 4096, 256, 5, 2)),
    ("batch", "MuJoCo in C, many fish at once, with the water.", (0, 256, 64, 4, 1)),
    ("mjx", "MuJoCo in JAX with the water.", (16384, 128, 16, 2, 1)),
):
    add(f"engine_{_name}", "control steps/s", _said, partial(_sized, _name, *_sizes), bare_mujoco)


@benchmark("environment", "control steps/s", baseline=bare_mujoco)
def environment(quick: bool) -> BenchmarkWork:
    """Station holding in JAX: closed form plus observation, camera, noise, reward, new episodes."""
    import jax
    from jax import lax

    from fishmj.tasks.env import StationHold

    fish, chunks = 65536 if _on_gpu() else 256, 2 if quick else 10
    env = StationHold(swimming())
    start = env.reset(jax.random.key(SEED), fish, True)
    action = jax.random.uniform(jax.random.key(SEED + 1), (chunks, fish, env.n_act), minval=-0.5, maxval=0.5)
    swim = jax.jit(lambda state, actions: lax.scan(lambda s, a: (env.step(s, a), s.reward), state, actions)[1])
    run = lambda: np.asarray(swim(start, action))
    return finite_work(run, "the environment", fish * chunks, f"{jax.devices()[0].device_kind}, water {label(env.robot)}")
