"""Commands of `fishmj deploy` for what a lab measures on its rig: experiments and weighing."""

from fishmj.console import Command

COMMANDS = {
    "experiment": Command(
        "fishmj.deploy.rig_experiment",
        "named experiments on the robot, three repeats, for calibrate and gap find",
        "fishmj deploy experiment session --link loopback --yes --out data/loopback",
    ),
    "weigh": Command(
        "fishmj.deploy.rig_weigh",
        "scales, knife edge and pendulum: the page of weighings of a data set",
        "fishmj deploy weigh --out data/monday/trials",
    ),
}
