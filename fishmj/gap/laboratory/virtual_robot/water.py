"""Forces of the water on one link, in link axes at the link's origin; u along, v across, r yaw rate, all relative to the water.

    cross-flow     f_n = - sum_k d_k w_k sqrt(w_k^2 + c u^2),  w_k = v + r x_k        (`rigid_body.RigidBody.drag`)
    skin friction  f_t = - 1/2 rho S Cf Re^-0.2 V u                                   1/5-power law of a turbulent plate
    head           f_t = - C |u| u, another C backwards
    trailing edge  f_t = 1/2 m_e s w_c^2,  f_n = - m_e u+ w_c
    circulation    w_c = p w_e + (1 - p) z,  z' = (w_e - z) V / (n h_e)               first-order form of Wagner's function

w_c is clipped to 0 .. 2 w_e, so that the edge never adds energy: (1/2 w_c^2 - w_c w_e) u <= 0. The suction
stalls when the lagged flow meets the edge steeply: s = 1 / (1 + (z / (u tan a))^4).
"""

from math import cos, sin, sqrt

from fishmj.base.units import G
from fishmj.gap.laboratory.virtual_robot.loop_compiler import compiled

CALM = 1e-8  # m2/s2, smooths square roots at rest


@compiled
def crossflow(x, d, u, v, r, oblique):
    """(f_n, moment) of one link; x, d (S,)."""
    force, moment, extra = 0.0, 0.0, oblique * u * u + CALM
    for k in range(x.shape[0]):
        w = v + r * x[k]
        f = d[k] * w * sqrt(w * w + extra)
        force -= f
        moment -= f * x[k]
    return force, moment


@compiled
def trailing_edge(water, odd, wake, u, w, h):
    """(f_t, f_n) at the trailing edge; advances the circulation wake[0] by h."""
    ahead = max(u, 0.0)
    z = wake[0]
    c = water.wagner_start * w + (1.0 - water.wagner_start) * z
    c = min(max(c, 0.0), 2.0 * w) if w > 0.0 else max(min(c, 0.0), 2.0 * w)
    steep = z / (abs(u) * water.stall_slope + 0.02)
    steep *= steep
    suction = 0.5 * water.edge_mass * c * c / (1.0 + steep * steep)
    wake[0] = z + (w - z) * min(1.0, h * (sqrt(u * u + w * w) + 0.01) / (water.wagner_lengths * water.edge_height))
    force = -water.edge_mass * ahead * c
    if odd.resonance != 0.0:  # a band-pass of the edge's speed: bursts of thrust near one beat rate
        k = odd.resonance_rate
        wake[4] += h * (w - wake[5] - 0.5 * wake[4]) * k
        wake[5] += h * wake[4] * k
        suction *= 1.0 + odd.resonance * min(1.0, wake[4] * wake[4] / (w * w + 0.05))
    return suction * (1.0 + odd.asymmetry * (1.0 if w > 0.0 else 0.0)), force


@compiled
def whole_body(body, water, odd, u, v, r, bend):
    """(f_t, f_n, moment) of effects at the reference point; head axes. bend: tail rate relative to the head, rad/s."""
    waves = water.surface * u * u / (G * body.length)  # grows with the Froude number squared
    along = -u * (water.linear_surge + (water.quadratic_surge + waves) * abs(u))
    across = -water.lift * u * v + odd.cross_force * bend * r
    turn = -water.yaw_drag * r * abs(r) - water.munk * body.munk * u * v
    return along, across, turn


@compiled
def link_force(body, water, odd, s, i, u, v, r, bend, time, h):
    """(f_t, f_n, moment) of link i without its added mass. Advances the wake."""
    normal, moment = crossflow(body.station[i], body.drag[i], u, v, r, water.oblique)
    normal *= 1.0 + water.crossflow
    moment *= 1.0 + water.crossflow
    tangent = -water.friction * body.wetted[i] * s.speed[i] * u
    if i == 0:
        tangent -= (water.head_forward if u > 0.0 else water.head_backward) * abs(u) * u
        along, across, turn = whole_body(body, water, odd, u, v, r, bend)
        return tangent + along, normal + across, moment + turn
    if i < len(body.joints):
        return tangent, normal, moment
    edge = v + r * body.edge
    suction, side = trailing_edge(water, odd, s.wake, u, edge, h)
    gain = 1.0 + water.tail
    tangent += suction * gain
    normal = (normal + side) * gain
    moment = (moment + side * body.edge) * gain
    if odd.weed != 0.0 and time > odd.weed_time and edge > 0.0:
        normal -= odd.weed * edge * edge
        moment -= odd.weed * edge * edge * body.edge
    if water.memory > 0.0:
        share = min(1.0, h / (water.memory + h))
        s.wake[1] += (tangent - s.wake[1]) * share
        s.wake[2] += (normal - s.wake[2]) * share
        s.wake[3] += (moment - s.wake[3]) * share
        return s.wake[1], s.wake[2], s.wake[3]
    return tangent, normal, moment


@compiled
def friction_speed(body, s, stream):
    """Sets V^0.8 of each link's middle relative to the uniform stream; updated at each firmware tick."""
    ox, oy = s.rate[0] - stream[0], s.rate[1] - stream[1]
    for i in range(len(body.links)):
        c, d, w = cos(s.z[2 + i]), sin(s.z[2 + i]), s.rate[2 + i]
        across = w * body.centre[i]
        vx, vy = ox - across * d, oy + across * c
        s.speed[i] = (vx * vx + vy * vy + 1e-6) ** 0.4
        swing = w * body.hinge[i]
        ox, oy = ox - swing * d, oy + swing * c
