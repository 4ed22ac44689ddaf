"""The motor's rotor turns with the joint."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def fields(site, p):
    """MuJoCo's armature."""
    site.m.dof_armature[site.dof] += p.inertia


EFFECT = Effect(
    name="rotor_inertia",
    stage="actuator",
    about="rotor and gears turn N times as fast as the joint: an inertia J N^2 that no link shows",
    formula="tau = -J N^2 dw/dt",
    source="quasi-direct drives: 0.001 to 0.05 kg m2 at the joint; hobby servos 0.002 to 0.02",
    native="joint armature",
    robot=RobotForm(
        site="joint",
        scale="inertia",
        parameters=(Parameter(name="inertia", unit="kg m2", low=0.0, high=10.0, typical=(0.02, 0.3)),),
        fields=fields,
        confusions=(Confusion("link_inertia", "a rotor does not turn with the joints before it: move those alone"),),
    ),
)
