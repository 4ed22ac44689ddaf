"""A link resists turning more or less than described."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def fields(site, p):
    """All three principal inertias about the link's own centre of mass."""
    site.m.body_inertia[site.body] *= 1.0 + p.share


EFFECT = Effect(
    name="link_inertia",
    stage="inertia",
    about="the inertia of a link about its centre of mass, as from a drawing without screws and cables, is off",
    formula="I' = (1 + s) I",
    source="drawings against bifilar pendulums: 5 to 30 %",
    native="body inertial",
    robot=RobotForm(
        site="body",
        parameters=(Parameter(name="share", unit="1", low=-0.9, high=5.0, typical=(0.2, 1.0)),),
        fields=fields,
        confusions=(Confusion("rotor_inertia", "a rotor does not turn with the joints before it: move those alone"),),
    ),
)
