"""A body of the user's own in a box: known answers on tiny grids, what is refused, and the order of convergence."""

import os
import re
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

pytest.importorskip("warp")

from fishmj import lbm_oracle
from fishmj.base.errors import ConfigError, OracleUnstable, UnknownName
from fishmj.lbm_oracle import Scene, cylinder, grid_study, mesh, plate, section, sphere
from fishmj.lbm_oracle.cases.sphere import clift
from fishmj.lbm_oracle.immersed import shapes, silhouettes
from fishmj.lbm_oracle.immersed.markers import WALL_STRESS
from fishmj.lbm_oracle.output import force_record
from fishmj.lbm_oracle.run.grid_study import judged

ROOT = Path(__file__).resolve().parent.parent
D, U, NU = 0.08, 0.001, 4e-6  # m, m/s, m2/s: Re 20
CUBE = """<mujoco><option gravity="0 0 0"/><worldbody><body pos="0.29 0.28 0.28">%s<geom type="sphere" size="0.04" %s/></body>
</worldbody></mujoco>"""


def tank(box=(0.64, 0.48, 0.48), dx=0.01, **options) -> Scene:
    return Scene(box, dx, NU, U, **options)


def box_surface(size) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a box of half-lengths `size` about the origin."""
    text = f'<mujoco><worldbody><body><geom type="box" size="{size[0]} {size[1]} {size[2]}"/></body></worldbody></mujoco>'
    return shapes.geom_surface(mujoco.MjModel.from_xml_string(text), 0)


def test_drag_of_a_sphere_is_that_of_the_literature():
    """Between frictionless sides 7 D apart a sphere has C_D 2.85 by interpolated bounce-back, in open water 2.735 (`duct`)."""
    scene = tank((0.56, 0.56, 0.56)).add(sphere(D), at=(0.24, 0.283, 0.276))
    scene.run(1.5 * D / U, every=10)
    found = scene.drag_coefficient(0.3 * D / U)
    assert found == pytest.approx(2.85, rel=0.15) and found > clift(20.0)  # it still falls at 1.5 D / U


def test_a_geom_is_pushed_like_the_sphere_that_it_is():
    model, found = mujoco.MjModel.from_xml_string(CUBE % ('<joint type="slide"/>', "")), []
    for scene in (tank().add(sphere(D), at=(0.29, 0.28, 0.28)), tank().add(model, motion=lambda t: 0.0)):
        scene.run(0.2 * D / U)
        found.append(scene.drag_coefficient(0.1 * D / U))
    assert found[1] == pytest.approx(found[0], rel=0.06) and found[0] > clift(20.0)


def test_a_model_without_joints_is_held_in_its_poses():
    text = """<mujoco><worldbody><body pos="0.29 0.28 0.28" euler="0 0 90"><geom type="sphere" size="0.04"/>
    <body pos="0 -0.1 0" euler="0 40 0"><geom type="capsule" size="0.03 0.02"/></body></body>
    <body pos="0.3 0.15 0.3" euler="10 20 30"><geom type="box" size="0.03 0.04 0.03"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    scene = tank().add(model)
    wrench = scene.run(20.0).wrench
    assert scene.coupled.body.data.xpos == pytest.approx(data.xpos) and scene.coupled.body.data.xmat == pytest.approx(data.xmat)
    assert wrench.shape[1:] == (3, 6) and (wrench[-1, :, 0] > 0).all()
    alone = tank().add(sphere(D), at=(0.29, 0.28, 0.28))
    alone.run(0.2 * D / U)
    held = tank().add(mujoco.MjModel.from_xml_string(CUBE % ("", "")))
    held.run(0.2 * D / U)
    assert held.drag_coefficient(0.1 * D / U) == pytest.approx(alone.drag_coefficient(0.1 * D / U), rel=0.06)


def two_spheres(place: str, radius: float = 0.04) -> mujoco.MjModel:
    """One body of two spheres, the second at `place`."""
    text = '<mujoco><worldbody><body pos="0.2 0.24 0.24" euler="0 0 0">%s</body></worldbody></mujoco>'
    balls = "".join(f'<geom type="sphere" size="{radius}" pos="{at}"/>' for at in ("0 0 0", place))
    return mujoco.MjModel.from_xml_string(text % balls)


@pytest.mark.parametrize("place, circles", [
    ("0.12 0 0", 1.0), ("0 0.09 0", 2.0), ("0.12 0.04 0", 2 - (2 / 3 - np.sqrt(3) / (2 * np.pi))), ("0.12 0 0.08", 2.0),
])  # fmt: skip
def test_frontal_area_is_that_of_the_union(place, circles):
    """Behind each other, side by side, half behind each other (less the lens of two circles), and above each other."""
    scene = tank().add(two_spheres(place))
    assert scene.frontal_area == pytest.approx(circles * np.pi * 0.04**2, rel=2e-3)
    assert f"frontal area {scene.frontal_area:.4g} m2" in str(scene)
    assert scene.blockage == pytest.approx(scene.frontal_area / 0.48**2)


def test_drag_coefficient_is_of_the_union_or_of_an_area_of_yours():
    scene = tank().add(two_spheres("0.12 0 0"))
    scene.run(20.0)
    force = scene.forces.wrench[-10:, 0, 0].mean()
    assert scene.drag_coefficient(10 * scene.lattice.dt) == pytest.approx(force / (500 * U**2 * np.pi * 0.04**2), rel=2e-3)
    assert scene.drag_coefficient(10 * scene.lattice.dt, area=2.0) == pytest.approx(force / (1000 * U**2))


def test_a_turned_model_and_a_mesh_with_a_hollow_have_the_area_that_the_stream_sees():
    turned = CUBE.replace('0.28">', '0.28" euler="0 0 90">') % ('<geom type="box" size="0.1 0.05 0.04"/>', "")
    assert tank().add(mujoco.MjModel.from_xml_string(turned)).frontal_area == pytest.approx(0.2 * 0.08)
    both = [box_surface((0.05, 0.05, 0.05)) for _ in range(2)]
    hollow = mesh((np.concatenate([both[0][0], both[1][0] + [0.2, 0.025, 0.0]]), np.concatenate([both[0][1], both[1][1] + 8])))
    assert hollow.area == pytest.approx(0.1 * 0.125) and hollow.width == pytest.approx(0.1, rel=0.01)


def test_outline_of_a_ring_leaves_its_hole():
    turn, tube = (2 * np.pi * np.arange(48) / 48 for _ in range(2))
    a, b = (grid.ravel() for grid in np.meshgrid(turn, tube, indexing="ij"))
    vertices = np.stack([(0.1 + 0.03 * np.cos(b)) * np.cos(a), (0.1 + 0.03 * np.cos(b)) * np.sin(a), 0.03 * np.sin(b)], -1)
    i, j = (grid.ravel() for grid in np.meshgrid(range(48), range(48), indexing="ij"))
    at = lambda m, n: (m % 48) * 48 + n % 48
    faces = np.concatenate(
        [np.stack([at(i, j), at(i + 1, j), at(i + 1, j + 1)], -1), np.stack([at(i, j), at(i + 1, j + 1), at(i, j + 1)], -1)]
    )
    (line,) = silhouettes.outlines((vertices, faces))
    far = np.hypot(*line.T)
    assert far.max() == pytest.approx(0.13, rel=0.01) and far.min() == pytest.approx(0.07, rel=0.01)
    after = np.roll(line, -1, 0)
    assert abs((line[:, 0] * after[:, 1] - line[:, 1] * after[:, 0]).sum() / 2) == pytest.approx(
        np.pi * (0.13**2 - 0.07**2), rel=0.01
    )


def test_thin_and_overlapping_geoms_are_named(capsys):
    thin = '<mujoco><worldbody><body pos="0.2 0.24 0.24"><geom type="box" size="0.1 0.02 0.05"/></body></worldbody></mujoco>'
    scene = tank().add(mujoco.MjModel.from_xml_string(thin))
    said = capsys.readouterr().err
    assert "4.0 cells across a geom of the model where it is thinnest to the stream; 6 or more" in said and "dx = 0.00667" in said
    assert ", 4 across the body, Re 50 on D = 200 mm," in str(scene)
    joined = """<mujoco><worldbody><body pos="0.2 0.24 0.24"><joint type="slide"/><geom name="a" type="sphere" size="0.05"/>
    <geom name="b" type="sphere" size="0.05" pos="0.06 0 0"/></body></worldbody></mujoco>"""
    tank().add(mujoco.MjModel.from_xml_string(joined))
    assert re.search(r"1 pairs of geoms overlap, 'a' and 'b' by 0\.04 m: .* displaced twice", capsys.readouterr().err)


@pytest.mark.parametrize(
    ("cells", "aside", "told"),
    [
        (8, 0.0, []),
        (7, 0.5, []),
        (7, 0.0, ["x = 0.085 m", "x = 0.155 m", "y = 0.085 m", "y = 0.155 m"]),
        (8, 0.5, ["x = 0.085 m", "x = 0.165 m", "y = 0.085 m", "y = 0.165 m"]),
        (7.5, 0.0, []),
    ],
)
def test_straight_edges_on_nodes_are_told(cells, aside, told, capsys):
    """The warning is for a fixed square along the grid: its drag is 1.591 with 8 cells, and 1.570 half a cell aside (Re 96)."""
    half, at = cells * 0.005, (0.12 + 0.01 * aside,) * 2
    square = half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    tank((0.4, 0.24), sponge=4).add(section(square), at=at)
    said = capsys.readouterr().err
    assert (f"scene: section: edges at {', '.join(told)} lie on rows of nodes" in said) == bool(told)
    assert bool(told) == ("rows of nodes" in said)
    turned = square @ np.array([[0.8, 0.6], [-0.6, 0.8]])
    tank((0.4, 0.24), sponge=4).add(section(turned), at=at)
    tank((0.4, 0.24), sponge=4).add(section(square), at=at, joints=("hinge z",), motion=lambda t: (t,))
    tank((0.4, 0.24), sponge=4).add(cylinder(0.07), at=at)
    assert "rows of nodes" not in capsys.readouterr().err


def test_a_section_of_too_few_cells_is_refused_and_a_thin_one_told(capsys):
    corners = lambda x, y: np.array([(-x, -y), (x, -y), (x, y), (-x, y)]) / 2
    with pytest.raises(ConfigError, match=r"5\.0 cells across the section; expected 6 at least: dx = 0\.00833 m"):
        tank((0.4, 0.24), sponge=4).add(section(corners(0.05, 0.05)), at=(0.12, 0.12))
    tank((0.4, 0.24), sponge=4).add(section(corners(0.08, 0.04)), at=(0.12, 0.12))
    assert "4.0 cells across section where it is thinnest to the stream" in capsys.readouterr().err


def test_distances_to_the_faces_are_stated_in_diameters():
    said = str(Scene((0.24, 0.20), 0.001, stream=0.01).add(cylinder(0.01), at=(0.08, 0.1)))
    assert "10 across the body, Re 100 on D = 10 mm" in said and "\n8 D to the inlet, 16 D behind, 20 D wide, frontal" in said


def test_a_mean_that_drifts_is_told_and_a_frequency_found(capsys):
    times = np.arange(1, 2001) * 0.01
    assert (
        force_record.settled_mean("C_D", 1 + 0.001 * times, 20.0) == pytest.approx(1.01, rel=1e-3) and not capsys.readouterr().err
    )
    assert force_record.settled_mean("C_D", 1 + 0.01 * times, 20.0) == pytest.approx(1.1, rel=1e-3)
    assert "C_D has not settled: 1.05 and 1.15 in the halves of the last 20 s (9.1 % of the mean)" in capsys.readouterr().err
    noise = np.random.default_rng(0).normal(size=2000)
    wave = 0.3 * np.sin(2 * np.pi * 0.37 * times + 1) + 0.1
    assert force_record.frequency(times, wave + 0.02 * noise) == pytest.approx(0.37, rel=0.01)
    for side, said in ((wave[:900], "3 or more|whole periods"), (1e-5 * wave, "no wake is shed"), (noise, "expected even ones")):
        with pytest.raises(ConfigError, match=said):
            force_record.frequency(times[: len(side)], side)
    with pytest.raises(ConfigError, match="a mean over 30.0 s of a record of 20 s"):
        force_record.window(times, 30.0)


def test_a_circle_as_a_section_is_pushed_like_the_cylinder(tmp_path):
    turn, found = 2 * np.pi * np.arange(200) / 200, []
    round_one = section(D / 2 * np.stack([np.cos(turn), -np.sin(turn)], -1))
    for shape in (cylinder(D), round_one):
        scene = tank((0.64, 0.48)).add(shape, at=(0.25, 0.24))
        scene.run(0.3 * D / U)
        found.append(scene.forces.wrench[-1, 0, 0])
    assert found[1] == pytest.approx(found[0], rel=0.01) and round_one.volume == pytest.approx(np.pi / 4 * D**2, rel=1e-3)
    assert np.diag(round_one.inertia) == pytest.approx(
        np.diag(cylinder(D).inertia), rel=1e-3
    ) and scene.frontal_area == pytest.approx(D)
    table = np.loadtxt(scene.forces.write(tmp_path / "forces.csv"), delimiter=",", skiprows=1)
    assert table[:, 0] == pytest.approx(scene.forces.times) and table[:, 1:] == pytest.approx(scene.forces.wrench[:, 0], abs=1e-9)


def test_forces_are_si_and_a_flat_flow_has_them_per_metre():
    """The same flow in other units: half the cell, four times the speed, twice the density."""
    record = []
    for size, fast, rho in ((0.01, 0.01, 1000.0), (0.005, 0.04, 2000.0)):
        scene = Scene((10 * size, 8 * size), size / 8, size * fast / 40, fast, rho=rho)
        scene.add(cylinder(size), at=(4 * size, 4 * size))
        scene.run(size / fast)
        record.append(scene.forces.wrench[-1, 0, 0] / (rho * fast**2 * size / 2))
        assert scene.coefficients()[-1, 0] == pytest.approx(record[-1]) and scene.time == pytest.approx(size / fast, rel=0.01)
    assert record[1] == pytest.approx(record[0], rel=1e-4)


def test_a_moved_body_follows_its_motion_and_a_free_one_falls():
    still = Scene((0.32, 0.32), 0.01, 1e-5, dt=0.05)
    swing = lambda t: (0.01 * np.sin(t), 0.1 * t)
    still.add(cylinder(D), at=(0.16, 0.16), joints=("slide y", "hinge z"), motion=swing)
    still.run(1.0)
    assert still.coupled.body.data.qpos == pytest.approx(swing(still.time), abs=1e-12)
    pool = Scene((0.3, 0.3, 0.4), 0.01, 1e-4, dt=0.005, sides="wall", gravity=(0, 0, -9.81))
    pool.add(sphere(D), at=(0.15, 0.15, 0.25), joints=("free",), density=1500.0)
    pool.run(0.05)
    fall, (times, wrench) = -pool.coupled.body.data.qvel[2], pool.forces
    volume = np.pi / 6 * D**3
    assert 0.1 < fall < 0.05 * 9.81 * 500 / 2000  # added mass alone: (rho - rho_w) / (rho + rho_w / 2)
    assert 1500 * volume * fall == pytest.approx(np.sum(500 * volume * 9.81 - wrench[:, 0, 2]) * times[0], rel=1e-3)


@pytest.mark.gpu
@pytest.mark.parametrize("near", [(), 0.05])
@pytest.mark.parametrize("flat", [True, False])
def test_a_scene_on_a_gpu_is_that_of_the_cpu(flat, near):
    found = []
    for device in ("cpu", "cuda"):
        scene = tank((0.64, 0.48) if flat else (0.48, 0.4, 0.4), dt=0.5, near=near, sponge=4, device=device)
        if flat:
            scene.add(cylinder(D), at=(0.25, 0.24), joints=("hinge z",), motion=lambda t: 0.001 * t)
        else:
            scene.add(sphere(D), at=(0.2, 0.203, 0.196))
        found.append(scene.run(20.0).wrench)
    assert np.abs(found[1] - found[0]).max() < 1e-4 * np.abs(found[0]).max()


def test_several_bodies_have_the_held_ones_first():
    scene = Scene((0.4, 0.3), 0.005, 1e-5, 0.005)
    scene.add(cylinder(0.04), at=(0.2, 0.2), joints=("slide y",), motion=lambda t: 0.001 * t)
    scene.add(cylinder(0.04), at=(0.1, 0.15)).add(cylinder(0.05), at=(0.2, 0.1))
    scene.run(0.5)
    assert scene.coupled.body.data.xpos[1:, :2] == pytest.approx(np.array([[0.1, 0.15], [0.2, 0.1], [0.2, 0.2005]]), abs=1e-4)
    assert scene.forces.wrench.shape == (10, 3, 6) and (scene.forces.wrench[-1, :2, 0] > 0).all()
    assert scene.blockage == pytest.approx(0.13 / 0.3) and "blockage 43 %" in str(scene)


def test_vorticity_is_antisymmetric_behind_a_cylinder_and_drawn(tmp_path):
    scene = Scene((0.5, 0.4), 0.01, 8e-6, 0.001)
    scene.add(cylinder(D), at=(0.2, 0.2)).run(1.5 * D / 0.001, every=20)
    found = scene.vorticity()
    assert found.omega_z.shape == (50, 40) and np.abs(found.omega_z + found.omega_z[:, ::-1]).max() < 1e-3 * found.omega_z.max()
    assert found.omega_z[25, 24] > 0 > found.omega_z[25, 15] or found.omega_z[25, 24] < 0 < found.omega_z[25, 15]
    assert scene.plot(tmp_path / "wake.png").stat().st_size > 5000
    (rim,) = found.outline
    assert np.hypot(*(rim - 0.2).T) == pytest.approx(D / 2)  # not of the markers, which are drawn in


def test_a_mesh_has_the_moments_and_markers_of_its_box(tmp_path):
    vertices, faces = box_surface((0.1, 0.05, 0.02))
    made = mesh((vertices + 0.3, faces))
    assert made.volume == pytest.approx(8e-4) and made.centre == pytest.approx([0.3] * 3) and made.area == pytest.approx(0.004)
    assert np.diag(made.inertia) == pytest.approx(8e-4 / 3 * np.array([0.0029, 0.0104, 0.0125]))
    markers = made.markers(0.004)
    half = np.abs(markers.rest - 0.3).max(0)
    assert half == pytest.approx(np.array([0.1, 0.05, 0.02]) - 0.45 * 0.004, abs=0.003)
    inner = 8 * (half[0] * half[1] + half[1] * half[2] + half[0] * half[2])
    assert markers.area.sum() == pytest.approx(inner, rel=0.05) and 0.8 < np.median(np.sqrt(markers.area)) / 0.004 < 1.2
    path = tmp_path / "box.obj"
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    path.write_text("\n".join(lines), encoding="utf-8")
    assert mesh(path).volume == pytest.approx(8e-4, rel=1e-5) and mesh(path, scale=0.1).size == pytest.approx(0.02)


@pytest.mark.parametrize("kind, size, volume", [
    ("sphere", "0.1", 4 / 3 * np.pi * 1e-3), ("capsule", "0.05 0.1", np.pi * 0.0025 * (0.2 + 0.2 / 3)),
    ("ellipsoid", "0.1 0.2 0.05", 4 / 3 * np.pi * 1e-3), ("cylinder", "0.05 0.1", np.pi * 5e-4), ("box", "0.1 0.2 0.05", 8e-3),
])  # fmt: skip
def test_geoms_have_closed_surfaces_of_their_volume(kind, size, volume):
    text = f'<mujoco><worldbody><body><freejoint/><geom type="{kind}" size="{size}" quat="1 2 3 4"/></body></worldbody></mujoco>'
    ((surface,),) = shapes.link_surfaces(mujoco.MjModel.from_xml_string(text))
    vertices, faces = mesh(surface[1:]).markers, surface[2]
    assert callable(vertices) and shapes.solid_moments(surface[1], faces)[0] == pytest.approx(volume, rel=5e-3)


def scene_with(**options) -> None:
    """Adds a sphere that fits, but for `options`."""
    tank().add(**({"body": sphere(D), "at": (0.25, 0.24, 0.24)} | options))


@pytest.mark.parametrize("wrong, said", [
    (lambda: Scene((1.0,), 0.01), "three lengths in m, or two"),
    (lambda: Scene((1.0, 1.0), 0.01), "water at rest and no dt"),
    (lambda: Scene((1.0, 1.0), -0.01, stream=1.0), r"scene: dx = -0.01"),
    (lambda: Scene((1.0, 1.0), 0.01, 1e-4, 0.1, sides="moving"), "side face"),
    (lambda: scene_with(body=sphere(0.05)), r"5\.0 cells across the sphere; expected 6 at least: dx = 0\.00833 m"),
    (lambda: scene_with(at=(0.25, 0.24)), r"at of the sphere has the shape \(2,\)"),
    (lambda: scene_with(at=(0.25, 0.24, 2.0)), r"sphere from z = 1\.965 to 2\.035 m in a box of 0 to 0\.48 m"),
    (lambda: scene_with(at=(0.08, 0.24, 0.24)), "expected 8 cells .* damping layer"),
    (lambda: scene_with(body=cylinder(D)), "a cylinder in a box of 3 lengths; expected two lengths"),
    (lambda: scene_with(body="sphere"), "scene: body"),
    (lambda: scene_with(joints=("slide q",)), "expected a tuple of some of slide x"),
    (lambda: scene_with(joints=("slide x",)), "a free body needs its density"),
    (lambda: scene_with(density=1.0), "a density is that of a free body"),
    (lambda: scene_with(motion=lambda t: 0.0), "a motion without slides or hinges"),
    (lambda: scene_with(joints=("slide x",), motion=lambda t: (0.0, 1.0)), r"motion at t = 0 s has the shape \(2,\)"),
    (lambda: scene_with(body=plate(D, D), joints=("free",), density=1.0), "a free plate without volume"),
    (lambda: scene_with(body=plate(D, D, sharpness=WALL_STRESS)), "plate: markers with a law for the wall's stress"),
    (lambda: tank().run(1.0), "no body; add one"),
    (lambda: tank().add(sphere(D), at=(0.25, 0.24, 0.24)).coefficients(), "need a stream and a record"),
    (lambda: mesh("nowhere.stl"), "no such file"),
    (lambda: section([(0, 0), (1, 0)]), "2 points; expected three or more corners"),
    (lambda: section([(0, 0), (2, 0), (1, 1), (1, -1)]), "the polygon crosses itself"),
    (lambda: section([(0, 0), (1, 0), (1, 0.1), (0, 0.1)]).markers(0.12), "thinner than the 0.9 cells"),
    (lambda: mesh((np.eye(3), [[0, 1, 2]])), "edges do not join two triangles"),
    (lambda: mesh((box_surface((1, 1, 1))[0], box_surface((1, 1, 1))[1][:, ::-1])), "volume -8 m3"),
    (lambda: mesh(box_surface((0.1, 0.1, 0.002))).markers(0.01), "thinner than the 0.9 cells"),
    (lambda: grid_study(lambda dx: dx, (1.0, 2.0, 3.0)), "expected three cells, each 1.1 times the next"),
    (lambda: grid_study(lambda dx: np.nan, (3.0, 2.0, 1.0)), "value at dx = 3 = nan"),
])  # fmt: skip
def test_what_does_not_fit_is_refused_with_what_would(wrong, said):
    with pytest.raises((ConfigError, UnknownName), match=said):
        wrong()


def test_limits_of_the_scheme_are_refused_where_the_box_is_made():
    with pytest.raises(OracleUnstable, match="Mach 0.87"):
        Scene((1.0, 1.0), 0.01, 1e-3, 1.0, dt=0.005)
    with pytest.raises(OracleUnstable, match=r"tau = 0\.50015 .* subgrid = 'wale'"):
        Scene((1.0, 1.0), 0.01, stream=0.1)


def test_a_model_is_refused_by_what_it_lacks():
    joint, model = '<joint type="slide"/>', lambda *words: mujoco.MjModel.from_xml_string(CUBE % words)
    for wrong, said in (
        (lambda: tank().add(model(joint, 'group="3"')), "no geom in the groups 0 to 2"),
        (lambda: tank().add(model(joint, ""), at=(0.1, 0.1, 0.1)), "place, joints"),
        (lambda: tank(gravity=(0, 0, -9.81)).add(model(joint, "")), "gravity beside a MuJoCo model"),
        (lambda: tank().add(model("<freejoint/>", ""), motion=lambda t: 0.0), "a free or ball joint"),
        (lambda: tank().add(model(joint, "")).add(sphere(D), at=(0.1, 0.1, 0.1)), "a shape beside a MuJoCo model"),
        (lambda: tank((0.36, 0.5, 0.5)).add(model(joint, ""), motion=lambda t: 0.0), "the model from x"),
        (lambda: tank().add(model("", ""), motion=lambda t: 0.0), "the motion of a model without joints"),
        (lambda: tank(dx=0.02).add(model(joint, "")), r"4\.0 cells along the model; expected 6 at least: dx = 0\.0133 m"),
    ):
        with pytest.raises(ConfigError, match=said):
            wrong()


def test_grid_study_finds_order_and_limit_that_made_the_values():
    found = grid_study(lambda dx: 1.3 + 0.2 * dx**1.5, (0.4, 0.25, 0.2))
    assert (found.order, found.limit) == pytest.approx((1.5, 1.3), rel=1e-6)
    assert found.uncertainty == pytest.approx(1.25 * 0.2 * 0.2**1.5) and "order 1.50, limit 1.300" in str(found)


@pytest.mark.parametrize("values", [(1.0, 1.2, 1.1), (1.0, 1.0, 1.0), (1.0, 1.2, 1.38)])
def test_grid_study_without_an_order_states_the_range(values):
    found = judged((4.0, 2.0, 1.0), values)
    assert np.isnan(found.order) and np.isnan(found.limit) and "three times its range" in str(found)
    assert found.uncertainty == pytest.approx(3 * (max(values) - min(values)))


@pytest.mark.parametrize("fine", [2.1858, 2.2313, 2.2314 - 1e-9])
def test_an_order_above_the_schemes_is_stated_and_not_believed(fine):
    """An ellipse of 8, 11.2 and 16 cells; and series whose last two values agree by chance, which promise nothing more."""
    found = judged((1.0, 1 / 1.4, 0.5), (2.3405, 2.2314, fine))
    assert found.order > 2.5 and np.isnan(found.limit) and "not believed" in str(found)
    assert found.uncertainty == pytest.approx(3 * 0.1091 / (1.4**2 - 1) / (2 / 1.4) ** 2)


def test_grid_study_of_growing_differences_claims_no_uncertainty():
    found = judged((10.0, 7.0, 5.0), (1.4133, 1.4249, 1.4434))
    assert np.isnan(found.uncertainty) and "+-" not in str(found)
    assert str(found).startswith("dx = 10         1.4133\n") and "\n1.443, no uncertainty (the differences grow: " in str(found)
    assert str(found).endswith("where the error falls with the cell; take smaller ones)")


@pytest.mark.parametrize("fast", [0.004, 0.006])
def test_a_symmetric_wake_that_stays_steady_is_told_from_the_first_shedding_on(fast, capsys):
    """Re 40 sheds nothing, Re 60 should; a bar along the stream at neither; a narrow box is named."""
    size, told = 0.01, "no wake is shed"
    bodies = cylinder(size), section([(-0.005, -0.0014), (0.005, -0.0014), (0.005, 0.0014), (-0.005, 0.0014)])
    for body, box in (bodies[0], (10, 4)), (bodies[1], (10, 12)):
        scene = Scene((box[0] * size, box[1] * size), size / 12, stream=fast).add(body, at=(5 * size, box[1] * size / 2))
        scene.run(0.05 * size / fast)
        scene.drag_coefficient(0.02 * size / fast)
        said = capsys.readouterr().err
        assert (told in said) == (fast == 0.006 and body is bodies[0])
        assert ("raise the force" in said) == (box[1] == 4)


def test_import_of_the_room_is_light_and_its_names_are_there():
    code = "import fishmj.lbm_oracle, sys; assert 'warp' not in sys.modules and 'mujoco' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ | {"PYTHONPATH": str(ROOT)})
    assert all(callable(getattr(lbm_oracle, name)) and name in dir(lbm_oracle) for name in lbm_oracle.__all__)
    with pytest.raises(AttributeError, match="no attribute 'cube'"):
        _ = lbm_oracle.cube


def example(tmp_path, name: str, *words: str) -> str:
    """Standard output of an example."""
    command = [sys.executable, ROOT / "examples" / name, *words]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_example_cylinder_names_a_wrong_option_without_a_traceback(tmp_path):
    command = [sys.executable, ROOT / "examples" / "cylinder.py", "--cells", "2"]
    done = subprocess.run(command, cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    assert done.returncode == 2 and "2.0 cells across the cylinder; expected 6" in done.stderr and "Trace" not in done.stderr


@pytest.mark.parametrize(
    ("shape", "grids", "first"),
    [("cylinder", (7, 10, 14), "42 x 28 x 1 cells of 0.00571"), ("section", (8, 10, 14), "48 x 32 x 1 cells of 0.005 m")],
)
def test_example_cylinder_prints_its_drag_and_draws_its_wake(tmp_path, shape, grids, first):
    box = ("--box", "12", "8", "4", "--near", "1", *["--square"] * (shape == "section"))
    said = example(
        tmp_path, "cylinder.py", "--times", "0.05", "--diameter", "0.02", "--re", "60", "--out", "found", "--study", *box
    )
    found = re.findall(
        r"Re 60 on D = 20 mm, Mach 0\.09, .*\n4 D to the inlet, 8 D .*blockage 12 %\nC_D = (\d+\.\d{2}), .*no St", said
    )
    assert len(found) == 3 and said.startswith(first) and re.search(r"^dx = 0\.002 ", said, re.M)
    for cells in grids:
        assert (tmp_path / "found" / f"{shape}_{cells}.png").stat().st_size > 5000
        assert (tmp_path / "found" / f"{shape}_{cells}.csv").read_text(encoding="utf-8").startswith("t,fx0,fy0,fz0,mx0,my0,mz0\n")


@pytest.mark.slow
def test_example_own_mjcf_prints_the_forces_of_both_links(tmp_path):
    said = example(tmp_path, "own_mjcf.py")
    assert len(re.findall(r"^(front|rear) +mean drag +-?\d\.\d{3} mN", said, re.M)) == 2
