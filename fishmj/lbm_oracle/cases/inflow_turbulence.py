"""Synthetic turbulence carried into the open box: checks its intensity and integral length at the target.

    TI = u_rms / U,   L = U integral of the autocorrelation of u along the stream, to its first zero

One record of a minute holds some forty eddies, so its statistics scatter by a fifth. The prescribed undisturbed flow is therefore
read at the same points and times, and the oracle's statistics are compared with these. Over many records the prescribed flow has
the nominal statistics, so the oracle's are nominal times the ratio of the two. Only horizontal components are judged: free slip
above and below lets no water through, and takes a third of the vertical component.
"""

import numpy as np

from fishmj.base.calib import constant
from fishmj.lbm_oracle.cases import about, register, reported
from fishmj.lbm_oracle.cases.maps import autocorrelation
from fishmj.lbm_oracle.fluid.domain_faces import channel
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.water.flow import LENGTH, Flow

SPEED = 0.3  # m/s
SHAPE, DX, DT = (60, 40, 16), 0.04, 0.008
DURATION, EVERY = 64.0, 10  # s, steps between two samples
PROBES = ((0.0, -0.24), (0.0, 0.0), (0.0, 0.24), (0.3, 0.0))  # m, from the target at the middle


def figures(u: np.ndarray, interval: float, speed: float) -> tuple[np.ndarray, float]:
    """RMS of each component [m/s] (3,) and integral length along the stream [m] of records u (T, P, 3), stream along x."""
    part = u - u.mean(0)
    rms = np.sqrt(np.mean(part**2, (0, 1)))
    return rms, float(np.sum(autocorrelation(part[:, :, 0])) - 0.5) * interval * speed


def record(flow: Flow, device: str) -> tuple[np.ndarray, np.ndarray]:
    """Velocities at the probes in the oracle and in the undisturbed flow, each (T, P, 3) m/s."""
    x, y, z = (-(n - 1) / 2 * DX for n in SHAPE)
    lattice = Lattice(dx=DX, dt=DT, corner=(x, y, z))
    water = Fluid(lattice, SHAPE, device, boundaries=channel(), flow=flow)
    nodes = np.rint(lattice.to_lu([(*probe, 0.0) for probe in PROBES])).astype(int)
    points = lattice.to_si(nodes)
    through = SHAPE[0] * DX / flow.speed
    water.run(round(through / DT))
    found, asked = [], []
    for _ in range(round(DURATION / DT / EVERY)):
        water.run(EVERY)
        found.append(water.velocity()[tuple(nodes.T)])
        asked.append(flow.at(points, water.time))
    return np.array(found), np.array(asked)


@register("turbulence", rung=16, grid="60 x 40 x 16, dx 4 cm, 64 s", source="the prescribed flow at the same points")
def turbulence(device):
    """Intensity and integral length at the target."""
    flow = Flow(speed=SPEED, turbulence="default", intensity=constant("turbulence", "intensity"), seed=3)
    (found, asked), interval = record(flow, device), DT * EVERY
    (rms, length), (rms_asked, length_asked) = figures(found, interval, SPEED), figures(asked, interval, SPEED)
    for name, one, other in zip("uv", rms, rms_asked, strict=False):
        yield about(f"{name}_rms, m/s", one, other, 0.2)
    yield about("integral length, m", length, length_asked, 0.2)
    yield reported("w_rms, m/s", rms[2], rms_asked[2])
    ratio = np.linalg.norm(rms[:2]) / np.linalg.norm(rms_asked[:2])
    yield about("TI of u and v over many records", ratio * flow.intensity, flow.intensity, 0.2)
    nominal = LENGTH["default"]
    yield about("integral length over many records, m", length / length_asked * nominal, nominal, 0.2)
    yield about("mean speed, m/s", found.mean((0, 1))[0], asked.mean((0, 1))[0], 0.02)
