"""A fish in its tank to look at: floor, walls, lights, three cameras and a target. Nothing here touches the physics."""

import mujoco

from fishmj.calib import constant
from fishmj.mjcf.description import Robot
from fishmj.mjcf.model import build_spec

TARGET = "target"
COLOURS = {  # default and highlight: dm_control blends from one to the other with the reward
    "self": ((0.55, 0.58, 0.62, 1), (0.30, 0.75, 0.45, 1)),
    "effector": ((0.80, 0.65, 0.30, 1), (0.95, 0.85, 0.20, 1)),
    "target": ((0.75, 0.25, 0.20, 1), (0.20, 0.85, 0.35, 1)),
}
SHAPE = dict(contype=0, conaffinity=0)


def build_scene(robot: Robot, root: str = "planar") -> mujoco.MjSpec:
    """The robot's `MjSpec` with its surroundings; compile it outside any `inject` block.

    Bodies added to the fish: `tank` (fixed) and `target` (mocap: move it with `data.mocap_pos[0]`).
    """
    spec = build_spec(robot, root)
    for name, (default, highlight) in COLOURS.items():
        for suffix, rgba in (("", default), ("_default", default), ("_highlight", highlight)):
            spec.add_material(name=name + suffix, rgba=rgba)
    spec.add_material(name="tank", rgba=[0.55, 0.70, 0.78, 1], specular=0.0, shininess=0.0)
    spec.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.95, 0.97, 0.99], rgb2=[0.70, 0.80, 0.88], width=64, height=384,
    )  # fmt: skip
    bound, arrived = constant("task", "bound"), constant("protocol", "arrival_radius")
    _tank(spec.worldbody, bound, depth=constant("tank", "size")[2])
    target = spec.worldbody.add_body(name=TARGET, mocap=True)
    disc = dict(type=mujoco.mjtGeom.mjGEOM_CYLINDER, material="target", **SHAPE)
    target.add_geom(name="target", size=[0.02, 0.08, 0], **disc)
    target.add_geom(name="arrival", size=[arrived, 0.001, 0], pos=[0, 0, -0.09], **disc)
    head = spec.body(robot.links[0].name)
    for site in head.sites:
        site.material = "effector" if site.name == "nose" else "self"
    head.add_camera(name="follow", pos=[-1.3, 0, 0.7], xyaxes=[0, -1, 0, 0.45, 0, 1])
    spec.visual.headlight.diffuse, spec.visual.headlight.specular = [0.35] * 3, [0.0] * 3
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 960
    spec.visual.map.znear = 0.02
    return spec


def _tank(world, bound: float, depth: float) -> None:
    box = dict(type=mujoco.mjtGeom.mjGEOM_BOX, **SHAPE)
    tank = world.add_body(name="tank")
    tank.add_geom(name="floor", size=[bound, bound, 0.01], pos=[0, 0, -depth], material="tank", **box)
    for i, (name, x, y) in enumerate((("east", 1, 0), ("north", 0, 1), ("west", -1, 0), ("south", 0, -1))):
        size = [0.01, bound, 0.02] if i % 2 == 0 else [bound, 0.01, 0.02]
        tank.add_geom(name=f"{name}_edge", size=size, pos=[x * bound, y * bound, 0.02 - depth], rgba=[0.25, 0.32, 0.38, 1], **box)
    height = 2 * bound / 0.8284  # 45 degrees of view over the whole domain
    world.add_camera(name="top", pos=[0, 0, height], xyaxes=[1, 0, 0, 0, 1, 0])
    world.add_camera(name="corner", pos=[0, -1.5 * bound, 1.3 * bound], xyaxes=[1, 0, 0, 0, 0.65, 0.76])
    sun = dict(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, diffuse=[0.45] * 3, specular=[0.1] * 3)
    world.add_light(name="lamp", pos=[0, 0, height], dir=[0, 0, -1], **sun)
