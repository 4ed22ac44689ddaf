"""The links of a robot as ellipsoids: what a viewer draws that knows no meshes."""

from fishmj.log.foxglove import Solid
from fishmj.mjcf.description import Robot
from fishmj.mjcf.drawing import colour_of
from fishmj.mjcf.geometry import geometry_of


def solids(robot: Robot) -> tuple[Solid, ...]:
    """One ellipsoid a link, nose first, as long, wide and high as the link's largest section."""
    g, out = geometry_of(robot), []
    for i, (link, front) in enumerate(zip(robot.links, [g.reference, *g.origin[1:]], strict=True)):
        high, wide = (max(section[i] for section in link.sections) for i in (1, 2))
        out.append(Solid(link.name, float(front), (link.length, wide, high), colour_of(robot, i)))
    return tuple(out)
