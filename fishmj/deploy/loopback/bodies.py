"""Bodies of the loopback robot: one small interface for the second robot, MuJoCo and the flow solver.

A body is everything on the servo bus: joints, hull, water, battery. It knows nothing of datagrams, cameras or watchdogs.

    body = make("virtual", effects={"command_latency": {"delay": 0.02}}, seed=3)
    body.send((0.3, 0.2, 0.1))          # leaves the microcontroller now; the servos have it after the bus's delay
    body.advance(0.02)
    body.sensors().joint                # the servos' readings
    body.truth()                        # x, y, yaw, j1 ..: for the camera's picture and for scoring

The nominal command latency of a description runs from the host to the servo. The loopback's radio causes a part of it, so every
body gets the rest (`bus_delay`): no delay is applied twice.
"""

from collections.abc import Mapping

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.deploy.loopback.loopback_body import Body, Effects
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.water.flow import Flow

VIRTUAL, FITTED, STRUCTURED, SOLVER = "virtual", "fitted", "structured", "lbm"
NAMES: Mapping[str, str] = {
    VIRTUAL: "the second, independently written robot, in which effects may be hidden (default)",
    FITTED: "one fish in the water that was fitted to the flow solver",
    STRUCTURED: "one fish in the strip water of the description",
    SOLVER: "the flow solver itself; in lockstep only, it is slower than real time on a CPU",
}
MUJOCO, COMPILED = ENGINES = ("mujoco", "compiled")


def make(
    name: str = VIRTUAL, *, robot: "str | Robot" = "fish", effects: Effects | None = None, seed: int = 0, noise: float = 1.0,
    nuisance: float = 0.1, start: tuple[float, float, float] = (0.0, 0.0, 0.0), flow: Flow | None = None, radio: float = 0.0,
    engine: str = MUJOCO, domain: str = "paper",
) -> Body:  # fmt: skip
    """Makes the body of this name.

    Args:
        robot: description, TOML path or shipped name.
        effects: {name: {parameter: value}} hidden in the second robot, SI.
        seed, noise, nuisance: as `virtual_robot.trials.generate`; for the second robot only.
        start: x, y [m], yaw [rad], at rest over ground, straight. flow: background flow, still by default.
        radio: part of the nominal command latency that the caller applies itself, s.
        engine: of the waters fitted and structured, "mujoco" or, for hours in lockstep, "compiled", which is equal to it.
        domain: of the flow solver, `lbm_oracle.run.domain.preset`.

    Raises UnknownName: no such body or effect; ConfigError: effects or turbulence that this body does not support.
    """
    if name not in NAMES:
        raise UnknownName("body", name, NAMES)
    if engine not in ENGINES:
        raise UnknownName("engine of a loopback body", engine, ENGINES)
    described, stream = load_robot(robot), flow or Flow()
    if name == VIRTUAL:
        from fishmj.deploy.loopback.virtual_body import VirtualBody

        return VirtualBody(described, dict(effects or {}), seed, noise, nuisance, start, stream, radio)
    if effects:
        hidden = ", ".join(effects)
        raise ConfigError(
            f"loopback body {name!r}: --effect {hidden} hides in the second robot alone (body virtual); for MuJoCo write"
            " [[effect]] blocks in the description and pass that as the robot"
        )
    from fishmj.deploy.loopback.engine_bodies import CompiledBody, MujocoBody, SolverBody

    if name == SOLVER:
        return SolverBody(described, start, stream, radio, domain)
    return (CompiledBody if engine == COMPILED else MujocoBody)(described, name, start, stream, radio)
