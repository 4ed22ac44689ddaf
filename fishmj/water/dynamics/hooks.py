"""Hooks of `planar_chain.step`: the points of a physics step at which effects act.

    fish(ch, sw)                masses and coefficients
    flow(ch, q, flow)           water velocity at each link, and its gradient along the link
    servos(ch, sw, q, v, target) -> (drive, damping beyond back-EMF) of each joint
    water(ch, sw, q, k, hydro)  forces of the water on each link
    body(ch, sw, q, k, rhs, m)  forces and added masses of the whole body, into rhs and m
    end(ch, sw, v, drive)       memory for the next step

`Effects` calls the effects of the catalogue there. The water velocity that they add is linear along each link,

    U(s) = U_c + (s - s_c) dU/ds,   DU/Dt = (U(x + e U, t + e) - U(x, t)) / e   at its centre

The normal part of dU/ds turns the fish, and DU/Dt pushes it like that of the background flow (`strip_forces.ambient`).
"""

from fishmj.effects import EffectStack
from fishmj.effects.sites import BodyMotion, Constants, FlowAt, Gear, LocalWater, ServoDrive
from fishmj.water.dynamics import planar_chain, strip_forces

STILL = 0.0  # initial value of each sum over effects
AHEAD = 0.02  # s, step e of the finite difference


class Effects:
    """Sites of one physics step for an ordered set of effects.

    Args:
        active: the effects.
        parameters, memory: flat lists in the order of the effects, scalars or arrays of one batch shape.
        wet: 0 on a bench in air.
    """

    def __init__(self, xp, active: EffectStack, parameters, memory, wet: float = 1.0):
        self.xp, self.wet = xp, wet
        self.session = active.begin(xp, parameters, memory)
        self.passive: list = []  # N m, torques of each joint that its motor does not make
        self.supply: list = []  # voltage at each servo, as a share of the nominal voltage
        self.stream: list = []  # m/s2, DU/Dt of the effects' flow at each link, along and across it

    def fish(self, ch: planar_chain.Chain, sw: planar_chain.Swimmer):
        """Chain and swimmer with the masses and coefficients that the effects change."""
        return tuple(self.session.fish(Constants(ch, sw)))

    def flow(self, ch: planar_chain.Chain, q, flow):
        """Water velocity at each link (m/s) with its gradient along the link (1/s), including the effects' water."""
        if not self.session.acts("flow"):
            return flow
        out, time = [], self.session.time
        at = lambda x, y, u, v, t: self.session.flow(FlowAt(x, y, t, u, v))
        for s, (x, y, c, d), (u, v) in zip(ch.strips.x, links(self.xp, ch, q), flow, strict=True):
            front, rear = (at(x + c * end, y + d * end, u, v, time) for end in (s[0], s[-1]))
            uc, vc, middle = (front.u + rear.u) / 2, (front.v + rear.v) / 2, (s[0] + s[-1]) / 2
            later = at(x + c * middle + AHEAD * uc, y + d * middle + AHEAD * vc, u, v, time + AHEAD)
            a, b = self.wet * (later.u - uc) / AHEAD, self.wet * (later.v - vc) / AHEAD
            self.stream.append((c * a + d * b, c * b - d * a))
            turning = ((front.v - rear.v) * c - (front.u - rear.u) * d) / (s[0] - s[-1])
            out.append((uc + turning * middle * d, vc - turning * middle * c, turning))
        return out

    def servos(self, ch: planar_chain.Chain, sw: planar_chain.Swimmer, q, v, target):
        """Drive torque (N m) and damping beyond back-EMF (N m s/rad) of each joint."""
        drives, resists, xp = [], [], self.xp
        for j in range(ch.n - 1):
            angle, rate = q[3 + j], v[3 + j]
            error = target[j] + sw.zero[j] - angle
            s = ServoDrive(error, angle, rate, sw.kp[j], sw.kv[j], sw.kb[j], ch.torque, self.session.current, self.session.time)
            s = self.session.servo(j, s, ch.dt)
            drive = xp.minimum(xp.maximum(s.kp * s.error - s.kv * s.rate, -s.limit), s.limit)
            g = self.session.gear(j, Gear(drive, angle, rate, 0.0, s.kb - sw.kb[j], self.wet, s.kb, s.limit), ch.dt)
            drives.append(g.drive)  # motor torque only, which determines current and power
            resists.append(g.resist)
            self.supply.append(s.supply)
            self.passive.append(g.torque)
        return drives, resists

    def water(self, ch: planar_chain.Chain, sw: planar_chain.Swimmer, q, k: planar_chain.Links, hydro):
        """Forces of the water on each link (N, N, N m), including the effects' forces and those of their flow."""
        if self.session.acts("water"):
            given = LocalWater(list(hydro), k.u, k.w, k.omega, q[0], q[1], self.session.time, self._instant(ch, sw, k))
            hydro = self.session.water(given, ch.dt).forces
        if not self.stream:
            return hydro
        push = [strip_forces.ambient(ch.strips, sw.water, i, along, across) for i, (along, across) in enumerate(self.stream)]
        return [tuple(f + g for f, g in zip(force, more, strict=True)) for force, more in zip(hydro, push, strict=True)]

    def _instant(self, ch: planar_chain.Chain, sw: planar_chain.Swimmer, k: planar_chain.Links) -> list:
        """Force of the added mass in the effects' flow on each link, (F_t, F_n, moment)."""
        bias = planar_chain.bias_forces(ch, sw, k, rigid=False)
        parts = [strip_forces.reactive(ch.strips, sw.water, i, k.u[i], k.w[i], k.omega[i], k.own[i]) for i in range(ch.n)]
        return [tuple(a + b for a, b in zip(f, g, strict=True)) for f, g in zip(bias, parts, strict=True)]

    def body(self, ch: planar_chain.Chain, sw: planar_chain.Swimmer, q, k: planar_chain.Links, rhs, m) -> None:
        """Adds forces (N, N m) and added masses (kg, kg m2) of the effects on the whole body to rhs and m."""
        for j, torque in enumerate(self.passive):
            rhs[3 + j], rhs[2 + j] = rhs[3 + j] + torque, rhs[2 + j] - torque
        if not self.session.acts("body"):
            return
        sway = sum(sw.water.k[i] * ch.strips.mu[i][0] for i in range(ch.n))
        tail = k.w[-1] + k.omega[-1] * ch.strips.tail_x
        drag = 0.5 * ch.strips.rho * (ch.strips.frontal * sw.water.ca_forward + sum(map(sum, ch.strips.p)) * sw.water.cf)
        b = BodyMotion(
            k.u[0], k.w[0], k.own[0], q[2], q[0], q[1], self.session.time, tail, sway * self.wet, drag, self.wet, *(STILL,) * 7
        )
        b = b._replace(bend=sum(q[3:], 0.0), swing=k.own[-1] - k.own[0])
        b = self.session.body(b, ch.dt)
        for i, (force, mass) in enumerate(((b.fx, b.mx), (b.fy, b.my), (b.n, b.mn))):
            rhs[i], m[i][i] = rhs[i] + force, m[i][i] + mass
        if b.added is not STILL:
            more = planar_chain.gather(ch, k, self._instant(ch, sw, k))
            for i, row in enumerate(planar_chain.mass_matrix(ch, sw, k, rigid=False)):
                rhs[i] = rhs[i] + b.added * more[i]
                m[i] = [a + b.added * c for a, c in zip(m[i], row, strict=True)]

    def end(self, ch: planar_chain.Chain, sw: planar_chain.Swimmer, v, drive):
        """Memory of the effects for the next step; updates the servos' current."""
        # the motor's current (drive - kb w) / K times the duty cycle drive V_nominal / (V stall torque); no regeneration
        amps = (self.xp.maximum(d / self.supply[j] * (d - sw.kb[j] * v[3 + j]), 0.0) for j, d in enumerate(drive))
        current = sum(amps) / (ch.torque * ch.motor)
        return self.session.end(current, ch.dt)


def centres(xp, ch: planar_chain.Chain, q) -> list:
    """World positions of the link centres, N pairs of m."""
    middle = [sum(s) / len(s) for s in ch.strips.x]
    return [(x + s * c, y + s * d) for s, (x, y, c, d) in zip(middle, links(xp, ch, q), strict=True)]


def links(xp, ch: planar_chain.Chain, q) -> list:
    """Position of the origin in the world [m] and direction of every link: (x, y, cos, sin)."""
    heading, x, y = q[2], q[0], q[1]
    out = [(x, y, xp.cos(heading), xp.sin(heading))]
    for i in range(1, ch.n):
        x, y = x + ch.d[i - 1] * out[-1][2], y + ch.d[i - 1] * out[-1][3]
        heading = heading + q[2 + i]
        out.append((x, y, xp.cos(heading), xp.sin(heading)))
    return out
