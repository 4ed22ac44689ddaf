"""Detects mistakes in the logs of a robot in MJCF that would look like effects: order, signs, zeros, clocks, units.

The described model predicts some segments (records/shooting.py), once as logged and once with each possible mistake undone:

    two joints' positions or commands exchanged; one negated, or both; a quarter or half a turn added; degrees for radians, or one
    factor for all of both; commands earlier or later; thrusters in another order; of a free base's pose the mistakes of `POSES`

A mistake is reported if undoing it reduces the mean square error by a factor FAR. A search would name an effect that imitates it.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations, permutations
from typing import NamedTuple

import mujoco
import numpy as np

from fishmj import effects
from fishmj.base import console
from fishmj.base.errors import LogError
from fishmj.gap import progress
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.models.robot_description import RobotDescription
from fishmj.gap.models.robot_sizes import sizes_of
from fishmj.gap.records.attitude import quaternion_rate, rotation_vector
from fishmj.gap.records.shooting import RobotRecord, thinned
from fishmj.gap.wording import number

FAR = 3.0  # factor by which the mean square error must fall
EXPLAINED = 1.0  # the same with the mistake undone: above it the logs are no better explained than by a robot that rests
CERTAIN, OWN_UNIT = 30.0, "in a unit of their own"  # factor for a unit with a free scale: a smaller one suits many faults
CLOSE = 0.01  # mean square error over that of the movement: below it the logs are not doubted
PROBED = 16  # segments
# s that commands come later than logged; up to 0.2 s it is an effect
SHIFTS = (-0.5, -0.4, -0.3, -0.2, -0.15, -0.1, -0.06, -0.03, 0.25, 0.3, 0.4, 0.5)
TURNS = {"a quarter turn": 0.5 * np.pi, "a quarter turn back": -0.5 * np.pi, "half a turn": np.pi}
OUTSIDE, MARGIN = 0.1, 0.1  # share of readings outside a joint's range; least excess, as a share of the range
REACH = 4.0 * np.pi  # rad, largest angle of a joint in another unit
FACTORS = tuple(float(x) for x in np.geomspace(0.01, 0.5, 10))  # of normalised positions and commands, such as -100 to 100
UNMOVED = 1e-18  # rad^2 or m^2, mean square movement of a joint that does not move
MOST_ORDERS = 4  # up to so many thrusters every order is tried; with more, only exchanged pairs
STILL, TURNED, NOISE = 2e-3, 5e-3, 8.0  # m, rad: largest movement of a held base; standard deviations of its noise
JUMP = 1.5  # rad from one reading to the next
UNIT = np.log(3.0)  # of the factor by which a log's movement may differ from 180/pi


Undone = tuple[str, str, list[RobotRecord]]  # a possible mistake, its remedy, the corrected records


class Mistake(NamedTuple):
    """A likely mistake, its remedy, and the ratio of the mean square errors without and with the remedy."""

    what: str
    remedy: str
    ratio: float

    @property
    def text(self) -> str:
        """One sentence."""
        return f"{self.what} explains the logs {number(self.ratio)} times better: {self.remedy}"


def refuse_mistakes(robot: RobotDescription, records: Sequence[RobotRecord], anyway: bool = False) -> None:
    """Warns of suspicious readings in the logs.

    Raises LogError: undoing a mistake explains the logs far better, unless `anyway`; the message names the remedy.
    """
    for doubt in doubts(robot, records):
        console.warn(doubt)
    if robot.base and is_held(records):
        held = "the base stands still in every log, but the model has a floating base"
        if not anyway:
            raise LogError(f"{held}: if it was held, weld it in the model (no free joint); if it hovers so well, add --anyway")
        console.warn(held)
    found = mistakes(robot, records, progress.terminal_bar)
    if found and not anyway:
        raise LogError(f"{found[0].text}. If the logs are right, add --anyway")
    for mistake in found:
        console.warn(mistake.text)


def is_held(records: Sequence[RobotRecord]) -> bool:
    """Returns True if a free base neither moves by STILL nor turns by TURNED in any log."""
    for r in records:
        way = np.ptp(r.joint.values[:, :3], 0).max()
        turn = np.linalg.norm(rotation_vector(r.turns, r.turns[:1]), axis=-1).max()
        if way > STILL + NOISE * r.joint.sigma[:3].max() or turn > TURNED + NOISE * r.joint.sigma[3:6].max():
            return False
    return True


def doubts(robot: RobotDescription, records: Sequence[RobotRecord]) -> list[str]:
    """Warnings about readings or commands out of range, jumps that are not multiples of 2 pi, and joints that never move."""
    out, m = [], robot.model
    for j, joint in enumerate(robot.joints, 6 if robot.base else 0):
        q = np.concatenate([r.joint.values[:, j] for r in records])
        if m.jnt_limited[joint.joint]:
            low, high = m.jnt_range[joint.joint]
            beyond = np.mean((q < low - MARGIN * (high - low)) | (q > high + MARGIN * (high - low)))
            if beyond > OUTSIDE:
                message = f"{100 * beyond:.0f} % of its readings are outside its range, {low:.3g} to {high:.3g}"
                out.append(f"joint {joint.name}: {message}: wrong zero, unit or joint? Correct it in a map, --columns MAP.toml")
                if m.jnt_type[joint.joint] == mujoco.mjtJoint.mjJNT_HINGE and np.degrees(max(abs(low), abs(high))) <= 2 * np.pi:
                    stated = f"{np.degrees(low):.3g} to {np.degrees(high):.3g}"
                    out[-1] += f'; or the model means {stated} in rad: MJCF reads degrees without <compiler angle="radian"/>'
        if np.ptp(q) == 0 and joint.actuator >= 0 and any(np.ptp(r.commands[:, joint.actuator]) > 0 for r in records):
            out.append(
                f"joint {joint.name}: always {q[0]:.6g} while its commands change: is the encoder recorded? Is the joint held?"
            )
        jump = max(
            float(np.abs(np.diff(r.joint.values[:, j])[np.diff(r.joint.t) < r.length / 3]).max(initial=0.0)) for r in records
        )
        if jump > JUMP:
            out.append(f"joint {joint.name}: jumps by {jump:.3g} rad between two readings: does its encoder wrap not at 2 pi?")
    for a in np.flatnonzero(m.actuator_ctrllimited):
        (low, high), sent = m.actuator_ctrlrange[a], np.concatenate([r.commands[:, a] for r in records])
        beyond = np.mean((sent < low - MARGIN * (high - low)) | (sent > high + MARGIN * (high - low)))
        if beyond > OUTSIDE:
            message = f"{100 * beyond:.0f} % of its commands, up to {np.abs(sent).max():.3g}, are outside its ctrlrange"
            out.append(f"actuator {robot.actuators[a]}: {message}, {low:.3g} to {high:.3g}: another unit, or a measured current?")
    return out + in_another_unit(robot, records)


def in_another_unit(robot: RobotDescription, records: Sequence[RobotRecord]) -> list[str]:
    """Warnings about logs whose hinges and commands move 180/pi or pi/180 times as far as in the other logs."""
    hinges = [j for j in robot.joints if j.actuator >= 0 and robot.model.jnt_type[j.joint] == mujoco.mjtJoint.mjJNT_HINGE]
    if len(records) < 2 or not hinges or not robot.model.actuator_biasprm[:, 1].any():
        return []
    first = len(robot.channels) - len(robot.joints)
    read = [first + robot.joints.index(j) for j in hinges]
    ways = [[*np.ptp(r.joint.values[:, read], 0), *np.ptp(r.commands[:, [j.actuator for j in hinges]], 0)] for r in records]
    far = np.log(np.maximum(ways, 1e-9))
    out = []
    for k, r in enumerate(records):
        apart = far[k] - np.median(np.delete(far, k, 0), axis=0)
        for sign, way, one, other in ((-1, "little", "rad", "deg"), (1, "far", "deg", "rad")):
            if (np.abs(apart - sign * np.log(180 / np.pi)) < UNIT).all():
                moved = f"joints and commands move {np.exp(np.median(np.abs(apart))):.0f} times as {way} as in the other logs"
                out.append(f"{r.name}: {moved}: is it in {one} and the others in {other}? Use one unit, or leave this log out")
    return out


def mistakes(robot: RobotDescription, records: Sequence[RobotRecord], bars: progress.Bars = progress.silent_bar) -> list[Mistake]:
    """Likely mistakes, the likeliest first; none if the model is close to the logs."""
    few = thinned(list(records), PROBED)
    model = RigidRobot(robot, sizes_of(robot, few), [effects.robot_catalogue()["command_latency"]])
    still, plain = np.maximum(_error(few, None), UNMOVED), _error(few, model)
    if np.mean(plain / still) < CLOSE:
        return []
    found = []
    with bars(sum(1 for _ in undone(robot, few)), "mistakes in the logs", "tried") as bar:
        for i, (what, remedy, changed) in enumerate(undone(robot, few)):
            other = _error(changed, model) / np.maximum(_error(changed, None), UNMOVED)
            mistake = Mistake(what, remedy, _ratio(plain / still, other))
            if np.mean(other) < EXPLAINED and (OWN_UNIT not in what or mistake.ratio > CERTAIN):
                found.append(mistake)
            bar.update(i + 1)
    rows = np.tile(model.null, (len(SHIFTS), 1))
    rows[:, model.index("command_latency", "delay")] = SHIFTS
    for shift, error in zip(SHIFTS, _errors(few, model.predict(few, rows)), strict=True):
        late = f"{1000 * abs(shift):.0f} ms {'later' if shift > 0 else 'earlier'}"
        remedy = "commands and positions have stamps of different clocks; record both with one clock"
        if np.mean(error / still) < EXPLAINED:
            found.append(Mistake(f"commands {late} than logged", remedy, _ratio(plain / still, error / still)))
    return sorted((m for m in found if m.ratio > FAR), key=lambda m: -m.ratio)


def _ratio(plain: np.ndarray, other: np.ndarray) -> float:
    return float(np.mean(plain) / max(np.mean(other), 1e-12))


def undone(robot: RobotDescription, records: list[RobotRecord]) -> Iterator[Undone]:
    """Yields each possible mistake with its remedy and the corrected records."""
    names, numbers = robot.channels, [*([-1] * 6 if robot.base else []), *(j.actuator for j in robot.joints)]
    table = "in a map, --columns MAP.toml"
    yield from _of_thrusters(robot, records, table)
    if robot.base:
        for what, (remedy, turn, move) in POSES.items():
            yield f"the base's pose {what}", f"{remedy} {table}, [base]", [_posed(r, turn, move) for r in records]
    own = range(6 if robot.base else 0, len(names))
    for j, name in ((j, names[j]) for j in own):
        sign = np.ones(len(names))
        sign[j] = -1.0
        negated, a = [_of_angles(r, sign) for r in records], numbers[j]
        yield f"joint {name} with its positions negated", f"state sign = -1 for it {table}", negated
        if a >= 0:
            yield f"actuator {name} with its commands negated", f"state sign = -1 for it {table}", _asked(records, a, a, -1.0)
            both = _asked(negated, a, a, -1.0)
            yield f"joint {name} with positions and commands negated", f"state sign = -1 for both {table}", both
        for turn, angle in TURNS.items():
            zero = np.zeros(len(names))
            zero[j] = angle
            yield (
                f"joint {name} turned by {turn}",
                f"its encoder has another zero; state it as zero {table}",
                _turned(records, zero),
            )
    angles = [robot.model.jnt_type[j.joint] == mujoco.mjtJoint.mjJNT_HINGE for j in robot.joints]
    hinges = np.array([*([False] * 6 if robot.base else []), *angles])
    servos = bool(robot.model.actuator_biasprm[:, 1].any())
    for factor in FACTORS if servos and any(angles) else ():
        both = [_of_angles(r, np.where(hinges, factor, 1.0))._replace(commands=factor * r.commands) for r in records]
        scale = f"they may be normalised; state their unit, or scale (rad by one of it), for both {table}"
        yield f"reading positions and commands {OWN_UNIT} (times about {factor:.1g})", scale, both
    for what, unit, factor in (("degrees", "deg", np.pi / 180), ("radians", "rad", 180 / np.pi)) if any(angles) else ():
        if factor * max(float(np.abs(r.angles[:, hinges]).max()) for r in records) > REACH:
            continue  # whatever moves so fast keeps its rate for a segment: any model seems right
        turns = [_of_angles(r, np.where(hinges, factor, 1.0)) for r in records]
        yield f"reading positions in {what}", f'state unit = "{unit}", or the scale of a gear, for the joints {table}', turns
        if servos:
            both = [r._replace(commands=r.commands * factor) for r in turns]
            yield f"reading positions and commands in {what}", f'state unit = "{unit}" for both {table}', both
            asked = [r._replace(commands=r.commands * factor) for r in records]
            yield f"reading commands in {what}", f'state unit = "{unit}" for the actuators {table}', asked
    for i, k in combinations(own, 2):
        order = list(range(len(names)))
        order[i], order[k] = k, i
        pair = f"{names[i]} and {names[k]}"
        swapped = [_ordered(r, order) for r in records]
        yield f"exchanging the positions of {pair}", f"the joints are in another order; name their columns {table}", swapped
        if numbers[i] >= 0 and numbers[k] >= 0:
            asked = _asked(records, numbers[i], numbers[k], 1.0)
            yield f"exchanging the commands of {pair}", f"the actuators are in another order; name their columns {table}", asked
            both = _asked(swapped, numbers[i], numbers[k], 1.0)
            yield f"exchanging {pair}", f"the joints are in another order; name their columns {table}", both


def _of_thrusters(robot: RobotDescription, records: list[RobotRecord], table: str) -> Iterator[Undone]:
    """Mistakes of the thrusters' commands."""
    numbers = list(robot.thrusters.values())
    swapped = lambda i, k: tuple({i: k, k: i}.get(a, a) for a in numbers)
    few = len(numbers) <= MOST_ORDERS
    orders = list(permutations(numbers))[1:] if few else [swapped(i, k) for i, k in combinations(numbers, 2)]
    for of in orders:
        wanted = ", ".join(f"{name} = that of {robot.actuators[a]}" for name, a in zip(robot.thrusters, of, strict=True))
        what = f"another order of the thrusters ({wanted})"
        yield what, f"name their columns in that order {table}, [actuator]", [_commanded(r, numbers, of) for r in records]
    for name, a in robot.thrusters.items():
        yield f"thruster {name} with its commands negated", f"state sign = -1 for it {table}", _asked(records, a, a, -1.0)


def _commanded(r: RobotRecord, numbers: Sequence[int], of: Sequence[int]) -> RobotRecord:
    commands = r.commands.copy()
    commands[:, numbers] = r.commands[:, of]
    return r._replace(commands=commands)


def _product(q: tuple[float, ...], left: bool) -> np.ndarray:
    """(4, 4) matrix of the product q p, or p q, by p."""
    w, (x, y, z) = q[0], q[1:]
    side = 1.0 if left else -1.0
    return np.array([[w, -x, -y, -z], [x, w, -side * z, side * y], [y, side * z, w, -side * x], [z, -side * y, side * x, w]])


HALF = np.sqrt(0.5)
EAST_NORTH_UP = _product((0.0, HALF, HALF, 0.0), True) @ _product((0.0, 1.0, 0.0, 0.0), False)
YAWED = {
    "a quarter turn": (HALF, 0.0, 0.0, HALF),
    "a quarter turn back": (HALF, 0.0, 0.0, -HALF),
    "half a turn": (0.0, 0.0, 0.0, 1.0),
}
# mistake in a base's pose -> (remedy; matrices that undo it: (4, 4) of its quaternion, (3, 3) of its position)
POSES = {
    "with its quaternion as x y z w": (
        "qw to qz are columns of another order; name each",
        np.eye(4)[[3, 0, 1, 2]],
        np.eye(3),
    ),
    "with its place in mm": ('state unit = "mm" for x, y and z', np.eye(4), 1e-3 * np.eye(3)),
    "with its quaternion inverted": ("state sign = -1 for qx, qy and qz", np.diag([1.0, -1.0, -1.0, -1.0]), np.eye(3)),
    "turned from north-east-down to east-north-up": (
        "write place and quaternion east-north-up, with body axes forward-left-up, and name those columns",
        EAST_NORTH_UP,
        np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    ),
    **{
        f"with the markers' axes turned by {turn} about z": (
            "turn the body's axes in the camera's software, and name those columns",
            _product(q, False),
            np.eye(3),
        )
        for turn, q in YAWED.items()
    },
}


def _posed(r: RobotRecord, turn: np.ndarray, move: np.ndarray) -> RobotRecord:
    """The record with linear maps applied to its base's quaternions and positions; angular rates follow from them."""
    rate, growth = r.rates[:, 3:6], r.accelerations[:, 3:6]
    first = quaternion_rate(r.start_turns, rate)
    second = quaternion_rate(first, rate) + quaternion_rate(r.start_turns, growth)
    turns, starts = r.turns @ turn.T, r.start_turns @ turn.T
    place = np.searchsorted(r.starts, r.joint.t, side="right") - 1
    values, angles, rates, accelerations = (a.copy() for a in (r.joint.values, r.angles, r.rates, r.accelerations))
    for part in (values, angles, rates, accelerations):
        part[:, :3] = part[:, :3] @ move.T
    values[:, 3:6] = rotation_vector(turns, starts[place])
    rates[:, 3:6], accelerations[:, 3:6] = (_spin(starts, part @ turn.T) for part in (first, second))
    more = {"angles": angles, "rates": rates, "accelerations": accelerations, "turns": turns, "start_turns": starts}
    return r._replace(joint=r.joint._replace(values=values), **more)


def _spin(q: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """(S, 3) angular rate, rad/s, in the frame of quaternions (S, 4), from their rates (S, 4): inverse of `quaternion_rate`."""
    w, v = q[:, :1], q[:, 1:]
    return 2.0 * (w * rate[:, 1:] - rate[:, :1] * v - np.cross(v, rate[:, 1:]))


def _of_angles(r: RobotRecord, sign: np.ndarray) -> RobotRecord:
    """The record with the angles, rates and accelerations of each joint multiplied by its sign."""
    joint = r.joint._replace(values=r.joint.values * sign)
    return r._replace(joint=joint, angles=r.angles * sign, rates=r.rates * sign, accelerations=r.accelerations * sign)


def _turned(records: list[RobotRecord], zero: np.ndarray) -> list[RobotRecord]:
    return [r._replace(joint=r.joint._replace(values=r.joint.values + zero), angles=r.angles + zero) for r in records]


def _ordered(r: RobotRecord, order: list[int]) -> RobotRecord:
    joint = r.joint._replace(values=r.joint.values[:, order], sigma=r.joint.sigma[order])
    some = {key: getattr(r, key)[..., order] for key in ("angles", "rates", "accelerations", "angle_error", "rate_error")}
    return r._replace(joint=joint, **some)


def _asked(records: list[RobotRecord], a: int, b: int, sign: float) -> list[RobotRecord]:
    """The records with the commands of two actuators exchanged, times a sign."""
    out = []
    for r in records:
        commands = r.commands.copy()
        commands[:, [a, b]] = sign * r.commands[:, [b, a]]
        out.append(r._replace(commands=commands))
    return out


def _error(records: list[RobotRecord], model: RigidRobot | None) -> np.ndarray:
    """(J,) median over segments of the mean square error of a model; with None, of the prediction that nothing moves."""
    if model is not None:
        return _errors(records, model.predict(records, model.null))[0]
    seen = [r.angles[np.searchsorted(r.starts, r.joint.t, side="right") - 1] for r in records]
    return _errors(records, [{"joint": q[None]} for q in seen])[0]


def _errors(measured: list[RobotRecord], seen: list[dict]) -> np.ndarray:
    """(R, J) medians over segments of the mean square errors of predictions (R, K, J)."""
    out = []
    for r, told in zip(measured, seen, strict=True):
        squared = np.nan_to_num((r.joint.values - told["joint"]) ** 2, nan=1e6)
        place = np.searchsorted(r.starts, r.joint.t, side="right") - 1
        out += [squared[:, place == s].mean(1) for s in range(len(r.starts)) if np.any(place == s)]
    return np.median(out, 0)
