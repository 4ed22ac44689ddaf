"""A robot in MuJoCo with every effect of the robots' catalogue at each of its sites.

    row      factors on its constants (mass, inertia, centre of each body; gain; stated friction), then effects:
             `coulomb_friction@elbow`
    segment  starts from the logged state; u(k) is the mean of the logged command over step k; commands hold between stamps
    reading  s q - z of each joint, at its stamp; the cubic through angles and rates of the steps

The mean over a step makes the prediction smooth in a delay. A late reading is a segment that begins as much earlier, so from the
logs alone a delay of the sensors is one of the commands.
"""

import copy
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco import rollout

from fishmj import effects
from fishmj.base.cores import usable_cores
from fishmj.effects.effect import Effect, Parameter
from fishmj.gap.models.kernel import hermite
from fishmj.gap.models.robot_description import RobotDescription
from fishmj.gap.models.swimming_fish import Constant, ParameterRow
from fishmj.gap.records.records import ResidualLayout
from fishmj.gap.records.shooting import RobotRecord, assumed, robot_records
from fishmj.log import Trial

AT = "@"  # between an effect's name and its site's
AT_ONCE = 4096  # rollouts of a batch, for memory's sake
LEAST = 1e-6  # share of the largest torque, inertia or mass of the robot that is none
SHORT = 0.02  # m, least size of a body
AFTERWARDS = 1e6  # s for which the last command holds
USUAL = 90  # percentile over the starts of all segments


class RobotSizes(NamedTuple):
    """Usual size of a torque [N m] and a rate [rad/s] of each joint (J,), and of each actuator's command (A,), from logs."""

    torque: np.ndarray
    rate: np.ndarray
    command: np.ndarray


class PlacedEffect(NamedTuple):
    """An effect of the catalogue at one site. first: place of its first parameter among those of all effects."""

    effect: Effect
    form: effects.RobotForm
    site: str
    first: int


class RigidRobot(ParameterRow):
    """A robot described in MJCF.

    Args: robot: the description. sizes: of its motion, which scale the effects. catalogue: effects; default, all of a robot.
    without: names of effects at their sites that are left out.

    screened_records: number of logs on which the whole catalogue is screened. torque_error: (J,) N m, deviation of the torque at
    each joint that no model explains; as stated, or as measured (search/unexplained_torque.py). reference: (P,) row at which
    `record_errors` are linear.
    """

    screened_records = 2

    def __init__(
        self,
        robot: RobotDescription,
        sizes: RobotSizes,
        catalogue: Sequence[Effect] | None = None,
        without: frozenset[str] = frozenset(),
    ):
        self.robot, self.sizes = robot, sizes
        self.dt = robot.dt
        self.joints = len(robot.joints)
        self._data = [mujoco.MjData(robot.model) for _ in range(usable_cores())]
        self.constants, self._factors = self._tolerances()
        self.placed: list[PlacedEffect] = []
        listed, first = [], 0
        for effect in effects.robot_catalogue().values() if catalogue is None else catalogue:
            if effect.robot is None:
                continue
            for site in robot.sites(effect.robot.site):
                if placed_name(effect.name, site) in without:
                    continue
                listed.append(self._at(effect, effect.robot, site))
                self.placed.append(PlacedEffect(effect, effect.robot, site, first))
                first += len(effect.robot.parameters)
        self.active = effects.EffectStack(listed, self.joints)
        # A semi-implicit step moves by the rate at its end, so its rates are those of half a step earlier.
        semi_implicit = robot.model.opt.integrator != int(mujoco.mjtIntegrator.mjINT_RK4)
        self._early = 0.5 * self.dt if semi_implicit else 0.0
        self.torque_error = self.torque_tolerance
        self.reference = self.nothing

    @property
    def torque_tolerance(self) -> np.ndarray:
        """(J,) N m, `torque_error` as stated."""
        return assumed("tolerance")["torque"] * self.sizes.torque

    def with_errors(self, torque: np.ndarray, reference: np.ndarray) -> "RigidRobot":
        """The same robot with another `torque_error` and `reference`."""
        there = copy.copy(self)
        there.torque_error, there.reference = torque, reference
        return there

    def records(self, trials: Sequence[Trial]) -> list[RobotRecord]:
        """The logs, ready to be predicted. Raises LogError."""
        return robot_records(trials, self.dt, self.robot.sites("joint"))

    # --------------------------------------------------------------------------------------------------------------- parameters
    def _tolerances(self) -> tuple[tuple[Constant, ...], list]:
        """The constants, and the function of each that multiplies the fields of a model by a factor."""
        m, tolerance, found = self.robot.model, assumed("tolerance"), []

        def scaled(name: str, index: Any):
            def multiply(model, factor: float) -> None:
                getattr(model, name)[index] *= factor

            return multiply

        def mass(body: int):
            def multiply(model, factor: float) -> None:
                model.body_mass[body] *= factor
                model.body_inertia[body] *= factor

            return multiply

        for name, b in self.robot.bodies.items():
            found.append((Constant(f"mass{AT}{name}", tolerance["mass"]), mass(b)))
            found.append((Constant(f"inertia{AT}{name}", tolerance["inertia"]), scaled("body_inertia", b)))
            found.append((Constant(f"centre{AT}{name}", tolerance["centre"]), scaled("body_ipos", b)))
        for j in self.robot.joints:
            if j.actuator >= 0:
                found.append((Constant(f"gain{AT}{j.name}", tolerance["gain"]), scaled("actuator_gainprm", (j.actuator, 0))))
            for field in ("dof_frictionloss", "dof_damping"):
                if getattr(m, field)[j.dof] > 0:
                    found.append((Constant(f"{field[4:]}{AT}{j.name}", tolerance["friction"]), scaled(field, j.dof)))
        return tuple(constant for constant, _ in found), [function for _, function in found]

    def _at(self, effect: Effect, form: effects.RobotForm, site: str) -> Effect:
        """The effect at one site, its sizes in SI."""
        name = placed_name(effect.name, site)
        scale = self._scale(form, site)
        sized = tuple(_scaled(p, scale) for p in form.parameters)
        others = [(c, other.robot) for c in form.confusions if (other := effects.robot_catalogue().get(c.other)) and other.robot]
        confused = tuple(
            replace(c, other=placed_name(c.other, at))
            for c, other in others
            for at in ((site,) if site in self.robot.sites(other.site) else self.robot.sites(other.site))
        )
        bare: dict[str, Any] = dict.fromkeys(("servo", "gear", "fish", "flow", "body", "water", "command", "measure"))
        placed = form._replace(parameters=sized)
        return replace(
            effect, name=name, parameters=sized, shows=(), memory=(), handed=(), confusions=confused, robot=placed, **bare
        )

    def _scale(self, form: effects.RobotForm, site: str) -> float:
        """Size of an effect's unit at a site."""
        m = self.robot.model
        if not form.scale:
            return 1.0
        if form.scale in ("mass", "length"):
            b = self.robot.bodies[site]
            return float(m.body_mass[b]) if form.scale == "mass" else max(float(np.linalg.norm(m.body_ipos[b])), SHORT)
        i = self.robot.sites("joint").index(site)
        torque = float(np.maximum(self.sizes.torque, LEAST * max(self.sizes.torque.max(), LEAST))[i])
        rate = max(float(self.sizes.rate[i]), LEAST)
        if form.scale == "command":
            return max(float(self.sizes.command[self.robot.joints[i].actuator]), LEAST)
        if form.scale in ("damping", "drag"):
            return torque / rate if form.scale == "damping" else torque / rate**2
        return float(m.dof_M0[self.robot.joints[i].dof]) if form.scale == "inertia" else torque

    def model(self, row: np.ndarray) -> Any:
        """A MjModel with the constants and effects of one parameter row (P,), delays and readings aside."""
        m = copy.copy(self.robot.model)
        for factor, multiply in zip(row, self._factors, strict=False):
            if factor != 1.0:
                multiply(m, float(factor))
        for placed, p in self._present(row):
            if placed.form.fields is not None:
                placed.form.fields(self.robot.site(m, placed.form.site, placed.site), p)
        mujoco.mj_setConst(m, self._data[0])
        return m

    def _present(self, row: np.ndarray):
        """(placed effect, its parameters) of those that are not at their null."""
        values = np.asarray(row)[len(self.constants) :]
        for placed in self.placed:
            mine = values[placed.first : placed.first + len(placed.form.parameters)]
            if tuple(mine) != tuple(p.null for p in placed.form.parameters):
                yield placed, SimpleNamespace(**{p.name: float(v) for p, v in zip(placed.form.parameters, mine, strict=True)})

    def delay(self, row: np.ndarray, t: Any = 0.0) -> Any:
        """Delay of commands and readings together at times t of a record, s."""
        parameters = list(np.asarray(row)[len(self.constants) :])
        return self.active.delay(np, parameters, "command", t) + self.active.delay(np, parameters, "joint", t)

    def inert(self, records: Sequence[RobotRecord]) -> frozenset[str]:
        """Names of the effects that at their usual size change no reading of the records beyond its noise."""
        rows, owners = [], []
        for effect in self.active.effects:
            for p in effect.parameters:
                for value in (p.typical[1], 2.0 * p.null - p.typical[1])[: 1 + p.signed]:
                    row = self.nothing
                    row[self.index(effect.name, p.name)] = np.clip(value, p.low, p.high)
                    rows.append(row)
                    owners.append(effect.name)
        shown = set()
        for record in records:
            (told,) = self.predict([record], np.stack([self.nothing, *rows]))
            change = np.abs(np.nan_to_num(told["joint"][1:] - told["joint"][:1], nan=np.inf)).max(1)
            shown |= {name for name, moved in zip(owners, change, strict=True) if np.any(moved > record.joint.sigma)}
        return frozenset(owners) - shown

    def _reading(self, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(J,) scale and zero of the joints' encoders."""
        scale, zero = np.ones(self.joints), np.zeros(self.joints)
        names = self.robot.sites("joint")
        for placed, p in self._present(row):
            if placed.form.reading is not None:
                factor, offset = placed.form.reading(p)
                scale[names.index(placed.site)] *= factor
                zero[names.index(placed.site)] += offset
        return scale, zero

    # --------------------------------------------------------------------------------------------------------------- prediction
    def predict(self, records: list[RobotRecord], rows) -> list[dict]:
        """Predicted readings of every parameter row (R, P) on every record: {"joint": (R, K, J)} at its stamps."""
        rows = np.atleast_2d(np.asarray(rows, float))
        models = [self.model(row) for row in rows]
        return [{"joint": self._shoot(record, rows, models)} for record in records]

    def _shoot(self, record: RobotRecord, rows: np.ndarray, models: list, moved=None, pushed=None) -> np.ndarray:
        """(R, K, J) readings.

        moved: (R, 2, J) added to angles and rates at each start. pushed: (R, T, J) torques on the joints.
        """
        places = [j.place for j in self.robot.joints]
        dofs = [j.dof for j in self.robot.joints]
        segments, steps = len(record.starts), self.steps(record)
        read = [self._reading(row) for row in rows]
        scale, zero = (np.stack(part)[:, None] for part in zip(*read, strict=True))
        still = np.zeros((len(rows), 2, self.joints)) if moved is None else moved
        angle = (record.angles + zero + still[:, :1]) / scale
        rate = (record.rates - self._early * record.accelerations + still[:, 1:]) / scale
        m = self.robot.model
        start = np.zeros((len(rows), segments, 1 + m.nq + m.nv))
        start[..., [1 + p for p in places]] = angle
        start[..., [1 + m.nq + d for d in dofs]] = rate
        known: dict[tuple, np.ndarray] = {}
        out = np.empty((len(rows), len(record.joint.t), self.joints))
        first = np.searchsorted(record.joint.t, record.starts)
        ends = np.append(first[1:], len(record.joint.t))
        few = max(1, AT_ONCE // segments)
        for begin in range(0, len(rows), few):
            some = range(begin, min(begin + few, len(rows)))
            control = []
            for r in some:
                acts = tuple((placed.first, values) for placed, values in self._on_commands(rows[r]))
                key = (*np.broadcast_to(self.delay(rows[r], np.array([0.0, 1.0])), 2).tolist(), acts)
                if key not in known:
                    known[key] = self._commands(record, steps, rows[r])
                control.append(known[key])
            u = np.concatenate(control)
            spec = int(mujoco.mjtState.mjSTATE_CTRL)
            if pushed is not None:
                force = np.zeros((len(u), steps, m.nv))
                force[..., dofs] = np.repeat(pushed[some.start : some.stop], segments, 0)
                u, spec = np.concatenate([u, force], 2), spec | int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)
            batch = [models[r] for r in some for _ in range(segments)]
            begins = start[some.start : some.stop].reshape(len(batch), -1)
            state, _ = rollout.rollout(batch, self._data, begins, u, control_spec=spec)
            state = np.concatenate([begins[:, None], state], 1).reshape(len(some), segments, steps + 1, -1)
            q, v = state[..., [1 + p for p in places]], state[..., [1 + m.nq + d for d in dofs]]
            for k, (a, b) in enumerate(zip(first, ends, strict=True)):
                at = np.broadcast_to(record.joint.t[a:b] - record.starts[k], (len(some), b - a))
                sampled = hermite(np.ascontiguousarray(q[:, k]), np.ascontiguousarray(v[:, k]), self.dt, np.ascontiguousarray(at))
                out[some.start : some.stop, a:b] = sampled
        return scale * out - zero

    def steps(self, record: RobotRecord) -> int:
        """Number of steps of a segment."""
        return int(np.ceil(record.length / self.dt - 1e-9)) + 1

    def _on_commands(self, row: np.ndarray):
        """(placed effect, its parameters as a tuple) of the effects that change commands."""
        for placed, p in self._present(row):
            if placed.form.command is not None:
                yield placed, tuple(vars(p).items())

    def _commands(self, record: RobotRecord, steps: int, row: np.ndarray) -> np.ndarray:
        """(S, T, A) mean of each command over each step, after the delay of a row."""
        t = record.starts[:, None] + self.dt * np.arange(steps + 1)
        t = t - self.delay(row, record.starts[:, None])
        changes = list(self._on_commands(row))
        out = np.empty((len(record.starts), steps, record.commands.shape[1]))
        for a in range(out.shape[2]):
            sent, asked = record.sent, record.commands[:, a]
            mine = next((j.name for j in self.robot.joints if j.actuator == a), "")
            for placed, values in changes:
                if placed.site in ("", mine) and placed.form.command is not None:
                    sent, asked = placed.form.command(SimpleNamespace(**dict(values)), sent, asked)
            edges = np.append(sent, sent[-1] + AFTERWARDS)
            whole = np.concatenate([[0.0], np.cumsum(asked * np.diff(edges))])
            own = t - self.robot.delays[a]
            summed = np.interp(own, edges, whole) + np.minimum(own - edges[0], 0.0) * asked[0]
            out[..., a] = np.diff(summed, axis=1) / self.dt
        return out

    # --------------------------------------------------------------------------------------------------------- errors of a record
    def record_errors(self, records: list[RobotRecord], layout: ResidualLayout) -> tuple[np.ndarray, ...]:
        """Response (K, m_l) of each record to the error of each start, and to a torque at each joint that no model explains.

        The torque is the sum of hats every `spacing` s; each hat at each joint has a deviation of its own. Rows are in the order
        of `error_groups`: segment by segment.
        """
        out = []
        for i, record in enumerate(records):
            steps = self.steps(record)
            hats = self._hats(record)
            begin, push = 2 * self.joints, self.joints * len(hats)
            moved = np.zeros((1 + begin + push, 2, self.joints))
            pushed = np.zeros((1 + begin + push, steps, self.joints))
            for j in range(self.joints):
                moved[1 + j, 0, j] = record.angle_error[j]
                moved[1 + self.joints + j, 1, j] = record.rate_error[j]
                for h, hat in enumerate(hats):
                    pushed[1 + begin + j * len(hats) + h, :, j] = self.torque_error[j] * hat
            rows = np.tile(self.reference, (len(moved), 1))
            seen = self._shoot(record, rows, [self.model(self.reference)] * len(rows), moved, pushed)
            change = -ResidualLayout([record]).residuals([{"joint": seen}])
            change = np.nan_to_num(change[1:] - change[0])
            mine = [b for b in layout.blocks if b.record == i]
            place = np.concatenate([np.searchsorted(record.starts, b.t, side="right") - 1 for b in mine])
            out.append(np.concatenate([change * (place == s) for s in range(len(record.starts))]))
        return tuple(out)

    def error_groups(self, record: RobotRecord) -> np.ndarray:
        """(K,) number of the joint whose torque each row of `record_errors` is of; that of joints for an error of a start."""
        torques = np.repeat(np.arange(self.joints), len(self._hats(record)))
        return np.tile([*[self.joints] * (2 * self.joints), *torques], len(record.starts))

    def _hats(self, record: RobotRecord) -> list[np.ndarray]:
        """Hat functions (T,) over the steps of a segment."""
        t, spacing = self.dt * np.arange(self.steps(record)), assumed("tolerance")["spacing"]
        return [np.maximum(0.0, 1.0 - np.abs(t - at) / spacing) for at in np.arange(0.0, t[-1], spacing)]

    @cached_property
    def fingerprint(self) -> str:
        """Text of the description."""
        return self.robot.spec.to_xml()


def sizes_of(robot: RobotDescription, records: Sequence[RobotRecord]) -> RobotSizes:
    """Usual torques and rates at the starts of all segments.

    A torque is the larger of what the motion needs, by the model's inverse dynamics, and what the actuators give for the commands
    there: a light leg with much friction needs little and is given much.
    """
    m, d = robot.model, mujoco.MjData(robot.model)
    places, dofs = [j.place for j in robot.joints], [j.dof for j in robot.joints]
    needed, given, rate = [], [], []
    command = np.stack([np.percentile(np.abs(r.commands - r.commands.mean(0)), USUAL, axis=0) for r in records]).mean(0)
    for record in records:
        held = np.maximum(np.searchsorted(record.sent, record.starts, side="right") - 1, 0)
        for q, v, a, u in zip(record.angles, record.rates, record.accelerations, record.commands[held], strict=True):
            d.qpos[places], d.qvel[dofs], d.qacc[dofs], d.ctrl[:] = q, v, a, u
            mujoco.mj_inverse(m, d)
            needed.append(np.abs(d.qfrc_inverse[dofs]))
            mujoco.mj_fwdActuation(m, d)
            given.append(np.abs(d.qfrc_actuator[dofs]))
            rate.append(np.abs(v))
    torque, driven, usual = (np.percentile(part, USUAL, axis=0) for part in (needed, given, rate))
    return RobotSizes(np.maximum(torque, driven), usual, command)


def _scaled(p: Parameter, scale: float) -> Parameter:
    """The parameter with null, bounds and typical sizes times `scale`."""
    typical = (scale * p.typical[0], scale * p.typical[1])
    return replace(p, null=scale * p.null, low=scale * p.low, high=scale * p.high, typical=typical)


def placed_name(effect: str, site: str) -> str:
    """Name of an effect at a site."""
    return effect + (AT + site if site else "")
