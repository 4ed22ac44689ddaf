"""Random robots: a tree of hinges with motors, as constants for every generator, and as MJCF, the described model.

    pendulum   one hinge                two_link   two hinges in one plane
    arm        six hinges               legs       four legs of three hinges on a fixed torso
    quadrotor  a free body with four rotors on sites

Lengths, masses, stated friction and the kind of actuator are drawn. All units SI.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from fishmj.base.calib import calib_folder, read_toml

GRAVITY = 9.81
STEP = 0.002  # s, of the described model
ANGLE = 3.1  # rad, largest commanded angle
LARGEST_THRUST = 100.0  # N, largest command of a rotor
THIN = 0.15  # ratio of a link's moment of inertia about its own axis to that across


Vector = tuple[float, ...]  # (3,)


class Limb(NamedTuple):
    """Body with its hinge and motor.

    parent: number of its parent, -1 for the base. place: of the hinge in the parent's frame. inertia: principal, about `centre`.
    gear: of a torque motor. kp, kv: of a position servo, 0 for a torque motor. limit: largest torque of the motor. swing:
    middle and amplitude of its motion, rad.
    """

    parent: int
    place: Vector
    axis: Vector
    centre: Vector
    mass: float
    inertia: Vector
    armature: float = 0.0
    friction: float = 0.0
    damping: float = 0.0
    drag: float = 0.0
    stiffness: float = 0.0
    gear: float = 1.0
    kp: float = 0.0
    kv: float = 0.0
    limit: float = 0.0
    offset: float = 0.0
    swing: tuple[float, float] = (0.0, 0.5)


class Rotor(NamedTuple):
    """Thruster of a free body, along its z. place: in the body. turn: torque about z over thrust, m.

    gain: thrust over command. limit, offset: N. lag: s, time constant of the thrust.
    """

    place: Vector
    turn: float
    gain: float = 1.0
    limit: float = 0.0
    offset: float = 0.0
    lag: float = 0.0


class RobotPlan(NamedTuple):
    """Robot. torques: commands are torques, not angles. gravity: (3,) m/s2. density, wind: of the medium, kg/m3 and m/s.

    rotors: if any, the only body floats without a hinge, and commands are thrusts, N.
    """

    family: str
    limbs: tuple[Limb, ...]
    torques: bool
    gravity: Vector = (0.0, 0.0, -GRAVITY)
    density: float = 0.0
    wind: Vector = (0.0, 0.0, 0.0)
    rotors: tuple[Rotor, ...] = ()

    def changed(self, number: int, **fields) -> "RobotPlan":
        """The robot with fields of one limb replaced."""
        limbs = list(self.limbs)
        limbs[number] = limbs[number]._replace(**fields)
        return self._replace(limbs=tuple(limbs))

    def with_rotor(self, number: int, **fields) -> "RobotPlan":
        """The robot with fields of one rotor replaced."""
        rotors = list(self.rotors)
        rotors[number] = rotors[number]._replace(**fields)
        return self._replace(rotors=tuple(rotors))

    def column(self, field: str) -> np.ndarray:
        """(J, ..) one field of all limbs."""
        return np.array([getattr(limb, field) for limb in self.limbs], float)

    def of_rotors(self, field: str) -> np.ndarray:
        """(A, ..) one field of all rotors."""
        return np.array([getattr(rotor, field) for rotor in self.rotors], float)


def joint(number: int) -> str:
    """Name of a hinge and of its actuator."""
    return f"j{number + 1}"


def body(number: int) -> str:
    """Name of a body."""
    return f"b{number + 1}"


def rotor(number: int) -> str:
    """Name of a rotor's actuator and site."""
    return f"r{number + 1}"


def mjcf(plan: RobotPlan, step: float = STEP, integrator: str = "implicitfast", motors: bool = False) -> str:
    """MJCF of a robot. motors: an ideal motor at each joint in place of the robot's own actuators."""
    text = lambda values: " ".join(f"{x:.9g}" for x in np.atleast_1d(values))

    def written(number: int, indent: str) -> str:
        b = plan.limbs[number]
        damping = f'damping="{text((b.damping, b.drag, 0.0))}" frictionloss="{b.friction:.9g}" armature="{b.armature:.9g}"'
        hinge = f'<joint name="{joint(number)}" type="hinge" axis="{text(b.axis)}" {damping} stiffness="{b.stiffness:.9g}"/>'
        if plan.rotors:
            sites = (f'<site name="{rotor(k)}" pos="{text(r.place)}"/>' for k, r in enumerate(plan.rotors))
            hinge = "\n".join(['<freejoint name="base"/>', *(f"{indent}  {site}" for site in sites)])
        inner = "".join(written(k, indent + "  ") for k, child in enumerate(plan.limbs) if child.parent == number)
        return (
            f'{indent}<body name="{body(number)}" pos="{text(b.place)}">\n'
            f"{indent}  {hinge}\n"
            f'{indent}  <inertial pos="{text(b.centre)}" mass="{b.mass:.9g}" diaginertia="{text(b.inertia)}"/>\n'
            f"{inner}{indent}</body>\n"
        )

    def actuator(number: int, b: Limb) -> str:
        about = f'name="{joint(number)}" joint="{joint(number)}"'
        if motors:
            return f"    <motor {about}/>\n"
        bias = f'biastype="affine" biasprm="{text((b.offset, -b.kp, -b.kv))}"'
        most = b.limit / (b.gear if plan.torques and not b.offset else 1.0)
        bounds = f'forcerange="{-most:.9g} {most:.9g}"'
        gain = b.gear if plan.torques else b.kp
        if b.offset:
            return f'    <general {about} gaintype="fixed" gainprm="{gain:.9g}" {bias} {bounds}/>\n'
        if plan.torques:
            return f'    <motor {about} gear="{b.gear:.9g}" {bounds}/>\n'
        return f'    <position {about} kp="{b.kp:.9g}" kv="{b.kv:.9g}" {bounds}/>\n'

    def thruster(number: int, r: Rotor) -> str:
        about = f'name="{rotor(number)}" site="{rotor(number)}" gear="0 0 1 0 0 {r.turn:.9g}"'
        force = f'gaintype="fixed" gainprm="{r.gain:.9g}" biastype="affine" biasprm="{r.offset:.9g} 0 0"'
        return f'    <general {about} {force} ctrlrange="0 {LARGEST_THRUST:g}" forcerange="0 {r.limit:.9g}"/>\n'

    roots = "".join(written(k, "    ") for k, b in enumerate(plan.limbs) if b.parent < 0)
    motor = "".join(actuator(k, b) for k, b in enumerate(plan.limbs) if not plan.rotors)
    motor += "".join(thruster(k, r) for k, r in enumerate(plan.rotors))
    medium = f' density="{plan.density:.9g}" wind="{text(plan.wind)}"' if plan.density else ""
    options = f'timestep="{step:g}" integrator="{integrator}" gravity="{text(plan.gravity)}"{medium}'
    return (
        f'<mujoco model="{plan.family}">\n  <option {options}/>\n  <worldbody>\n{roots}  </worldbody>\n'
        f"  <actuator>\n{motor}  </actuator>\n</mujoco>\n"
    )


# ------------------------------------------------------------------------------------------------------------------------ drawing
def _rod(rng, parent, place, axis, along, length, mass, off=0.06, **more) -> Limb:
    """Link of random length, mass and centre. along: its direction; off: offset of the centre from its axis over the length."""
    length, mass = length * rng.uniform(0.8, 1.25), mass * rng.uniform(0.7, 1.4)
    along = np.array(along, float)
    aside = rng.uniform(-off, off, 3) * length * (1.0 - np.abs(along))
    centre = along * length * rng.uniform(0.4, 0.65) + aside
    across = mass * length**2 / 12.0 * rng.uniform(0.8, 1.5)
    inertia = np.where(np.abs(along) > 0.5, THIN * across, across)
    return Limb(parent, tuple(place), axis, tuple(map(float, centre)), float(mass), tuple(map(float, inertia)), **more)


X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
DOWN = (0.0, 0.0, -1.0)


def _pendulum(rng) -> list[Limb]:
    length = rng.uniform(0.2, 0.5)
    return [_rod(rng, -1, (0.0, 0.0, 0.0), Y, DOWN, length, rng.uniform(0.4, 1.6), swing=(0.0, rng.uniform(0.6, 1.1)))]


def _two_link(rng) -> list[Limb]:
    upper, lower = rng.uniform(0.2, 0.45, 2)
    first = _rod(rng, -1, (0.0, 0.0, 0.0), Y, DOWN, upper, rng.uniform(0.5, 1.2), swing=(0.0, 0.8))
    return [first, _rod(rng, 0, (0.0, 0.0, -upper), Y, DOWN, lower, rng.uniform(0.3, 0.7), swing=(0.0, 0.9))]


def _arm(rng) -> list[Limb]:
    upper, fore = rng.uniform(0.3, 0.45, 2)
    return [
        _rod(rng, -1, (0.0, 0.0, 0.0), Z, Z, 0.15, 3.0, armature=0.08, swing=(0.0, 0.6)),
        _rod(rng, 0, (0.0, 0.0, 0.15), Y, X, upper, 3.0, armature=0.08, swing=(-0.6, 0.4)),
        _rod(rng, 1, (upper, 0.0, 0.0), Y, X, fore, 2.0, armature=0.05, swing=(0.9, 0.5)),
        _rod(rng, 2, (fore, 0.0, 0.0), X, X, 0.12, 0.8, armature=0.012, swing=(0.0, 0.7)),
        _rod(rng, 3, (0.12, 0.0, 0.0), Y, X, 0.12, 0.6, armature=0.01, swing=(0.3, 0.7)),
        _rod(rng, 4, (0.1, 0.0, 0.0), X, X, 0.1, 0.5, off=0.4, armature=0.006, swing=(0.0, 0.8)),
    ]


def _legs(rng) -> list[Limb]:
    out: list[Limb] = []
    thigh, shank = rng.uniform(0.18, 0.24, 2)
    state = rng.bit_generator.state
    for x, y in ((0.2, 0.05), (0.2, -0.05), (-0.2, 0.05), (-0.2, -0.05)):
        rng.bit_generator.state = state  # four legs alike
        side = (0.0, float(np.sign(y)), 0.0)
        n = len(out)
        out += [
            _rod(rng, -1, (x, y, 0.0), X, side, 0.09, 0.7, armature=0.01, swing=(0.0, 0.35)),
            _rod(rng, n, (0.0, 0.09 * np.sign(y), 0.0), Y, DOWN, thigh, 1.1, armature=0.01, swing=(0.6, 0.5)),
            _rod(rng, n + 1, (0.0, 0.0, -thigh), Y, DOWN, shank, 0.25, armature=0.012, swing=(-1.2, 0.5)),
        ]
    return out


FAMILIES: dict[str, Callable[[np.random.Generator], list[Limb]]] = {
    "pendulum": _pendulum,
    "two_link": _two_link,
    "arm": _arm,
    "legs": _legs,
}
QUADROTOR = "quadrotor"


def _quadrotor(rng) -> RobotPlan:
    """A frame of 0.2 to 0.5 m from rotor to rotor, its centre a little below their plane; they turn in pairs."""
    arm, mass = float(rng.uniform(0.1, 0.25)), float(rng.uniform(0.5, 1.8))
    across = 0.25 * mass * arm**2 * rng.uniform(0.7, 1.3)
    inertia = (float(across * rng.uniform(0.9, 1.1)), float(across), float(1.7 * across * rng.uniform(0.9, 1.1)))
    frame = Limb(-1, (0.0, 0.0, 0.0), Z, (0.0, 0.0, float(-rng.uniform(0.0, 0.03))), mass, inertia)
    half, turn, most = arm / np.sqrt(2.0), float(rng.uniform(0.01, 0.02)), float(mass * GRAVITY * rng.uniform(0.5, 0.8))
    places = [(half, -half, 1.0), (-half, half, 1.0), (half, half, -1.0), (-half, -half, -1.0)]
    rotors = tuple(Rotor((float(x), float(y), 0.0), side * turn, limit=most) for x, y, side in places)
    return RobotPlan(QUADROTOR, (frame,), True, rotors=rotors)


def draw_plan(family: str, rng: np.random.Generator) -> RobotPlan:
    """Draws a robot of a family. Half of them take torques, half angles; half state friction and damping."""
    if family == QUADROTOR:
        return _quadrotor(rng)
    limbs = FAMILIES[family](rng)
    torques, stated = bool(rng.integers(2)), bool(rng.integers(2))
    if len(limbs) <= 2 and rng.integers(2):
        limbs = [b._replace(armature=b.mass * float(np.dot(b.centre, b.centre)) * rng.uniform(0.1, 0.4)) for b in limbs]
    plan = RobotPlan(family, tuple(limbs), torques)
    carried, load = carried_inertia(plan), held_torque(plan)
    for k in range(len(plan.limbs)):
        scale = load[k] + 10.0 * carried[k]  # N m, torque of a usual motion
        own = {"limit": float(6.0 * scale)}
        if stated:
            own |= {"friction": float(scale * rng.uniform(0.01, 0.05)), "damping": float(scale * rng.uniform(0.005, 0.02))}
        if not torques:
            kp = max(carried[k] * rng.uniform(14.0, 22.0) ** 2, 3.0 * load[k])
            own |= {"kp": float(kp), "kv": float(2.0 * rng.uniform(0.5, 0.8) * np.sqrt(kp * carried[k]))}
        plan = plan.changed(k, **own)
    return plan


def carried_inertia(plan: RobotPlan) -> np.ndarray:
    """Inertia (J,) [kg m2] about each hinge of all bodies that it carries, the other joints at 0."""
    origins, axes = _frames(plan)
    out = plan.column("armature").copy()
    for k in range(len(plan.limbs)):
        for n, b in enumerate(plan.limbs):
            if k in _ancestors(plan, n):
                arm = np.cross(axes[k], origins[n] + np.array(b.centre) - origins[k])
                out[k] += b.mass * arm @ arm + np.dot(np.array(axes[k]) ** 2, b.inertia)
    return out


def held_torque(plan: RobotPlan) -> np.ndarray:
    """Largest torque (J,) [N m] of gravity at each hinge over its angle, the other joints at 0."""
    origins, axes = _frames(plan)
    out = np.zeros(len(plan.limbs))
    for k in range(len(plan.limbs)):
        whole = sum(
            (
                b.mass * (origins[n] + np.array(b.centre) - origins[k])
                for n, b in enumerate(plan.limbs)
                if k in _ancestors(plan, n)
            ),
            np.zeros(3),
        )
        across = np.array(plan.gravity) - axes[k] * np.dot(axes[k], plan.gravity)
        radial = whole - axes[k] * np.dot(axes[k], whole)
        out[k] = float(np.linalg.norm(across) * np.linalg.norm(radial))
    return out


def _frames(plan: RobotPlan) -> tuple[np.ndarray, np.ndarray]:
    """(J, 3) origins and axes at angle 0, where all frames are parallel."""
    origins = np.zeros((len(plan.limbs), 3))
    for k, b in enumerate(plan.limbs):
        origins[k] = np.array(b.place) + (origins[b.parent] if b.parent >= 0 else 0.0)
    return origins, plan.column("axis")


def _ancestors(plan: RobotPlan, number: int) -> set[int]:
    """Numbers of the limbs from one to the base, itself included."""
    out = set()
    while number >= 0:
        out.add(number)
        number = plan.limbs[number].parent
    return out


def tolerances() -> Mapping[str, float]:
    """Stated standard deviations of data/calib/robot.toml: mass, inertia, centre, gain, friction, torque (and its spacing, s)."""
    return {key: entry["value"] for key, entry in read_toml(calib_folder() / "robot.toml")["tolerance"].items()}


def within_tolerance(plan: RobotPlan, rng: np.random.Generator) -> RobotPlan:
    """Draws each constant of a robot within its stated tolerance."""
    sigma = tolerances()
    limbs = []
    for b in plan.limbs:
        mass, inertia, centre, gain, friction, damping = (
            float(np.exp(sigma[key] * rng.standard_normal()))
            for key in ("mass", "inertia", "centre", "gain", "friction", "friction")
        )
        limbs.append(
            b._replace(
                mass=b.mass * mass,
                inertia=tuple(mass * inertia * x for x in b.inertia),
                centre=tuple(centre * x for x in b.centre),
                gear=b.gear * gain,
                kp=b.kp * gain,
                kv=b.kv * gain,
                friction=b.friction * friction,
                damping=b.damping * damping,
            )
        )
    gains = [rotor._replace(gain=rotor.gain * float(np.exp(sigma["gain"] * rng.standard_normal()))) for rotor in plan.rotors]
    return plan._replace(limbs=tuple(limbs), rotors=tuple(gains))
