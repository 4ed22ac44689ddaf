"""Cost of a physics step for each method that couples water and fish, with and without the learnt residual.

Baselines: the strips alone for the residual, a plain `mj_step` for MuJoCo's own fluid; the table is at the end.
Nominal fish, one gait, still water; `engine_*` measure engines with randomised fish, latency and turbulence, strips alone.
"""

import atexit
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp

import numpy as np

from fishmj.base.errors import FishmjError
from studies.benchmarks import BenchmarkWork, NotHere, add
from studies.benchmarks.engines import finite_work, on_device

MODEL, FISH, SECONDS = "swift", 256, 2.0
FISH_COMPILED = 4096
MEMBERS, HIDDEN = 5, 16  # ensemble members and hidden units of the default residual


def robot_of(learnt: bool, made_up: bool = True):
    """Shipped fish in the shipped fitted water, without its residual, with it, or with a made-up one of the usual shape.

    The made-up weights are small; the cost does not depend on them, and the shipped fit may have no residual.
    """
    from fishmj.engines import in_water
    from fishmj.mjcf import load_robot

    try:
        return in_water(load_robot("fish"), (_with_residual() if made_up else MODEL) if learnt else f"{MODEL}-base")
    except FishmjError as error:
        raise NotHere(f"no fitted water {MODEL}: {error}") from error


@cache
def _with_residual() -> Path:
    """File of the shipped fit with a made-up residual."""
    from fishmj.water import residual_hooks, residual_network
    from fishmj.water.hydro_model import HydroModel

    model = HydroModel.load(MODEL)
    net = residual_network.blank(len(model.base.k), MEMBERS, HIDDEN, seed=0)
    net = net._replace(outer=0.01 * np.random.default_rng(0).standard_normal(net.outer.shape))
    learnt = residual_hooks.Residual(net, residual_hooks.unlimited(len(model.base.k)))
    folder = Path(mkdtemp())
    atexit.register(rmtree, folder, ignore_errors=True)
    return replace(model, name="bench", learnt=learnt).save(folder)


def _beat(t, joints: int) -> np.ndarray:
    """A gait of 1 Hz that grows in the first second, (.., J) rad."""
    t = np.asarray(t, float)[..., None]
    return np.minimum(t, 1.0) * 0.4 * np.sin(2 * np.pi * t - np.arange(joints))


# one fish in MuJoCo


def _alone(quick: bool, water: str) -> BenchmarkWork:
    """One fish by `mj_step`; water: none, ellipsoid, passive (strips), residual (the same way) or wrench (xfrc_applied)."""
    from contextlib import nullcontext

    import mujoco

    from fishmj import mjcf
    from fishmj.engines.extensions import Extensions
    from fishmj.water.dynamics import planar_chain
    from fishmj.water.injection import inject
    from fishmj.water.link_wrench import LinkWrench
    from fishmj.water.planar_water import PlanarWater

    robot = robot_of(water in ("residual", "wrench"))
    model = mjcf.build(robot, bare=True, ellipsoid=water == "ellipsoid")
    steps = 200 if quick else 1000
    beat = _beat(np.arange(steps) * robot.timing.physics_dt, robot.n_joints)
    swimmer, learnt = planar_chain.nominal(robot), Extensions.of(robot).learnt

    def run():
        data, strips = mujoco.MjData(model), PlanarWater(robot, swimmer, learnt=learnt)
        solo = LinkWrench(model, strips) if water == "wrench" else None
        with inject(model, strips) if water in ("passive", "residual") else nullcontext(solo) as fish:
            for target in beat:
                data.ctrl[:] = target
                fish.step(data) if fish else mujoco.mj_step(model, data)
        return data.qpos.copy()

    return finite_work(run, water, steps)


# engines: many fish


def _engine(name: str, quick: bool, learnt: bool = False, fish: int = FISH) -> BenchmarkWork:
    """One control step of `fish` fish by an engine, compiled where it can be."""
    from fishmj import engines
    from fishmj.water.flow import Flow, stack

    robot = robot_of(learnt)
    engine = engines.make(name, robot)
    steps, ticks = engines.ticks_per(robot)
    fish = fish // 8 if quick else fish
    beat = _beat(1.0 + np.arange(ticks) * robot.timing.bus_dt, robot.n_joints)
    state = engines.at_rest(robot, np.zeros((fish, 3)))
    given = (state, np.tile(beat, (fish, 1, 1)), engines.nominal_params(robot, fish), stack([Flow()] * fish))
    advance, where = engine.advance, "cpu"
    if getattr(engine, "jittable", False):
        import jax

        given, advance = on_device(given), jax.jit(engine.advance)
        where = jax.devices()[0].device_kind
    tick = np.zeros(fish, np.int32)
    return finite_work(lambda: np.asarray(advance(*given, tick)[0].q), name, fish * ticks * steps, where)


def hydro_mjx_residual(quick: bool) -> BenchmarkWork:
    """Strips and residual in MJX. Raises NotHere: with --quick."""
    if quick:
        raise NotHere("compiling MJX with the residual takes half a minute of CPU; run it without --quick")
    return _engine("mjx", quick, True)


# closed form in JAX, a long swim


def _swim(quick: bool, learnt: bool) -> BenchmarkWork:
    """Free swims of `FISH` fish by one gait in the shipped fitted water, single precision, one compiled scan."""
    from fishmj.hydro_fit.fit.rollout import FishBatch, SwimWindow
    from fishmj.mjcf import load_robot
    from fishmj.water.dynamics import planar_chain
    from fishmj.water.hydro_model import HydroModel
    from fishmj.water.prior import flat

    robot = load_robot("fish")
    try:
        model = HydroModel.load(_with_residual())
    except FishmjError as error:
        raise NotHere(f"no fitted water {MODEL}: {error}") from error
    ch, tick = planar_chain.chain_of(robot), robot.timing.bus_dt
    ticks, steps = round((0.5 if quick else 1.0) * SECONDS / tick), round(tick / ch.dt)
    beat = _beat(np.arange(ticks * steps) * ch.dt, robot.n_joints)
    target = np.broadcast_to(beat.reshape(ticks, steps, -1), (FISH, ticks, steps, robot.n_joints))
    state, none = np.zeros((FISH, ticks + 1, ch.n + 2)), np.zeros((FISH, ticks))
    still = np.zeros((FISH, ticks, ch.n, 2))
    fleet = FishBatch(state, state, target, still, still[:, :, 0], none, none + 1, ((0, 0),) * FISH)
    swim, water = SwimWindow(ch, planar_chain.nominal(robot)), flat(model.base)
    return finite_work(lambda: swim.run(fleet, water, model.learnt if learnt else None).q, "the swim", FISH * ticks * steps)


passive, residual = partial(_alone, water="passive"), partial(_alone, water="residual")
bare_steps, many, compiled = (
    partial(_alone, water="none"),
    partial(_engine, "batch"),
    partial(_engine, "compiled", fish=FISH_COMPILED),
)
for _name, _said, _prepare, _baseline in (
    ("passive", "Strips through mjcb_passive in NumPy, one fish.", passive, bare_steps),
    ("passive_residual", "Strips and residual through mjcb_passive in NumPy, one fish.", residual, passive),
    ("wrench_residual", "Strips and residual as wrenches of the links in xfrc_applied, in NumPy, one fish.",
     partial(_alone, water="wrench"), residual),
    ("ellipsoid", "MuJoCo's own fluid, one fish.", partial(_alone, water="ellipsoid"), bare_steps),
    ("batch_residual", "Strips and residual in MuJoCo's C engine, a batch, qfrc_applied by the compiled closed form.",
     partial(many, learnt=True), many),
    ("compiled_residual", "Strips and residual in the compiled engine; 50 physics steps are a control step.",
     partial(compiled, learnt=True), compiled),
    ("mjx_residual", "Strips and residual in MJX, a batch; not with --quick.", hydro_mjx_residual, partial(_engine, "mjx")),
    ("residual", "Strips with the learnt residual, a batch of fish in JAX.",
     partial(_swim, learnt=True), partial(_swim, learnt=False)),
):  # fmt: skip
    add(f"hydro_{_name}", "physics steps/s", _said, _prepare, _baseline)
