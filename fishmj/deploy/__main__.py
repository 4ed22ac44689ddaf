"""From the simulator to the tank: a policy on a robot, on a robot in loopback, and what a lab measures on its rig."""

import sys
from contextlib import ExitStack
from importlib import import_module
from typing import Any

from fishmj.base import console
from fishmj.base.console import Command
from fishmj.mjcf.description import Robot


def in_step(args: Any, robot: Robot, stack: ExitStack) -> Any:
    """Calls `loopback.lockstep.wired`, which is imported only for a robot in lockstep."""
    return import_module("fishmj.deploy.loopback.lockstep").wired(args, robot, stack)


def trials(argv: list[str]) -> int | None:
    """The command `deploy trials`, with the loopback robot that the host itself never imports. Returns the exit code."""
    return import_module("fishmj.deploy.commands.trials_command").main(argv, in_step)


COMMANDS = {
    "swim": Command(
        "fishmj.deploy.commands.swim_command",
        "a policy or a sine gait swims: camera, 50 Hz bus, supervisor, trial folder",
        "fishmj deploy swim --policy station --link loopback --seconds 30",
    ),
    "flow-map": Command(
        "fishmj.deploy.commands.flow_map_command",
        "what each pump setting makes of the water: speed, TI, length scale",
        "fishmj deploy flow-map 20=adv_20.csv 25=adv_25.csv --time Time --velocity Vx,Vy --unit cm/s --out tank_flow.toml",
    ),
    "trials": Command(
        trials,
        "the 72 trials of the protocol on the robot, into the tables of evaluate",
        "fishmj deploy trials --policy station --link loopback --yes --speeds 0.2 --los 0,180 --repeats 1 --out runs/trials",
    ),
    "loopback": Command(
        "fishmj.deploy.loopback.loopback_command",
        "a robot without a fish, on this computer, faults included",
        "fishmj deploy loopback --fault loss=0.02 --flow 0.2,180",
    ),
    "track": Command(
        "fishmj.deploy.commands.track_command",
        "the fish in a video file, as a trial, with an overlay video",
        "fishmj deploy track swim.mp4 --calibration tank.toml --out runs/swim",
    ),
    "calibrate-camera": Command(
        "fishmj.deploy.commands.camera_command",
        "pixels to metres: lens from pictures of a board, tank from its marks",
        "fishmj deploy calibrate-camera --pictures board --board 9x6 --square 0.025 --marks marks.toml --out tank.toml",
    ),
    "monitor": Command(
        "fishmj.deploy.commands.monitor_command",
        "when robot and model parted, and in which channel",
        "fishmj deploy monitor runs/swim_07",
    ),
    "firmware-policy": Command(
        "fishmj.deploy.commands.firmware_command",
        "a policy as a C header, for a robot that computes it itself",
        "fishmj deploy firmware-policy station --out policy_constants.h",
    ),
    "recover": Command(
        "fishmj.deploy.commands.recover_command",
        "the trial of a swim whose host was killed",
        "fishmj deploy recover runs/swim_07",
    ),
    "doctor": Command(
        "fishmj.deploy.commands.doctor_command", "what is plugged in, and what is installed", "fishmj deploy doctor"
    ),
    "experiment": Command(
        "fishmj.deploy.rig.rig_experiment",
        "named experiments on the robot, three repeats, for calibrate and gap find",
        "fishmj deploy experiment session --link loopback --yes --out data/loopback",
    ),
    "capture": Command(
        "fishmj.deploy.rig.rig_capture",
        "pictures of a board or of the tank's marks, for calibrate-camera",
        "fishmj deploy capture --camera 0 --count 12 --every 2 --out board",
    ),
    "print-marks": Command(
        "fishmj.deploy.commands.print_command",
        "tag and calibration board as a PDF at true scale",
        "fishmj deploy print-marks --out marks.pdf",
    ),
    "weigh": Command(
        "fishmj.deploy.rig.rig_weigh",
        "scales, knife edge and pendulum: the page of weighings of a data set",
        "fishmj deploy weigh --out data/monday/trials",
    ),
}

main = console.CommandGroup("deploy", __doc__ or "", COMMANDS)


if __name__ == "__main__":
    sys.exit(console.run(main))
