"""A steady current that the model does not have."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def flow(xp, p, place):
    """U' = U + (c_x, c_y)."""
    return place._replace(u=place.u + p.x, v=place.v + p.y)


EFFECT = Effect(
    name="steady_current",
    stage="environment",
    about="water moves over ground by a constant velocity: drift that is fixed in the tank's frame",
    formula="U' = U + (c_x, c_y)",
    source="paper, flow tank: up to 0.4 m/s set; residual currents of 0.03 m/s are usual",
    parameters=(
        Parameter(name="x", unit="m/s", low=-0.3, high=0.3, typical=(0.01, 0.05)),
        Parameter(name="y", unit="m/s", low=-0.3, high=0.3, typical=(0.01, 0.05)),
    ),
    handed=("y",),
    shows=("position",),
    native="option wind (MuJoCo's own fluid only)",
    confusions=(
        Confusion("camera_yaw", "a turned camera turns tracks, a current moves a resting fish", ("drift_east", "drift_north")),
        Confusion("joint_zero_offset", "an offset turns with the fish, a current does not", ("drift_east", "gait_mirrored")),
    ),
    flow=flow,
)
