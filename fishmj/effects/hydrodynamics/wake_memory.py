"""The tail's water force follows its motion with a lag."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def water(xp, p, w, memory, h):
    """m' = m + (1 - e^(-h/T)) (f - m) for drag and trailing edge of the last link; the added mass stays immediate."""
    share = xp.where(p.time > 0.0, 1.0 - xp.exp(-h / xp.where(p.time > 0.0, p.time, 1.0)), 1.0)
    last, fast = w.forces[-1], w.instant[-1]
    kept = tuple(share * (f - i) + (1.0 - share) * m for f, i, m in zip(last, fast, memory, strict=True))
    # forces + (memory - replaced part), so that a time constant of zero is exact
    slow = tuple(f + (k - (f - i)) for f, i, k in zip(last, fast, kept, strict=True))
    return w._replace(forces=[*w.forces[:-1], slow]), kept


EFFECT = Effect(
    name="wake_memory",
    stage="hydrodynamics",
    about="circulation needs time to build: thrust lags at starts and rolls off with frequency",
    formula="T dm/dt = f - m; the tail feels m in place of f (drag and trailing edge)",
    source="Wagner 1925: chord over speed, 0.1 to 0.4 s",
    parameters=(Parameter(name="time", unit="s", low=0.0, high=1.0, typical=(0.05, 0.3)),),
    shows=("position", "heading", "power"),
    confusions=(
        Confusion("command_latency", "acts on the force, the joints do not lag", ("chirp", "impulse")),
        Confusion("tail_normal_force", "changes with frequency", ("chirp", "gait")),
        Confusion("skin_hysteresis", "not in air", ("square", "hold_angles")),
    ),
    memory=(0.0, 0.0, 0.0),
    water=water,
)
