"""What the learnt residual costs: physics steps of a batch of fish in JAX with it, and without it as the baseline."""

import numpy as np

from fishmj.bench import NotHere, Work, benchmark
from fishmj.errors import FishmjError

MODEL, FISH, SECONDS = "fish-preview", 256, 2.0


def _swim(quick: bool, learnt: bool) -> Work:
    """Free swims of `FISH` fish by one gait in the shipped fitted water, single precision, one compiled scan."""
    from fishmj.hydro_fit import chain
    from fishmj.hydro_fit.fit.prior import flat
    from fishmj.hydro_fit.fit.rollout import Fleet, Swim
    from fishmj.hydro_fit.model import HydroModel
    from fishmj.mjcf import load_robot

    robot = load_robot("fish")
    try:
        model = HydroModel.load(MODEL)
    except FishmjError as error:
        raise NotHere(f"no fitted water {MODEL}: {error}") from error
    if model.learnt is None:
        raise NotHere(f"{MODEL} has no residual")
    ch, tick = chain.chain_of(robot), robot.timing.bus_dt
    ticks, steps = round((0.5 if quick else 1.0) * SECONDS / tick), round(tick / ch.dt)
    t = np.arange(ticks * steps)[:, None] * ch.dt
    beat = np.minimum(t, 1.0) * 0.4 * np.sin(2 * np.pi * t - np.arange(robot.n_joints))
    target = np.broadcast_to(beat.reshape(ticks, steps, -1), (FISH, ticks, steps, robot.n_joints))
    state, none = np.zeros((FISH, ticks + 1, ch.n + 2)), np.zeros((FISH, ticks))
    still = np.zeros((FISH, ticks, ch.n, 2))
    fleet = Fleet(state, state, target, still, still[:, :, 0], none, none + 1, ((0, 0),) * FISH)
    swim, water = Swim(ch, chain.nominal(robot)), flat(model.base)
    run = lambda: swim.run(fleet, water, model.learnt if learnt else None)  # noqa: E731
    if not np.isfinite(run().q).all():
        raise NotHere("the fish left the finite numbers: its rate would mean nothing")
    return Work(run, FISH * ticks * steps)


def hydro_base(quick: bool) -> Work:
    """The strips alone."""
    return _swim(quick, False)


@benchmark("hydro_residual", "physics steps/s", baseline=hydro_base)
def hydro_residual(quick: bool) -> Work:
    """Strips with the learnt residual, a batch of fish in JAX."""
    return _swim(quick, True)
