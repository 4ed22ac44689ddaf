"""Commands of `fishmj deploy` for measurements on a lab's rig: experiments, weighing, pictures for the calibration."""

from fishmj.base.console import Command

COMMANDS = {
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
