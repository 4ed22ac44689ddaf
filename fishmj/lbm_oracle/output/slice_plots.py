"""Pictures of slices: vorticity with the fish in it, one PNG for each frame; velocity panels of a force map, one PNG a map."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base.figures import OPEN, canvas, save, style
from fishmj.lbm_oracle.output.slices import STRONG, Slice
from fishmj.mjcf.skin import posed, skin

FISH, INK = "#2B3440", "#3A4350"
COLOURS = ("#0B3C5D", "#328CC1", "#3A9D5D", "#D9902F", "#B3392F", "#7A4B94")  # of lines, in their order
STYLE = OPEN | {"font.size": 10, "axes.titlesize": 11}


def outline(run) -> list[np.ndarray]:
    """Hull seen from above, one closed line (P, 2) m."""
    hull = skin(run.robot, spacing=0.01, around=4, smooth=True, details=False)
    rings = posed(hull, np.concatenate([run.pose[:3], run.angles()]))[:-2, :2].reshape(-1, 4, 2)
    return [np.concatenate([rings[:, 0], rings[::-1, 2]])]


class SlicePicture:
    """One figure that is redrawn for every frame: new axes would take most of the time.

    strong: vorticity at the ends of the colour scale, 1/s, the same for a whole run.
    """

    def __init__(self, strong: float = STRONG):
        self.strong = strong
        self.figure: Any = None

    @style(STYLE)
    def write(self, path: Path, one: Slice, title: str = "") -> Path:
        """Draws the vorticity of a slice with the outline of the fish."""
        if self.figure is None:
            self._make(one)
        self.image.set_data(one.omega_z.T)
        west, east, south, north = one.extent
        self.image.set_extent(one.extent)
        self.axis.set(xlim=(west, east), ylim=(south, north))
        self.axis.set_title(f"{title}t = {one.t:.2f} s", loc="left")
        for old in list(self.axis.patches):
            old.remove()
        draw_fish(self.axis, one)
        return save(self.figure, path, dpi=110)

    def _make(self, one: Slice) -> None:
        wide = len(one.y) / len(one.x)
        self.figure, ((self.axis,),) = canvas(1, 1, (8.6, 7.2 * wide + 0.9))
        self.image = self.axis.imshow(
            one.omega_z.T, origin="lower", vmin=-self.strong, vmax=self.strong, cmap="RdBu_r", interpolation="bilinear"
        )
        bar = self.figure.colorbar(self.image, ax=self.axis, shrink=0.85, pad=0.02, extend="both")
        bar.set_label(r"vorticity $\omega_z$ [1/s]   (red: counter-clockwise)", color=INK)
        self.axis.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")


def draw_fish(axis, one: Slice) -> None:
    """Draws the hull from above."""
    for link in one.outline:
        axis.fill(link[:, 0], link[:, 1], facecolor=FISH, edgecolor=FISH, lw=0.8, joinstyle="round")


@style(STYLE)
def panels(slices: Sequence[tuple[str, Slice]], path: Path, title: str, top: float) -> Path:
    """Draws the horizontal speed of slices with their fish, one panel each, on one colour scale from 0 to `top` m/s."""
    columns = min(4, len(slices))
    rows, wide = -(-len(slices) // columns), 3.4 if len(slices) > 1 else 8.0
    west, east, south, north = slices[0][1].extent
    high = wide * (north - south) / (east - west)
    size = (wide * columns + 1.2, (0.92 * high + 0.3) * rows + 0.7)
    figure, axes = canvas(rows, columns, size, sharex=True, sharey=True)
    for axis, (name, one) in zip(axes.flat, slices, strict=False):
        shown = {"origin": "lower", "extent": one.extent, "aspect": "equal", "interpolation": "bilinear"}
        image = axis.imshow(one.speed.T, vmin=0, vmax=top, cmap="viridis", **shown)
        draw_fish(axis, one)
        axis.set_title(name, loc="left", fontsize=10)
    for axis in axes.flat[len(slices) :]:
        axis.set_visible(False)
    figure.supxlabel("x [m]", fontsize=10)
    figure.supylabel("y [m]", fontsize=10)
    figure.suptitle(title, fontsize=11)
    figure.colorbar(image, ax=axes, label="|u| [m/s]", shrink=0.9, pad=0.02, extend="max")
    return save(figure, path, dpi=110)
