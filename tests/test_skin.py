"""Claims about the skin: closed, as large as the robot is heavy, rigid away from the hinges, the same kinematics as the chain."""

import numpy as np
import pytest

from fishmj.mjcf import geometry_of, load_robot
from fishmj.mjcf.skin import posed, skin
from fishmj.water.dynamics import planar_chain


@pytest.fixture(scope="module")
def robot():
    return load_robot()


def volume(vertices, faces):
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize("smooth", [False, True])
def test_the_hull_is_closed_and_displaces_the_robot(robot, smooth):
    s = skin(robot, around=60, smooth=smooth, details=False)
    edges = np.sort(np.concatenate([s.faces[:, [0, 1]], s.faces[:, [1, 2]], s.faces[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    assert volume(s.vertices, s.faces) * robot.density_water == pytest.approx(robot.mass, rel=0.02 if smooth else 0.005)


def test_normals_and_triangles_point_outwards(robot):
    s = skin(robot, smooth=True)
    a, b, c = (s.vertices[s.faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    assert (np.einsum("fi,fi->f", normal, s.normals[s.faces].mean(1))[area > 1e-12] > 0).all()
    assert np.allclose(np.linalg.norm(s.normals, axis=1), 1)


def test_a_straight_fish_is_the_rest_pose(robot):
    s = skin(robot)
    assert np.allclose(posed(s, np.zeros(6)), s.vertices, atol=1e-15)


def test_bending_keeps_the_volume(robot):
    s = skin(robot, around=40, details=False)
    bent = volume(posed(s, [1.0, -2.0, 0.7, 0.5, -0.6, 0.8]), s.faces)
    assert bent == pytest.approx(volume(s.vertices, s.faces), rel=0.01)


def test_nose_and_tail_tip_move_with_their_links(robot):
    g, ch = geometry_of(robot), planar_chain.chain_of(robot)
    s = skin(robot, details=False)
    rng = np.random.default_rng(0)
    for _ in range(5):
        q = np.concatenate([rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3)])
        links = planar_chain.kinematics(np, ch, list(q), [0.0] * 6, [(0.0, 0.0)] * 4)
        c, sn = np.cos(q[2]), np.sin(q[2])
        origin = np.zeros(2)
        for i in range(3):
            origin = origin + ch.d[i] * np.array(links.t[i])
        tail = origin + g.tail_x * np.array(links.t[3])
        turn = np.array([[c, -sn], [sn, c]])
        p = posed(s, q)
        assert np.allclose(p[-2, :2], q[:2] + turn @ [g.span[0, 1], 0])  # the nose cap's centre
        assert np.allclose(p[-1, :2], q[:2] + turn @ tail)


def test_vertices_outside_the_bend_zones_are_rigid(robot):
    s = skin(robot)
    assert set(np.unique(s.hinge)) == {0, 1, 2}
    rigid = (s.share == 0) | (s.share == 1)
    assert 0.6 < rigid.mean() < 1.0 and s.share.min() == 0 and s.share.max() == 1


def test_batches_of_poses_equal_single_poses(robot):
    s = skin(robot, spacing=0.02)
    q = np.random.default_rng(1).uniform(-1, 1, (4, 6))
    assert np.allclose(posed(s, q), [posed(s, row) for row in q])
