"""The links of a robot as a viewer draws them: the hull through its sections, and its fins."""

from fishmj.log.foxglove import Solid
from fishmj.mjcf.description import Robot
from fishmj.mjcf.drawing import colour_of
from fishmj.mjcf.geometry import geometry_of


def solids(robot: Robot) -> tuple[Solid, ...]:
    """One solid a link, nose first: the same hull and fin plates as in the robot's MuJoCo model."""
    from fishmj.mjcf.visual_geometry import fin_plates, loft

    g, out = geometry_of(robot), []
    for i, (link, front) in enumerate(zip(robot.links, [g.reference, *g.origin[1:]], strict=True)):
        plates = [plate for fin in robot.fins if fin.link == link.name for plate in fin_plates(robot, g, fin)]
        out.append(Solid(link.name, float(front), *loft(robot, g, i), tuple(plates), colour_of(robot, i)))
    return tuple(out)
