"""What the watch sees of the water, summed on the device and sent to the host while both go on."""

from typing import NamedTuple

import numpy as np
import warp as wp

from fishmj.lbm_oracle.fluid import fields

PLANES = 8  # that a thread of an accelerator looks through; all of them on the CPU


class Survey(NamedTuple):
    """Lattice units."""

    rho_min: float
    rho_max: float
    speed: float  # greatest |u|
    mass: float  # sum of rho - 1
    lost: int  # nodes that are not finite


class Surveyor:
    """Surveys of one box of water on one device; what it found is kept by columns of y, so that few threads add to one number."""

    def __init__(self, shape: tuple[int, int, int], device):
        self.device, self.planes = device, PLANES if device.is_cuda else shape[0]
        self.dim = (-(-shape[0] // self.planes), *shape[1:])
        kinds = (wp.float32, wp.float32, wp.float32, wp.float64, wp.int32)  # least, greatest drho, greatest u^2, sum, lost
        self.found = [wp.zeros(shape[1], dtype=kind, device=device) for kind in kinds]
        self.on_host = [wp.zeros(shape[1], dtype=kind, device="cpu", pinned=device.is_cuda) for kind in kinds]

    def start(self, params, f: wp.array, u: wp.array) -> None:
        """Queue one survey, and the copies of what it finds, on the present stream."""
        for column in self.found:
            column.zero_()
        wp.launch(fields.survey, dim=self.dim, inputs=[params, f, u, self.planes, *self.found], device=self.device)
        for near, far in zip(self.on_host, self.found, strict=True):
            wp.copy(near, far)

    def result(self) -> Survey:
        """Of the last one, once the device is through with it."""
        low, high, fast, mass, lost = (column.numpy() for column in self.on_host)
        return Survey(1 + float(low.min()), 1 + float(high.max()), float(np.sqrt(fast.max())), float(mass.sum()), int(lost.sum()))
