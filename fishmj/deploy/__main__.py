"""From the simulator to the tank: a policy on a robot, on a robot in loopback, and what a lab measures on its rig."""

import sys

from fishmj import console
from fishmj.console import Command
from fishmj.deploy.rig_commands import COMMANDS as RIG

COMMANDS = {
    "swim": Command(
        "fishmj.deploy.swim_command",
        "a policy swims: camera, 50 Hz bus, supervisor, trial folder",
        "fishmj deploy swim --policy station --link loopback --seconds 30",
    ),
    "loopback": Command(
        "fishmj.loopback.command",
        "a robot without a fish, on this computer, faults included",
        "fishmj deploy loopback --fault loss=0.02 --flow 0.2,3.14",
    ),
    "track": Command(
        "fishmj.deploy.track_command",
        "the fish in a video file, as a trial, with an overlay video",
        "fishmj deploy track swim.mp4 --calibration tank.toml --out runs/swim",
    ),
    "calibrate-camera": Command(
        "fishmj.deploy.camera_command",
        "pixels to metres: lens from pictures of a board, tank from its marks",
        "fishmj deploy calibrate-camera --pictures board --board 9x6 --square 0.025 --marks marks.toml --out tank.toml",
    ),
    "monitor": Command(
        "fishmj.deploy.monitor_command", "when robot and model parted, and in which channel", "fishmj deploy monitor runs/swim_07"
    ),
    "firmware-policy": Command(
        "fishmj.deploy.firmware_command",
        "a policy as a C header, for a robot that computes it itself",
        "fishmj deploy firmware-policy station --out policy_constants.h",
    ),
    "doctor": Command("fishmj.deploy.doctor_command", "what is plugged in, and what is installed", "fishmj deploy doctor"),
}
COMMANDS |= RIG

main = console.CommandGroup("deploy", __doc__ or "", COMMANDS)


if __name__ == "__main__":
    sys.exit(console.run(main))
