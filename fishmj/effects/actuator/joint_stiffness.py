"""A spring across a joint."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def fields(site, p):
    """MuJoCo's joint spring about its own rest angle."""
    site.m.jnt_stiffness[site.joint] += p.stiffness


EFFECT = Effect(
    name="joint_stiffness",
    stage="actuator",
    about="cables, hoses or a flexible cover pull a joint to its rest angle",
    formula="tau = -k (q - q_rest)",
    source="cable bundles of small arms: 0.02 to 0.5 N m/rad",
    native="joint stiffness",
    robot=RobotForm(
        site="joint",
        scale="stiffness",
        parameters=(Parameter(name="stiffness", unit="N m/rad", low=0.0, high=2.0, typical=(0.03, 0.3)),),
        fields=fields,
        confusions=(Confusion("joint_zero_offset", "a spring grows with the angle: turn the robot's base"),),
    ),
)
