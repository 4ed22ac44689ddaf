"""Where something may be added to the swimming fish: the sites that `chain.step` calls when it is given hooks.

    fish(ch, sw)                masses and coefficients
    flow(ch, q, flow)           water velocity at each link
    servos(ch, sw, q, v, target) -> (drive, damping beyond back-EMF) of each joint
    water(ch, sw, q, k, hydro)  forces of the water on each link
    body(ch, sw, q, k, rhs, m)  forces and added masses of the whole body, into rhs and m
    end(ch, sw, v, drive)       memory for the next step

`Effects` puts the effects of the catalogue there.
"""

from fishmj.effects import Active
from fishmj.effects.sites import Body, Constants, Gear, Place, Servo, Water
from fishmj.hydro_fit import chain, terms

STILL = 0.0  # of every sum over the effects, before the first


class Effects:
    """The sites of one physics step for an ordered set of effects.

    Args:
        active: the effects. parameters, memory: flat lists in its order, scalars or arrays of one batch shape.
        wet: 0 on a bench in air.
    """

    def __init__(self, xp, active: Active, parameters, memory, wet: float = 1.0):
        self.xp, self.wet = xp, wet
        self.session = active.begin(xp, parameters, memory)
        self.passive: list = []  # N m, torques of each joint that do not come from its motor

    def fish(self, ch: chain.Chain, sw: chain.Swimmer):
        return tuple(self.session.fish(Constants(ch, sw)))

    def flow(self, ch: chain.Chain, q, flow):
        if not self.session.acts("flow"):
            return flow
        out = []
        for (x, y), (u, v) in zip(centres(self.xp, ch, q), flow, strict=True):
            place = self.session.flow(Place(x, y, self.session.time, u, v))
            out.append((place.u, place.v))
        return out

    def servos(self, ch: chain.Chain, sw: chain.Swimmer, q, v, target):
        drives, resists, xp = [], [], self.xp
        for j in range(ch.n - 1):
            angle, rate = q[3 + j], v[3 + j]
            error = target[j] + sw.zero[j] - angle
            s = Servo(error, angle, rate, sw.kp[j], sw.kv[j], sw.kb[j], ch.torque, self.session.current, self.session.time)
            s = self.session.servo(j, s, ch.dt)
            drive = xp.minimum(xp.maximum(s.kp * s.error - s.kv * s.rate, -s.limit), s.limit)
            g = self.session.gear(j, Gear(drive, angle, rate, 0.0, s.kb - sw.kb[j], self.wet, s.kb, s.limit), ch.dt)
            drives.append(g.drive)  # the motor's alone: current and power follow it
            resists.append(g.resist)
            self.passive.append(g.torque)
        return drives, resists

    def water(self, ch: chain.Chain, sw: chain.Swimmer, q, k: chain.Links, hydro):
        if not self.session.acts("water"):
            return hydro
        given = Water(list(hydro), k.u, k.w, k.omega, q[0], q[1], self.session.time, self._instant(ch, sw, k))
        return self.session.water(given, ch.dt).forces

    def _instant(self, ch: chain.Chain, sw: chain.Swimmer, k: chain.Links) -> list:
        """Per-link force of the added mass that goes with velocities, (F_t, F_n, moment)."""
        bias = chain.bias_forces(ch, sw, k, rigid=False)
        parts = [terms.reactive(ch.strips, sw.water, i, k.u[i], k.w[i], k.omega[i]) for i in range(ch.n)]
        return [tuple(a + b for a, b in zip(f, g, strict=True)) for f, g in zip(bias, parts, strict=True)]

    def body(self, ch: chain.Chain, sw: chain.Swimmer, q, k: chain.Links, rhs, m) -> None:
        for j, torque in enumerate(self.passive):
            rhs[3 + j], rhs[2 + j] = rhs[3 + j] + torque, rhs[2 + j] - torque
        if not self.session.acts("body"):
            return
        sway = sum(sw.water.k[i] * ch.strips.mu[i][0] for i in range(ch.n))
        tail = k.w[-1] + k.omega[-1] * ch.strips.tail_x
        drag = 0.5 * ch.strips.rho * (ch.strips.frontal * sw.water.ca_forward + sum(map(sum, ch.strips.p)) * sw.water.cf)
        b = Body(
            k.u[0], k.w[0], k.omega[0], q[2], q[0], q[1], self.session.time, tail, sway * self.wet, drag, self.wet, *(STILL,) * 7
        )
        b = b._replace(bend=sum(q[3:], 0.0), swing=k.omega[-1] - k.omega[0])
        b = self.session.body(b, ch.dt)
        for i, (force, mass) in enumerate(((b.fx, b.mx), (b.fy, b.my), (b.n, b.mn))):
            rhs[i], m[i][i] = rhs[i] + force, m[i][i] + mass
        if b.added is not STILL:
            more = chain.gather(ch, k, self._instant(ch, sw, k))
            for i, row in enumerate(chain.mass_matrix(ch, sw, k, rigid=False)):
                rhs[i] = rhs[i] + b.added * more[i]
                m[i] = [a + b.added * c for a, c in zip(m[i], row, strict=True)]

    def end(self, ch: chain.Chain, sw: chain.Swimmer, v, drive):
        # supply: the motor's current (drive - kb w) / K times the duty drive / stall torque; nothing flows back
        amps = (self.xp.maximum(d * (d - sw.kb[j] * v[3 + j]), 0.0) for j, d in enumerate(drive))
        current = sum(amps) / (ch.torque * ch.motor)
        return self.session.end(current, ch.dt)


def centres(xp, ch: chain.Chain, q) -> list:
    """World positions of the link centres, N pairs of m."""
    heading, x, y = q[2], q[0], q[1]
    out = []
    for i in range(ch.n):
        if i > 0:
            x, y = x + ch.d[i - 1] * xp.cos(heading), y + ch.d[i - 1] * xp.sin(heading)
            heading = heading + q[2 + i]
        mid = sum(ch.strips.x[i]) / len(ch.strips.x[i])
        out.append((x + mid * xp.cos(heading), y + mid * xp.sin(heading)))
    return out
