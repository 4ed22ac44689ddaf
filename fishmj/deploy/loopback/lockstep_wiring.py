"""Wires the loopback robot to the host's own commands, in this process and in lockstep: no second process, no waiting.

    trials_command.main([..., "--link", "loopback", "--yes"], in_step=wired)
    rig_experiment.main([..., "--link", "loopback", "--yes"], wire=wired)

No camera is drawn: the host gets poses with a tracker's errors and the delay of frames.
"""

import shlex
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from fishmj.deploy.camera.localiser import InStep
from fishmj.deploy.link.links import Fishmj1Link, MishLink, RobotLink
from fishmj.deploy.loop.wiring import Wired, servo_link
from fishmj.deploy.loopback import loopback_command
from fishmj.deploy.loopback.firmware import SERVO_BUS
from fishmj.deploy.loopback.lockstep import (
    FixNoise,
    LockstepCamera,
    LockstepClock,
    LockstepSerial,
    LockstepTransport,
    PoseTracker,
)
from fishmj.deploy.loopback.loopback_settings import make_robot
from fishmj.deploy.loopback.robot import LoopbackRobot
from fishmj.mjcf.description import Robot


def wired(
    args: Any, robot: Robot, stack: ExitStack, clock: Callable[[LoopbackRobot], LockstepClock] = LockstepClock,
    noise: FixNoise | None = None,
) -> Wired:  # fmt: skip
    """Replaces `deploy.wiring.wire`.

    Args:
        args: `loopback` are the options of `deploy loopback`; `robot` and `protocol` as in the host's command.
        clock: makes the clock that moves the robot. noise: of the fixes; None: a tag's on clean frames, as measured.
    """
    words = ["--protocol", args.protocol, "--model", args.robot, *shlex.split(args.loopback or "")]
    settings = loopback_command.served(loopback_command.options().parse_args(words)).settings
    made = clock(make_robot(settings))
    transport = LockstepTransport(made)
    link: RobotLink
    if settings.protocol == SERVO_BUS:
        link = servo_link(args, robot, made, lambda _: LockstepSerial(made))
    elif settings.protocol == "fishmj-1":
        link = Fishmj1Link(transport)
    else:
        link = MishLink(transport, "fixed" if settings.protocol == "mish-fixed" else "mish-0.1.0")
    localiser = InStep(LockstepCamera(made), PoseTracker(noise, settings.seed))
    for part in (link, localiser):
        part.open()
        stack.callback(part.close)
    return Wired(link, localiser, made, True)
