"""The same swim in a window that follows and in a tank that stands, along the grid and across it.

World-frame velocities in a window that moves by whole cells: nothing may change but what the faces and the grid's axes do.
"""

from math import radians

import numpy as np

from fishmj.lbm_oracle.cases import about, register, reported
from fishmj.lbm_oracle.run.domain import Domain, preset, tank
from fishmj.lbm_oracle.run.gait import Gait
from fishmj.lbm_oracle.run.setup import SwimSetup

HEADINGS = (0.0, 30.0, 90.0)  # deg


def cruise(domain: Domain, device: str, *, heading: float = 0.0, seconds: float = 4.0, **options) -> float:
    """Speed over the last two beats of the calibration swim, m/s."""
    start = (-0.4 * np.cos(radians(heading)), -0.4 * np.sin(radians(heading)), radians(heading))
    run, gait = SwimSetup(domain=domain, device=device, pose=start, **options).run(latency=0.0), Gait.of_the_paper()
    for _ in range(round(seconds / run.robot.timing.bus_dt)):
        run.tick(gait(run.time))
    truth = run.trial().table("truth")
    last = truth["t"] > seconds - 2.0 - 1e-9
    x, y, t = truth["x"][last], truth["y"][last], truth["t"][last]
    return float(np.hypot(x[-1] - x[0], y[-1] - y[0]) / (t[-1] - t[0]))


@register("fish_headings", rung=15.1, grid="80 x 56 x 30 window, 130 x 130 x 30 tank, dx = 2 cm", source="symmetry")
def fish_headings(device):
    """Cruise in a window and in a tank, three headings."""
    window, still = preset("laptop"), tank("pond", (2.6, 2.6, 0.6), 0.02, 0.004)
    speeds = {heading: cruise(window, device, heading=heading) for heading in HEADINGS}
    yield reported("speed in the window, heading 0, m/s", speeds[0.0])
    for heading in HEADINGS[1:]:
        yield about(f"speed at heading {heading:g} deg over that at 0", speeds[heading] / speeds[0.0], 1.0, 0.03)
    yield about("speed in the tank over that in the window", cruise(still, device) / speeds[0.0], 1.0, 0.03)
