"""Second simulator of the robotic fish, independent of the strip model that is fitted to data: a generator of blind tests.

It shares only the outline, the masses and the servo data with the first; see docs/search/virtual_robot.md.

    generate(effects, excitations, seed) -> [Trial]     trials with hidden effects
    plant(effects, seed) -> RobotConstants              constants of such a robot
    EFFECTS                                             effects that can be hidden: the catalogue and families outside it
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fishmj.gap.laboratory.virtual_robot.closed_loop_robot import ClosedLoopRobot
    from fishmj.gap.laboratory.virtual_robot.trials import EFFECTS, generate, plant

__all__ = ["EFFECTS", "ClosedLoopRobot", "generate", "plant"]


def __getattr__(name: str) -> Any:
    """Loads numba at first use only."""
    if name == "ClosedLoopRobot":
        from fishmj.gap.laboratory.virtual_robot.closed_loop_robot import ClosedLoopRobot

        return ClosedLoopRobot
    if name in __all__:
        from fishmj.gap.laboratory.virtual_robot import trials

        return getattr(trials, name)
    raise AttributeError(f"module 'fishmj.gap.laboratory.virtual_robot' has no attribute {name!r}")
