"""The water far from the fish steps while fish and near water still look for their velocity: its step needs no force.

    far      planes of x that the box of the force does not touch         beside `listen` and `decide`, on a stream of its own
    near     the others                                                   after the force

Every cell is computed as in one launch over all; no part writes a cell of the other, and the next step waits for both.
"""

import warp as wp

from fishmj.lbm_oracle.fluid import Fluid

BLOCK = 8  # planes: near ones begin and end at multiples of it, so that few launches are ever recorded


def parts(first: int, count: int, planes: int) -> tuple[list, list]:
    """Near and far spans (low, high) of planes in memory, for a force on world nodes `first` to first + count - 1."""
    low, high = first // BLOCK * BLOCK, -(-(first + count) // BLOCK) * BLOCK
    if high - low >= planes:
        return [(0, planes)], []
    a, b = low % planes, low % planes + high - low
    if b <= planes:
        near, far = [(a, b)], [(b, planes), (0, a)]
    else:
        near, far = [(a, planes), (0, b - planes)], [(b - planes, a)]
    return near, [span for span in far if span[0] < span[1]]


class Ahead:
    """One fluid's steps in two parts. `stream` is the one on which everything else about it is queued."""

    def __init__(self, fluid: Fluid, stream: wp.Stream):
        self.fluid, self.stream, self.beside = fluid, stream, wp.Stream(stream.device)
        self.flow, self.recorded, self.near = fluid.flow, {}, []

    def begin(self, first: int, count: int) -> None:
        """Queue the far planes of this step; the force will act on these nodes of x."""
        fluid = self.fluid
        if fluid.flow is not self.flow:  # a new background flow has new launches
            self.flow, self.recorded = fluid.flow, {}
        near, far = parts(first, count, fluid.shape[0])
        key = fluid.parity, *near
        if key not in self.recorded:
            self.recorded[key] = [[fluid.record(*span) for span in spans] for spans in (near, far)]
        self.near, ahead = self.recorded[key]
        self.beside.wait_stream(self.stream)
        for launch in ahead:
            launch.launch(stream=self.beside)

    def end(self) -> None:
        """Queue the near planes; what comes behind them on the stream finds the whole step done."""
        for launch in self.near:
            launch.launch(stream=self.stream)
        self.join()

    def join(self) -> None:
        """What comes behind on the stream waits for the far planes."""
        self.stream.wait_stream(self.beside)
