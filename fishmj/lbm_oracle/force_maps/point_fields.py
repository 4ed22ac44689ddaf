"""The water around the held fish of a force map, at the end of its point.

fields/joint_joint20_aoa0.npz              the slice
fields/joint_joint20_aoa0.png              its speed; ..._vorticity.png its vorticity
fields/joint_joint20_aoa0.vti, .vtp        with --volume: box and fish for ParaView
velocity_joint.png, velocity_aoa.png       all points of a map side by side, on one scale
"""

from collections.abc import Sequence
from pathlib import Path

from fishmj.lbm_oracle.force_maps.force_points import Point
from fishmj.lbm_oracle.output import slice_plots
from fishmj.lbm_oracle.output.record_fields import slice_of, write_volume
from fishmj.lbm_oracle.output.slices import read_slice, write_slice
from fishmj.lbm_oracle.run.run import Run
from fishmj.mjcf.skin import skin

TOP = 1.6  # of the current's speed, end of the colour scale


def slice_path(out: Path, point: Point) -> Path:
    """Path of the slice of a point in the folder `out`."""
    return out / "fields" / f"{point.what}_joint{point.joint:g}_aoa{point.aoa:g}.npz"


def keep(run: Run, out: Path, point: Point, *, z: float | None = None, whole: bool = False) -> None:
    """Writes slice and pictures of a finished point, the slice last: if it exists, the others do too."""
    one, path = slice_of(run, z), slice_path(out, point)
    title = f"{point.title}, {point.speed:g} m/s, the water moves to the left{', stopped early' if run.stopped else ''}"
    slice_plots.panels([("", one)], path.with_suffix(".png"), title, TOP * point.speed)
    slice_plots.SlicePicture().write(path.with_name(f"{path.stem}_vorticity.png"), one, f"{title}, ")
    if whole:
        write_volume(run, path.with_suffix(".vti"), path.with_suffix(".vtp"), skin(run.robot, smooth=True))
    write_slice(path, one)


def panels(out: Path, points: Sequence[Point]) -> list[Path]:
    """Draws the speed of the water at all points of a map that have a slice."""
    drawn = []
    for what in ("joint", "aoa"):
        here = [point for point in points if point.what == what and slice_path(out, point).is_file()]
        if not here:
            continue
        named = [(f"{p.joint if what == 'joint' else p.aoa:g} deg", read_slice(slice_path(out, p))) for p in sorted(here)]
        fixed = "joint angle, AoA 0 deg" if what == "joint" else f"angle of attack, joints {here[0].joint:g} deg"
        title = f"speed of the water by {fixed}; {here[0].speed:g} m/s to the left"
        drawn.append(slice_plots.panels(named, out / f"velocity_{what}.png", title, TOP * here[0].speed))
    return drawn
