"""Wind blows at the robot."""

from fishmj.effects.effect import Effect, Parameter, RobotForm

AIR = 1.2  # kg/m3


def fields(site, p):
    """MuJoCo's wind in a medium of at least the density of air."""
    site.m.opt.density = max(site.m.opt.density, AIR)
    site.m.opt.wind[:] += p.x, p.y, p.z


EFFECT = Effect(
    name="steady_wind",
    stage="environment",
    about="a fan, or weather, pushes links that are large for their weight",
    formula="F = rho/2 C A |w - v| (w - v)",
    source="fans 3 to 6 m/s",
    native="option wind, density",
    robot=RobotForm(
        site="robot",
        parameters=tuple(Parameter(name=n, unit="m/s", low=-40.0, high=40.0, typical=(2.0, 12.0)) for n in "xyz"),
        fields=fields,
    ),
)
