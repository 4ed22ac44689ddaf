"""Recursive-regularised collision, written in moments.

    rho = sum f_i      rho u = sum c_i f_i      P = sum (c_i c_i - c_s^2 I) f_i - rho u u            (non-equilibrium stress)
    P <- P + b (-2 rho c_s^2 tau dev S - dev P)      S = (grad u + grad u^T) / 2, with eddy viscosity only
    P' = (1 - omega) (P - tr P / 3 I) + (1 - omega_bulk) tr P / 3 I                                 omega = 1 / tau
    A2 = rho v v + P',  v = u + G                                                                    exact-difference force
    A3_abc = rho v_a v_b v_c + u_a P'_bc + u_b P'_ac + u_c P'_ab                                     recursion
    f_i = w_i [ rho + c.rho v / c_s^2 + H2_i : A2 / (2 c_s^4) + six third-order terms of D3Q19 ]

Only ten moments pass through a collision, so no equilibrium is formed. The force term f_eq(u + G) - f_eq(u) is the difference
between v and u in A2 and A3. In terms of u + G/2, the velocity of the water, this is Guo's second-order force.
The third-order terms are H_xxy + H_yzz and H_xxy - H_yzz with their permutations, of norm 2 c_s^6 and 6 c_s^6. Summed at each
velocity they shrink to -9 c_y (a_xxy + a_yzz) on the axes and 9 (c_y a_xxy + c_x a_xyy) on the diagonals.

The blend keeps the water stable. At tau = 0.50003 a collision only changes the sign of P. Stress that alternates from cell to
cell then never decays, and it grows in any stream (docs/solver/method.md, "What keeps the water stable"). Central differences
do not see such a stress: a share b of it is lost in every step. On resolved scales both stresses agree and b has almost no
effect: at wave number k it acts as a viscosity of b k^2 / 48, a fourth-order term.

Sources: Malaspinas 2015, arXiv 1505.06900 (recursion); Jacob, Malaspinas, Sagaut 2018, J. Turbulence, hal-02114308 (six terms,
blend); Kupershtokh 2009, Comput. Math. Appl. 58:862 (exact difference); Nicoud, Ducros 1999, Flow Turbul. Combust. 62:183 (WALE).
Departure: the trace of P relaxes on its own, omega_bulk = 1, so that sound between the walls dies out.

Populations are stored as f_i - w_i, so that single precision resolves their small variation.
"""

import warp as wp

from fishmj.lbm_oracle.fluid.in_kernels import vec6, vec19

_CS2, _W1, _W2 = wp.constant(1.0 / 3.0), wp.constant(1.0 / 18.0), wp.constant(1.0 / 36.0)


@wp.func
def density(f: vec19):
    """Density minus one, rho - 1."""
    axes = (f[1] + f[2]) + (f[3] + f[4]) + (f[5] + f[6])
    xy = (f[7] + f[8]) + (f[9] + f[10])
    xz = (f[11] + f[12]) + (f[13] + f[14])
    yz = (f[15] + f[16]) + (f[17] + f[18])
    return f[0] + axes + xy + xz + yz


@wp.func
def momentum(f: vec19):
    """Momentum rho u, lattice units."""
    a, b = f[7] - f[8], f[9] - f[10]
    c, d = f[11] - f[12], f[13] - f[14]
    e, g = f[15] - f[16], f[17] - f[18]
    return wp.vec3(f[1] - f[2] + a + b + c + d, f[3] - f[4] + a - b + e + g, f[5] - f[6] + c - d + e - g)


@wp.func
def non_equilibrium_stress(f: vec19, drho: float, u: wp.vec3):
    """Non-equilibrium stress P of the module's docstring, (xx, yy, zz, xy, xz, yz)."""
    a, b = f[7] + f[8], f[9] + f[10]
    c, d = f[11] + f[12], f[13] + f[14]
    e, g = f[15] + f[16], f[17] + f[18]
    rho = 1.0 + drho
    p = _CS2 * drho
    return vec6(
        f[1] + f[2] + a + b + c + d - p - rho * u[0] * u[0],
        f[3] + f[4] + a + b + e + g - p - rho * u[1] * u[1],
        f[5] + f[6] + c + d + e + g - p - rho * u[2] * u[2],
        a - b - rho * u[0] * u[1],
        c - d - rho * u[0] * u[2],
        e - g - rho * u[1] * u[2],
    )


@wp.func
def hybrid_stress(p: vec6, dx: wp.vec3, dy: wp.vec3, dz: wp.vec3, rho_tau: float, share: float):
    """P with the fraction `share` of its traceless part replaced by that of the velocity gradient; dx = d u / d x and so on."""
    a = share * _CS2 * rho_tau  # a viscous stress of the same viscosity: on resolved scales both agree and the blend is idle
    mean = _CS2 * (p[0] + p[1] + p[2])
    third = 2.0 * _CS2 * (dx[0] + dy[1] + dz[2])
    keep = 1.0 - share
    return vec6(
        mean + keep * (p[0] - mean) - a * (2.0 * dx[0] - third),
        mean + keep * (p[1] - mean) - a * (2.0 * dy[1] - third),
        mean + keep * (p[2] - mean) - a * (2.0 * dz[2] - third),
        keep * p[3] - a * (dy[0] + dx[1]),
        keep * p[4] - a * (dz[0] + dx[2]),
        keep * p[5] - a * (dz[1] + dy[2]),
    )


@wp.func
def relaxed(p: vec6, omega: float, omega_bulk: float):
    """Relaxed stress P' of the module's docstring, (xx, yy, zz, xy, xz, yz)."""
    mean = _CS2 * (p[0] + p[1] + p[2])
    keep = 1.0 - omega  # near -1 in water: P only changes its sign, which is why the blend is needed at all
    bulk = (1.0 - omega_bulk) * mean
    return vec6(
        keep * (p[0] - mean) + bulk,
        keep * (p[1] - mean) + bulk,
        keep * (p[2] - mean) + bulk,
        keep * p[3],
        keep * p[4],
        keep * p[5],
    )


@wp.func
def reconstruct(drho: float, u: wp.vec3, v: wp.vec3, p: vec6):
    """Populations f_i - w_i from the moments: density, velocity before and after the force, relaxed stress P'."""
    rho = 1.0 + drho
    j = rho * v
    axx, ayy, azz = j[0] * v[0] + p[0], j[1] * v[1] + p[1], j[2] * v[2] + p[2]
    axy, axz, ayz = j[0] * v[1] + p[3], j[0] * v[2] + p[4], j[1] * v[2] + p[5]
    # third order by recursion, not from f: the populations' own third moments hold the lattice's ghost modes
    axxy = j[0] * v[0] * v[1] + 2.0 * u[0] * p[3] + u[1] * p[0]
    axxz = j[0] * v[0] * v[2] + 2.0 * u[0] * p[4] + u[2] * p[0]
    axyy = j[1] * v[1] * v[0] + 2.0 * u[1] * p[3] + u[0] * p[1]
    ayyz = j[1] * v[1] * v[2] + 2.0 * u[1] * p[5] + u[2] * p[1]
    axzz = j[2] * v[2] * v[0] + 2.0 * u[2] * p[4] + u[0] * p[2]
    ayzz = j[2] * v[2] * v[1] + 2.0 * u[2] * p[5] + u[1] * p[2]

    # opposite populations share all even moments and differ in the sign of the odd: each pair costs one sum and one difference
    rest = drho - 1.5 * (axx + ayy + azz)
    f = vec19()

    even, odd = rest + 4.5 * (axx + ayy) + 9.0 * axy, 3.0 * (j[0] + j[1]) + 9.0 * (axyy + axxy)
    f[7] = _W2 * (even + odd)
    f[8] = _W2 * (even - odd)
    even, odd = rest + 4.5 * (axx + ayy) - 9.0 * axy, 3.0 * (j[0] - j[1]) + 9.0 * (axyy - axxy)
    f[9] = _W2 * (even + odd)
    f[10] = _W2 * (even - odd)
    even, odd = rest + 4.5 * (axx + azz) + 9.0 * axz, 3.0 * (j[0] + j[2]) + 9.0 * (axzz + axxz)
    f[11] = _W2 * (even + odd)
    f[12] = _W2 * (even - odd)
    even, odd = rest + 4.5 * (axx + azz) - 9.0 * axz, 3.0 * (j[0] - j[2]) + 9.0 * (axzz - axxz)
    f[13] = _W2 * (even + odd)
    f[14] = _W2 * (even - odd)
    even, odd = rest + 4.5 * (ayy + azz) + 9.0 * ayz, 3.0 * (j[1] + j[2]) + 9.0 * (ayzz + ayyz)
    f[15] = _W2 * (even + odd)
    f[16] = _W2 * (even - odd)
    even, odd = rest + 4.5 * (ayy + azz) - 9.0 * ayz, 3.0 * (j[1] - j[2]) + 9.0 * (ayzz - ayyz)
    f[17] = _W2 * (even + odd)
    f[18] = _W2 * (even - odd)

    # populations on the axes and at rest take the remaining momentum and mass: weights in single precision would drain both
    even, odd = _W1 * (rest + 4.5 * axx), 0.5 * (j[0] - (f[7] - f[8]) - (f[9] - f[10]) - (f[11] - f[12]) - (f[13] - f[14]))
    f[1] = even + odd
    f[2] = even - odd
    even, odd = _W1 * (rest + 4.5 * ayy), 0.5 * (j[1] - (f[7] - f[8]) + (f[9] - f[10]) - (f[15] - f[16]) - (f[17] - f[18]))
    f[3] = even + odd
    f[4] = even - odd
    even, odd = _W1 * (rest + 4.5 * azz), 0.5 * (j[2] - (f[11] - f[12]) + (f[13] - f[14]) - (f[15] - f[16]) + (f[17] - f[18]))
    f[5] = even + odd
    f[6] = even - odd
    f[0] = drho - density(f)  # f[0] is still zero
    return f


@wp.func
def wale(dx: wp.vec3, dy: wp.vec3, dz: wp.vec3, cw2: float):
    """Eddy viscosity from the velocity gradient; dx = (du/dx, dv/dx, dw/dx) and so on; cw2 = C_w^2.

    nu_t = C_w^2 (Sd:Sd)^1.5 / ((S:S)^2.5 + (Sd:Sd)^1.25),  Sd = traceless symmetric part of g g.
    Gradients are scaled to order one first: their fifth powers would leave the range of single precision.
    """
    sxx, syy, szz = dx[0], dy[1], dz[2]
    sxy, sxz, syz = 0.5 * (dy[0] + dx[1]), 0.5 * (dz[0] + dx[2]), 0.5 * (dz[1] + dy[2])
    s = sxx * sxx + syy * syy + szz * szz + 2.0 * (sxy * sxy + sxz * sxz + syz * syz)
    g = wp.dot(dx, dx) + wp.dot(dy, dy) + wp.dot(dz, dz)
    # rows of g g, g_ab = d u_a / d x_b
    row_x, row_y, row_z = wp.vec3(dx[0], dy[0], dz[0]), wp.vec3(dx[1], dy[1], dz[1]), wp.vec3(dx[2], dy[2], dz[2])
    qxx, qyy, qzz = wp.dot(row_x, dx), wp.dot(row_y, dy), wp.dot(row_z, dz)
    third = _CS2 * (qxx + qyy + qzz)
    qxx, qyy, qzz = qxx - third, qyy - third, qzz - third
    qxy = 0.5 * (wp.dot(row_x, dy) + wp.dot(row_y, dx))
    qxz = 0.5 * (wp.dot(row_x, dz) + wp.dot(row_z, dx))
    qyz = 0.5 * (wp.dot(row_y, dz) + wp.dot(row_z, dy))
    q = qxx * qxx + qyy * qyy + qzz * qzz + 2.0 * (qxy * qxy + qxz * qxz + qyz * qyz)
    scale = 1.0 / wp.max(g, 1.0e-18)
    s, q = s * scale, q * scale * scale
    root = wp.sqrt(q)
    return cw2 * wp.sqrt(g) * q * root / wp.max(s * s * wp.sqrt(s) + q * wp.sqrt(root), 1.0e-12)
