"""The oracle's lattice, collision, eddy viscosity and units, each against its formula written out in NumPy."""

import numpy as np
import pytest

wp = pytest.importorskip("warp")

from hypothesis import given, settings
from hypothesis import strategies as st

from fishmj.lbm_oracle.fluid import collide
from fishmj.lbm_oracle.fluid.in_kernels import vec6
from fishmj.lbm_oracle.fluid.lattice import CS2, VELOCITIES, WEIGHTS, Lattice, mirrored, opposite

pytestmark = pytest.mark.oracle


def test_the_velocities_are_isotropic_to_fourth_order():
    c, w = VELOCITIES, WEIGHTS
    assert w.sum() == pytest.approx(1)
    assert np.einsum("i,ia,ib->ab", w, c, c) == pytest.approx(CS2 * np.eye(3))
    four = np.einsum("i,ia,ib,ic,id->abcd", w, c, c, c, c)
    d = np.eye(3)
    pairs = np.einsum("ab,cd->abcd", d, d) + np.einsum("ac,bd->abcd", d, d) + np.einsum("ad,bc->abcd", d, d)
    assert four == pytest.approx(CS2**2 * pairs)
    assert all((VELOCITIES[opposite(i)] == -VELOCITIES[i]).all() for i in range(19))
    assert all((VELOCITIES[mirrored(i, 2)] == VELOCITIES[i] * [1, 1, -1]).all() for i in range(19))


@wp.kernel(enable_backward=False)
def _collided(drho: float, u: wp.vec3, v: wp.vec3, p: vec6, out: wp.array(dtype=float), back: wp.array(dtype=float)):
    f = collide.reconstruct(drho, u, v, p)
    for i in range(19):
        out[i] = f[i]
    j = collide.momentum(f)
    q = collide.non_equilibrium_stress(f, drho, v)
    back[0] = collide.density(f)
    for a in range(3):
        back[1 + a] = j[a]
    for a in range(6):
        back[4 + a] = q[a]


def test_populations_are_the_hermite_series_of_their_moments():
    """Against the textbook sum over Hermite polynomials, written out in NumPy."""
    rng = np.random.default_rng(3)
    drho, u, v = 0.02, rng.uniform(-0.1, 0.1, 3), rng.uniform(-0.1, 0.1, 3)
    p = rng.uniform(-0.01, 0.01, 6)
    out, back = wp.zeros(19, dtype=float, device="cpu"), wp.zeros(10, dtype=float, device="cpu")
    wp.launch(_collided, 1, inputs=[drho, wp.vec3(*u), wp.vec3(*v), vec6(*p), out, back], device="cpu")
    c, rho = VELOCITIES.astype(float), 1 + drho
    stress = np.array([[p[0], p[3], p[4]], [p[3], p[1], p[5]], [p[4], p[5], p[2]]])
    a2 = rho * np.outer(v, v) + stress
    recursion = np.einsum("a,bc->abc", u, stress) + np.einsum("b,ac->abc", u, stress) + np.einsum("c,ab->abc", u, stress)
    a3 = rho * np.einsum("a,b,c->abc", v, v, v) + recursion
    series = drho + 3 * rho * c @ v + 4.5 * np.einsum("iab,ab->i", np.einsum("ia,ib->iab", c, c) - CS2 * np.eye(3), a2)
    third = lambda a, b: (c[:, a] ** 2 - CS2) * c[:, b]
    for a, b, d in ((0, 1, 2), (0, 2, 1), (1, 0, 2)):  # H_aab with H_ddb, for each b
        for sign in (1, -1):
            h = third(a, b) + sign * third(d, b)
            norm = np.sum(WEIGHTS * h * h)
            series += h * (a3[a, a, b] + sign * a3[d, d, b]) / norm
    assert out.numpy() == pytest.approx(WEIGHTS * series, abs=1e-7)
    assert back.numpy()[0] == pytest.approx(drho, abs=1e-7)
    assert back.numpy()[1:4] == pytest.approx(rho * v, abs=1e-7)
    assert back.numpy()[4:] == pytest.approx(p, abs=1e-7)


@wp.kernel(enable_backward=False)
def _eddies(dx: wp.vec3, dy: wp.vec3, dz: wp.vec3, out: wp.array(dtype=float)):
    out[0] = collide.wale(dx, dy, dz, 1.0)


def wale(g) -> float:
    """Kernel value for g_ab = du_a / dx_b."""
    out = wp.zeros(1, dtype=float, device="cpu")
    wp.launch(_eddies, 1, inputs=[wp.vec3(*g[:, 0]), wp.vec3(*g[:, 1]), wp.vec3(*g[:, 2]), out], device="cpu")
    return float(out.numpy()[0])


def test_eddy_viscosity_is_the_published_formula_at_every_scale():
    rng = np.random.default_rng(5)
    for scale in (1e-6, 1e-3, 1.0):
        g = scale * rng.standard_normal((3, 3))
        s, q = (g + g.T) / 2, g @ g
        sd = (q + q.T) / 2 - np.trace(q) / 3 * np.eye(3)
        ss, dd = np.sum(s * s), np.sum(sd * sd)
        assert wale(g) == pytest.approx(dd**1.5 / (ss**2.5 + dd**1.25), rel=1e-4)


def test_eddy_viscosity_vanishes_in_plane_shear_and_in_still_water():
    shear = np.zeros((3, 3))
    shear[0, 1] = 0.01
    assert wale(shear) < 1e-9
    assert wale(np.zeros((3, 3))) == 0.0


@given(st.floats(1e-3, 0.1), st.floats(1e-4, 0.02), st.lists(st.floats(-3, 3), min_size=3, max_size=3))
@settings(max_examples=50, deadline=None)
def test_positions_and_units_go_there_and_back(dx, dt, x):
    lattice = Lattice(dx=dx, dt=dt, corner=(-1.0, 0.5, 0.2))
    assert lattice.to_si(lattice.to_lu(x)) == pytest.approx(np.array(x), abs=1e-9)
    assert lattice.force * lattice.dt == pytest.approx(lattice.mass * lattice.velocity)  # an impulse is a momentum
    assert lattice.force == pytest.approx(lattice.pressure * dx**2)
