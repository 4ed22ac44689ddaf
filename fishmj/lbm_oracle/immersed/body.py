"""The solid side: a MuJoCo model that provides the joint-space equation of one step and takes over the velocity that solves it.

    (M + dt D + K) v+ = (M + dt D) v + dt (passive + actuators - bias) - b0 + I            K, b0: the water (kernels.py)
    I = sum_l J_l^T (h_l^n - h_l^n-1) - dt sum_l J_l^T m_l g,   h_l = (m_l u_l, I_l w_l)      the water inside the hull

Sheets have layers of water round them that move along, too (`markers.py`). `carry_layers` sets their inertia.

D is joint damping (the servo's back-EMF), which MuJoCo's Euler integrator treats implicitly. h_l is the momentum of the displaced
water of link l. Across the link this water moves with the link; along the link its speed is measured (kernels.py). m_l is its
mass, u_l the velocity of its centre. The immersed boundary accelerates that water too, which a real hull does not contain. The
difference in the world frame contains the Coriolis part M_f a + c_f, and its sum over the steps telescopes, so that momentum
is conserved. I lags by one step, along the links by two. The implicit solve is stable with it down to a density ratio of 0.01
(docs/solver/coupling.md).

The velocity goes back as   qfrc_applied = (M + dt D) (v+ - v) / dt - (passive + actuators - bias),
so that MuJoCo's own step returns v+ exactly. Contacts and joint limits are off in fishmj's models.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from fishmj.base.errors import ConfigError, SimDiverged
from fishmj.base.options import checked_kind, shown_value
from fishmj.lbm_oracle.fluid.guard import numbers, whole_numbers
from fishmj.lbm_oracle.immersed import link_dynamics
from fishmj.lbm_oracle.immersed.kernels import Points
from fishmj.lbm_oracle.immersed.link_dynamics import Corners
from fishmj.mjcf import build, geometry_of, load_robot, passive_slot

FREE, BALL, SLIDE, HINGE = (
    int(kind)
    for kind in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL, mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE)
)
RUNAWAY = 1e3  # m/s or rad/s: no step of MuJoCo from there
EXACT = 1e-9  # MuJoCo's velocity against the one found, relative to 1 + |v|


@dataclass(frozen=True, kw_only=True)
class DisplacedWater:
    """Displaced water of L links, in their body frames."""

    mass: np.ndarray  # (L,) kg
    centre: np.ndarray  # (L, 3) m
    inertia: np.ndarray  # (L, 3, 3) about the centre, kg m2
    points: Points | None = None  # where it may slide along the links; None: it moves with them

    def __post_init__(self):
        """Raises ConfigError for arrays of other shapes, and for masses and moments of inertia below zero."""
        for name, rest, low in (("mass", (), 0.0), ("centre", (3,), -np.inf), ("inertia", (3, 3), -np.inf)):
            shape = (None if name == "mass" else len(self.mass), *rest)
            object.__setattr__(self, name, numbers(f"displaced water: {name}", getattr(self, name), shape, low=low))
        turned = self.inertia.transpose(0, 2, 1)
        room = 1e-9 * np.abs(self.inertia).max(initial=0.0)
        if np.abs(self.inertia - turned).max(initial=0.0) > room or (np.linalg.eigvalsh(self.inertia) < -room).any():
            raise ConfigError("displaced water: inertia is no symmetric matrix without negative moments, for each link")
        if checked_kind("displaced water: points", self.points, Points) is not None:
            _check_points(self.points, len(self.mass))

    @classmethod
    def of(cls, robot) -> "DisplacedWater":
        """Displaced water of a fish: its sections full of water; the geometry's inertia is scaled to the displaced mass."""
        g = geometry_of(robot)
        share = g.displaced / g.mass
        zero = 0 * g.buoyancy
        return cls(
            mass=g.displaced,
            centre=np.stack([g.buoyancy, zero, zero], -1),
            inertia=np.stack([np.diag(i) for i in g.inertia * share[:, None]]),
            points=Points.of(g),
        )


class ImmersedBody:
    """One articulated body: every moving MuJoCo body is a link, numbered as in the model.

    Args:
        model: trees of any shape and number, with hinges, slides, ball and free joints; Euler integrator. Markers of a bending
            skin need one hinge about z between their two links.
        water: displaced water of each link.
        dt: step of the fluid, s; becomes the model's own.

    Raises ConfigError: the model has something that the coupled step leaves out, such as an active contact or limit; or the water
    is for another number of links.
    """

    def __init__(self, model: mujoco.MjModel, water: DisplacedWater, dt: float):
        checked_kind("body: model", model, mujoco.MjModel, needed=True)
        checked_kind("body: water", water, DisplacedWater, needed=True)
        self.model, self.data, self.water = model, mujoco.MjData(model), water
        self.links, self.dofs = model.nbody - 1, model.nv
        _refuse_what_is_left_out(model)
        if len(water.mass) != self.links:
            raise ConfigError(f"body: {self.links} moving bodies in the model, displaced water for {len(water.mass)}")
        n, count = self.dofs, self.links
        self.reach = np.array([[_moves(model, i + 1, d) for d in range(n)] for i in range(count)], float)
        self.slides = np.array([_slides(model, d) for d in range(n)], np.int32)
        self.applied = np.zeros(n)  # a push from outside, generalised, N or N m
        self.pose = np.zeros(13 * count + 6 * n)  # frames, hinge angles, axes and anchors: what the markers follow
        self.turn = self.data.xmat[1:].reshape(-1, 3, 3)  # a view
        self.centre, self.twist = np.zeros((count, 3)), np.zeros((count, 6))  # of the interior water, in the world
        self.system, self._right = np.zeros((n, n)), np.zeros(n)
        self.smooth, self.gain = np.zeros(n), np.zeros((count, 6))
        self.interior_speed = np.full(count, np.nan)  # m/s, of the interior water along each link; nan: it moves with the link
        self.layers, self._has_layers = np.zeros((count, 6, 6)), np.zeros(1, np.int32)
        self._now, self._weight = np.zeros((count, 6)), np.zeros((count, 6))
        self.momentum = np.zeros((count, 6))  # of the interior water at the end of the step before; written in place
        self.layer_momentum, self.sheet_momentum = np.zeros((count, 6)), np.zeros((count, 6))  # of the layers: at that time, now
        self.impulse, self._target, self._dt, self._check = np.zeros(n), np.zeros(n), np.zeros(1), np.zeros(2)
        self._moving, self._move = self._follow(
            water, centre=self.centre, twist=self.twist, now=self._now, sheet=self.sheet_momentum
        )
        plain, whole = self._equations(0), self._equations(1)  # without and with the water's gain
        self._balance = [link_dynamics.Recorded(link_dynamics.assemble, e) for e in (plain, whole)]
        self._inverse_force, self._compare = (
            link_dynamics.Recorded(kernel, whole) for kernel in (link_dynamics.inverse_force, link_dynamics.compare)
        )
        self._boxes: tuple | None = None
        self.set_step(dt)
        self.forward()
        self.momentum[:] = self._now

    @classmethod
    def of(cls, robot="fish", root: str = "planar", dt: float = 0.004) -> "ImmersedBody":
        """Body of a described fish, at rest and straight at the origin."""
        robot = load_robot(robot)
        return cls(build(robot, root, bare=True), DisplacedWater.of(robot), dt)

    @classmethod
    def on_slides(cls, axes: str, mass: float, inertia, displaced: float, inertia_displaced, dt: float) -> "ImmersedBody":
        """Smallest body: one link on slides along some of `xyz`, without gravity. Masses kg, moments of inertia (3,) kg m2.

        Raises ConfigError: axes that are not of `xyz` or are repeated; invalid masses or moments.
        """
        if not isinstance(axes, str) or not axes or len(set(axes)) < len(axes) or set(axes) - set("xyz"):
            raise ConfigError(f"body: axes = {axes!r}; expected one to three of 'xyz', each once")
        mass = float(numbers("body: mass", mass, low=1e-300))
        inertia = numbers("body: inertia", inertia, (3,), low=1e-300)
        if 2 * inertia.max() > inertia.sum() * (1 + 1e-9):
            raise ConfigError(f"body: inertia = {inertia.tolist()}; expected no moment above the sum of the other two")
        inside = np.diag(numbers("body: inertia_displaced", inertia_displaced, (3,), low=0.0))[None]
        spec = mujoco.MjSpec()
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
        spec.option.gravity = [0, 0, 0]
        link = spec.worldbody.add_body(name="body")
        link.mass, link.inertia, link.ipos, link.explicitinertial = mass, inertia, [0, 0, 0], True
        for name in axes:
            link.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=np.eye(3)["xyz".index(name)])
        water = DisplacedWater(mass=np.array([displaced]), centre=np.zeros((1, 3)), inertia=inside)
        return cls(passive_slot.compiled(spec), water, dt)

    def set_step(self, dt: float) -> None:
        """Sets the time step, s."""
        numbers("body: dt", dt, low=1e-300)
        self.dt = self.model.opt.timestep = self._dt[0] = float(dt)
        self._weigh()

    def place(self, qpos, qvel=None, interior_speed=np.nan) -> None:
        """Puts the body into a state; its water moves with it, along the links at `interior_speed` (L,) m/s, and gains nothing.

        Args:
            qpos: (nq,) m, rad and quaternions. qvel: (n,) m/s and rad/s; None: at rest.

        Raises ConfigError: another shape, or not finite.
        """
        qpos = numbers("body: qpos", qpos, (self.model.nq,))
        qvel = 0.0 if qvel is None else numbers("body: qvel", qvel, (self.dofs,))
        if np.shape(interior_speed) not in ((), (self.links,)) or np.asarray(interior_speed).dtype.kind not in "iuf":
            raise ConfigError(f"body: interior_speed = {shown_value(interior_speed)}; expected ({self.links},) m/s, nan for none")
        self.data.qpos[:], self.data.qvel[:], self.interior_speed[:] = qpos, qvel, interior_speed
        self._weigh()
        self.forward()
        self.momentum[:], self.layer_momentum[:] = self._now, self.sheet_momentum

    def carry_layers(self, inertia: np.ndarray) -> None:
        """Sets the inertia (L, 6, 6) of the layers of water on the sheets (`Markers.layer_inertia`); they gain nothing by it."""
        if np.array_equal(self.layers, inertia):  # the same body in other water
            return
        self.layers[:] = inertia
        self._has_layers[:], self.sheet_momentum[:] = inertia.any(), 0.0
        self._move.launch()
        self.layer_momentum[:] = self.sheet_momentum

    def set_interior_speed(self, speed: np.ndarray) -> None:
        """Sets the speed of the interior water along the links, (L,) m/s. Its gain counts from the second call on."""
        if np.isnan(self.interior_speed[0]):
            # the first value is a state, not a change: otherwise the water would seem to have accelerated within one step
            axis = self.turn[:, :, 0]
            self.momentum[:, :3] += (self.water.mass * speed - np.sum(axis * self.momentum[:, :3], 1))[:, None] * axis
        self.interior_speed[:] = speed

    def _weigh(self) -> None:
        """Computes the impulse (L, 6) of the displaced water's weight over a step."""
        self._weight[:, :3] = self.dt * self.water.mass[:, None] * self.model.opt.gravity

    def forward(self) -> None:
        """Computes from qpos and qvel all that the next step's equation needs.

        Also `centre` and `twist` of the interior water.
        """
        d = self.data
        for name, values in (("qpos", d.qpos), ("qvel", d.qvel)):
            if not np.isfinite(values).all():  # MuJoCo would put the model back to where it began
                raise ConfigError(f"body: {name} = {values.tolist()} at t = {d.time:.4g} s; expected finite numbers")
        mujoco.mj_step1(self.model, d)
        if d.nefc:
            raise ConfigError(
                f"body: {_active(self.model, d)} at t = {d.time:.4g} s; the coupled step leaves MuJoCo's"
                " constraints out. Switch them off: option.disableflags |= mjDSBL_CONSTRAINT"
            )
        self._move.launch()
        self._boxes = None

    def equation(self, interior: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """System matrix (M + dt D), (n, n), and right-hand side without b0, (n,), in momentum units, at the present state."""
        if not np.isfinite(self.data.ctrl).all():  # MuJoCo would take 0 for it, with a line in a log file
            raise ConfigError(f"body: ctrl = {self.data.ctrl.tolist()} at t = {self.data.time:.4g} s; expected finite numbers")
        if self.data.qfrc_applied.any() or self.data.xfrc_applied.any():  # `advance` would write over it
            raise ConfigError(
                f"body: data.qfrc_applied or xfrc_applied is set at t = {self.data.time:.4g} s; a push from outside goes into"
                " `body.applied`, (n,) N and N m"
            )
        mujoco.mj_fwdActuation(self.model, self.data)  # ctrl may be newer than the state
        mujoco.mj_fullM(self.model, self.data, self.system)
        self._balance[interior].launch()
        return self.system, self._right

    def water_momentum(self) -> np.ndarray:
        """Linear and angular momentum (about its own centre) of each link's displaced water, world axes, (L, 6)."""
        return self._now.copy()

    def solid_momentum(self) -> np.ndarray:
        """Linear and angular momentum of the links themselves, (L, 6) kg m/s and kg m2/s."""
        m = self.model
        axes = np.zeros((self.links, 9))
        for i in range(self.links):
            mujoco.mju_quat2Mat(axes[i], m.body_iquat[i + 1])
        axes = axes.reshape(-1, 3, 3)
        inertia = np.einsum("lab,lb,lcb->lac", axes, m.body_inertia[1:], axes)
        found = np.zeros((self.links, 6))
        solid = DisplacedWater(mass=m.body_mass[1:], centre=m.body_ipos[1:], inertia=inertia)
        zero = {"centre": np.zeros((self.links, 3)), "twist": np.zeros((self.links, 6)), "sheet": np.zeros((self.links, 6))}
        self._follow(solid, now=found, **zero)[1].launch()
        return found

    def _follow(self, mass: DisplacedWater, **found: np.ndarray) -> tuple[link_dynamics.LinkArrays, link_dynamics.Recorded]:
        """Arrays that describe the motion of masses in the links, and the launch that fills the arrays in `found`."""
        m, d, n = self.model, self.data, self.dofs
        s, share = link_dynamics.LinkArrays(), link_dynamics.host_view
        s.links, s.dofs = self.links, n
        s.place, s.turn = share(d.xpos[1:]), share(d.xmat[1:])
        s.mujoco_axis, s.mujoco_anchor, s.qpos, s.qvel = (share(a) for a in (d.xaxis, d.xanchor, d.qpos, d.qvel))
        kind = np.full(n, link_dynamics.HINGE, np.int32)
        for first, what in zip(m.jnt_dofadr, m.jnt_type, strict=True):
            if what == FREE:
                kind[first : first + 6] = *(link_dynamics.FIXED - np.arange(3)), 0, 1, 2
            elif what == BALL:  # it and a free joint spin about their body's axes
                kind[first : first + 3] = 0, 1, 2
        s.joint, s.kind = share(m.dof_jntid.astype(np.int32), int), share(kind, int)
        s.carrier = share((m.dof_bodyid - 1).astype(np.int32), int)
        s.slides, s.reach = share(self.slides, int), share(self.reach)
        s.hinge = share(np.array([_hinge_address(m, i + 1) for i in range(self.links)], np.int32), int)
        s.arm, s.mass, s.inertia = (share(np.array(a, float)) for a in (mass.centre, mass.mass, mass.inertia))
        s.pose, s.jacobian = share(self.pose), share(np.zeros((6 * self.links, n)))
        mine = mass is self.water
        s.layers, s.has_layers = share(self.layers), share(self._has_layers if mine else np.zeros(1, np.int32), int)
        s.interior_speed = share(self.interior_speed if mine else np.full(self.links, np.nan))
        s.centre, s.twist, s.now, s.sheet = (share(found[name]) for name in ("centre", "twist", "now", "sheet"))
        return s, link_dynamics.Recorded(link_dynamics.move, s)

    def _equations(self, interior: int) -> link_dynamics.LinkDynamics:
        """Arrays of the step's equation."""
        d, e, share = self.data, link_dynamics.LinkDynamics(), link_dynamics.host_view
        e.body, e.interior = self._moving, interior
        e.dt, e.damping, e.applied = share(self._dt), share(self.model.dof_damping), share(self.applied)
        e.passive, e.actuator, e.bias = share(d.qfrc_passive), share(d.qfrc_actuator), share(d.qfrc_bias)
        e.layer_last = share(self.layer_momentum)
        e.weight, e.last, e.gain, e.impulse = (share(a) for a in (self._weight, self.momentum, self.gain, self.impulse))
        e.smooth, e.system, e.right = share(self.smooth), share(self.system), share(self._right)
        e.target, e.applied_force, e.check = share(self._target), share(d.qfrc_applied), share(self._check)
        return e

    def advance(self, velocity: np.ndarray) -> None:
        """Does MuJoCo's step to the velocity that the solve found, (n,); afterwards the new state has been passed to `forward`.

        Raises SimDiverged: the velocity is not finite or too large (the state is then the last good one), or MuJoCo disagrees.
        """
        d, check = self.data, self._check
        self._target[:] = velocity
        self._inverse_force.launch()
        if not check[0] < RUNAWAY:  # nan is never less
            at = int(np.argmax(np.nan_to_num(np.abs(velocity), nan=np.inf)))
            joint = self.model.joint(self.model.dof_jntid[at]).name
            message = f"oracle: velocity of joint {joint!r} is {velocity[at]:.3g} at t = {d.time:.4g} s (limit {RUNAWAY:g})"
            d.qfrc_applied[:] = 0.0  # the next attempt would take it for a push from outside
            raise SimDiverged(message, time=float(d.time), term="coupling", link=joint)
        mujoco.mj_step2(self.model, d)
        d.qfrc_applied[:] = 0.0
        self._compare.launch()
        if not check[1] < EXACT:
            off = check[1] * (1 + check[0])
            message = f"oracle: mj_step is {off:.3g} off the velocity found at t = {d.time:.4g} s"
            raise SimDiverged(message, time=float(d.time), term="mj_step")
        self.forward()

    def bounds(self, corners: Corners) -> tuple[np.ndarray, np.ndarray]:
        """Low and high corner (3,) m of the upright box round `corners`."""
        low_high = self.corner_box(corners)
        return low_high[:3].copy(), low_high[3:6].copy()

    def fastest(self, corners: Corners) -> float:
        """Greatest speed of the corners, m/s: no marker inside the boxes that they span is faster."""
        return float(self.corner_box(corners)[9])

    def first_cell(self, corners: Corners) -> np.ndarray:
        """First cell (3,) of the box of cells round the corners (`Corners.set_grid`); read it before the body moves."""
        return self.corner_box(corners)[6:9]

    def corner_box(self, corners: Corners) -> np.ndarray:
        """Result (10,) of `Corners.measure`, cached until the body moves."""
        if self._boxes is None or self._boxes[0] is not corners:
            self._boxes = corners, corners.measure(self.pose, self.twist)
        return self._boxes[1]

    def largest_extent(self, corners: Corners) -> np.ndarray:
        """Size (3,) m that the corners' box cannot exceed in any pose; infinite along an axis on which links can part."""
        m, d = self.model, self.data
        far = np.linalg.norm(corners.at, axis=-1).max(-1)  # (L,) from each link's origin
        length = float((far[:, None] + farthest_apart(m) + far).max())
        if not self._upright():
            return np.full(3, length)
        # no joint lifts a link relative to another: every corner keeps its height above the first link
        above = (
            d.xpos[1:, 2, None]
            - d.xpos[1, 2]
            + np.where(d.xmat[1:, 8, None] == 1.0, corners.at[..., 2], np.einsum("lc,lkc->lk", d.xmat[1:, 6:], corners.at))
        )
        return np.array([length, length, 2 * np.abs(above).max()])

    def bends(self, before: int, after: int) -> bool:
        """Returns True if link `after` hangs on link `before` by one hinge about its z axis, as a skin between the two needs."""
        m, joint = self.model, self.model.body_jntadr[after + 1]
        hung = m.body_parentid[after + 1] == before + 1 and _hinge_address(m, after + 1) >= 0
        return bool(hung and m.qpos0[m.jnt_qposadr[joint]] == 0.0 and m.jnt_axis[joint][2] == 1.0)

    def _upright(self) -> bool:
        """Returns True if all rotations are about vertical axes, and vertical slides move all links at once."""
        for j, kind in enumerate(self.model.jnt_type):
            rise = abs(self.data.xaxis[j][2])
            alone = not self.reach[:, self.model.jnt_dofadr[j]].all()
            if kind in (FREE, BALL) or (kind == HINGE and rise < 1 - 1e-9) or (kind == SLIDE and alone and rise > 1e-9):
                return False
        return True


def farthest_apart(model) -> np.ndarray:
    """Greatest distance (L, L) m between the origins of two links in any pose; infinite if one slides relative to the other."""
    count, parent = model.nbody - 1, model.body_parentid[1:] - 1
    room = np.zeros(count)  # that a link's joints leave its origin round its place in the parent's frame
    for body, kind, anchor in zip(model.jnt_bodyid - 1, model.jnt_type, model.jnt_pos, strict=True):
        room[body] += np.inf if kind in (SLIDE, FREE) else 2 * np.linalg.norm(anchor)
    step = np.linalg.norm(model.body_pos[1:], axis=1) + room
    above: list[list[int]] = []  # of each link: itself, its parent and so on
    for i in range(count):
        above.append([i, *(above[parent[i]] if parent[i] >= 0 else [])])
    apart = np.zeros((count, count))
    for i in range(count):
        for j in range(i):
            one, other = ([k for k in above[a] if k not in above[b]] for a, b in ((i, j), (j, i)))
            total = step[one[:-1]].sum() + step[other[:-1]].sum()
            if one and other:  # two branches of one link, or of the world
                a, b = one[-1], other[-1]
                total += np.linalg.norm(model.body_pos[a + 1] - model.body_pos[b + 1]) + room[a] + room[b]
            else:
                total += step[(one or other)[-1]]
            apart[i, j] = apart[j, i] = total
    return apart


def _refuse_what_is_left_out(m: mujoco.MjModel) -> None:
    """Raises ConfigError for a model with more in it than the coupled step computes."""
    turns = np.isin(m.jnt_type, (HINGE, BALL))
    crowded = [b for b in m.jnt_bodyid[m.jnt_type == BALL] if turns[m.jnt_bodyid == b].sum() > 1]
    water, masses = m.opt.density or m.opt.viscosity, np.concatenate([m.body_mass, m.body_inertia.ravel()])
    left_out = {
        "no degree of freedom": m.nv == 0,
        "water of MuJoCo's own beside the solver's (option density, viscosity: set both to 0)": water,
        "a mocap body": m.nmocap,
        "a mass or moment of inertia below zero or not finite": not bool(((0 <= masses) & (masses < np.inf)).all()),
        "an integrator other than Euler": m.opt.integrator != mujoco.mjtIntegrator.mjINT_EULER,
        "the implicit damping of the Euler integrator switched off": m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_EULERDAMP,
        f"a ball joint beside another rotation in body {m.body(crowded[0]).name!r}" if crowded else "": crowded,
    }
    found = [name for name, there in left_out.items() if there]
    if found:
        raise ConfigError(f"body: the model has {', '.join(found)}; the coupled step computes none of these")


def _active(m: mujoco.MjModel, d: mujoco.MjData) -> str:
    """MuJoCo's constraints that act now, in words."""
    if d.ncon:
        names = [m.body(m.geom_bodyid[geom]).name for geom in d.contact[0].geom]
        return f"contact between bodies {names[0]!r} and {names[1]!r}"
    kinds = {int(kind) for kind in d.efc_type[: d.nefc]}
    return (
        " and ".join(mujoco.mjtConstraint(kind).name.removeprefix("mjCNSTR_").lower() for kind in sorted(kinds)) + " constraint"
    )


def _check_points(points: Points, links: int) -> None:
    """Raises ConfigError for points in no link, and if the shares of a link do not add up to 1."""
    place = numbers("displaced water: place of points", points.place, (None, 3))
    link = whole_numbers("displaced water: link of points", points.link, (len(place),), low=0, high=links - 1)
    share = numbers("displaced water: share of points", points.share, (len(place),), low=0.0)
    total = np.bincount(link, share, links)
    if not np.allclose(total, 1.0, atol=1e-6):
        at = int(np.argmax(np.abs(total - 1.0)))
        raise ConfigError(f"displaced water: shares of the points of link {at} add up to {total[at]:g}; expected 1")


def _moves(model, body: int, dof: int) -> bool:
    """Returns True if a degree of freedom moves a body: it belongs to the body or to one of its ancestors."""
    while body:
        if model.dof_bodyid[dof] == body:
            return True
        body = model.body_parentid[body]
    return False


def _slides(model, dof: int) -> bool:
    joint = model.dof_jntid[dof]
    kind = model.jnt_type[joint]
    return kind == mujoco.mjtJoint.mjJNT_SLIDE or (kind == mujoco.mjtJoint.mjJNT_FREE and dof - model.jnt_dofadr[joint] < 3)


def _hinge_address(model, body: int) -> int:
    """Address in qpos of the one hinge that hangs a body on another moving body; -1 if there is none."""
    if model.body_parentid[body] == 0 or model.body_jntnum[body] != 1:
        return -1
    joint = model.body_jntadr[body]
    return int(model.jnt_qposadr[joint]) if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE else -1
