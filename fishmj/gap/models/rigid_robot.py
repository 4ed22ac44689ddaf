"""A robot in MuJoCo with every effect of the robots' catalogue at each of its sites.

    row      factors on its constants (mass, inertia, centre of each body; gain; stated friction), then effects:
             `coulomb_friction@elbow`
    segment  starts from the logged state; u(k) is the mean of the logged command over step k; commands hold between stamps
    reading  s q - z of each joint at its stamps, from a cubic through the angles and rates of the steps
    base     if it floats: its position, and the rotation vector from its measured attitude

J counts channels: the coordinates of a free base (records/attitude.py), then hinges and slides.
The mean over a step makes the prediction smooth in a delay. A late reading is equivalent to an earlier start of the segment, so
the logs alone cannot distinguish a delay of the sensors from one of the commands.
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
from fishmj.effects.effect import AT, Effect, Parameter
from fishmj.gap.models import joint_laws
from fishmj.gap.models.kernel import hermite
from fishmj.gap.models.robot_description import RobotDescription
from fishmj.gap.models.robot_kernel import RobotKernel, can_roll
from fishmj.gap.models.robot_scatter import DRAWS, scatter_of
from fishmj.gap.models.robot_sizes import RobotSizes
from fishmj.gap.models.swimming_fish import Constant, ParameterRow
from fishmj.gap.records.records import ResidualLayout
from fishmj.gap.records.shooting import RobotRecord, assumed, robot_records
from fishmj.log import Trial

FINE = 0.125  # reference step over the description's, whose error of some mrad in 0.3 s is ten times an encoder's noise
AT_ONCE = 4096  # rollouts per batch, to limit memory
REST = 2.0  # stall torque, in units of the usual torque, of an actuator without a stated limit
LEAST = 1e-6  # share of the robot's largest torque, inertia or mass that counts as zero
SHORT = 0.02  # m, least size of a body
SAME_AT_CENTRE = ("payload",)  # equals a heavier body if the centre of mass is at the frame's origin
AFTERWARDS = 1e6  # s for which the last command holds
KEPT = 64  # cached sets of commands, and of defects


class PlacedEffect(NamedTuple):
    """An effect of the catalogue at one site. first: place of its first parameter among those of all effects."""

    effect: Effect
    form: effects.RobotForm
    site: str
    first: int


class PresentEffect(NamedTuple):
    """An effect that is not at its null in a row. p: parameters by name. draw: number of a random draw; 0: the mean."""

    placed: PlacedEffect
    p: SimpleNamespace
    draw: int = 0


class RigidRobot(ParameterRow):
    """A robot described in MJCF.

    Args: robot: the description. sizes: of its motion, which scale the effects. catalogue: effects; default, all of a robot.
    without: names of effects at their sites that are left out. stride: steps of the description per step of the search. The
    discretisation error, known for the description from a step `FINE` times as long, is subtracted from all predictions
    (search_step.py).

    screened_records: number of logs on which the whole catalogue is screened. torque_error: (J,) N m, standard deviation of the
    unexplained torque at each joint; as stated, or as measured (search/unexplained_torque.py). reference: (P,) row at which
    `record_errors` are linear.
    """

    screened_records = 2

    def __init__(
        self,
        robot: RobotDescription,
        sizes: RobotSizes,
        catalogue: Sequence[Effect] | None = None,
        without: frozenset[str] = frozenset(),
        stride: float = 1,
    ):
        self.robot, self.sizes = robot, sizes
        self.dt = stride * robot.dt
        self._plain = copy.copy(robot.model)
        self._plain.opt.timestep = self.dt
        self._kernel = RobotKernel(self._plain) if can_roll(self._plain) else None
        self._exact = RigidRobot(robot, sizes, (), stride=FINE) if stride >= 1 else None
        self._defects: dict[int, np.ndarray] = {}
        self.joints = len(robot.channels)
        self._data = [mujoco.MjData(robot.model) for _ in range(usable_cores())]
        self.constants, self._factors = self._tolerances()
        self.placed: list[PlacedEffect] = []
        listed, first = [], 0
        for effect in effects.robot_catalogue().values() if catalogue is None else catalogue:
            if effect.robot is None:
                continue
            for site in robot.sites(effect.robot.site):
                if placed_name(effect.name, site) in without or (effect.robot.law and not robot.takes_laws(site)):
                    continue
                if effect.name in SAME_AT_CENTRE and robot.is_centred(site):
                    continue
                listed.append(self._at(effect, effect.robot, site))
                self.placed.append(PlacedEffect(effect, effect.robot, site, first))
                first += len(effect.robot.parameters)
        self.active = effects.EffectStack(listed, self.joints)
        self._owner = np.repeat(np.arange(len(listed)), [len(effect.parameters) for effect in listed])
        self._sent: dict[tuple, np.ndarray] = {}
        # A semi-implicit step moves by the rate at its end, so its rates belong to half a step earlier.
        semi_implicit = robot.model.opt.integrator != int(mujoco.mjtIntegrator.mjINT_RK4)
        self._early = 0.5 * self.dt if semi_implicit else 0.0
        self.torque_error = self.torque_tolerance
        self.reference = self.nothing

    @property
    def torque_tolerance(self) -> np.ndarray:
        """(J,) N m, `torque_error` as stated."""
        return assumed("tolerance")["torque"] * self.sizes.torque

    @property
    def rest(self) -> list[float]:
        """Assumed stall torque of each joint's actuator if the description states none, N m."""
        return [REST * self._usual_torque(name) for name in self.robot.sites("joint")]

    def with_errors(self, torque: np.ndarray, reference: np.ndarray) -> "RigidRobot":
        """The same robot with another `torque_error` and `reference`."""
        there = copy.copy(self)
        there.torque_error, there.reference = torque, reference
        return there

    def records(self, trials: Sequence[Trial]) -> list[RobotRecord]:
        """The logs, ready to be predicted. Raises LogError."""
        return robot_records(trials, self.dt, self.robot.channels)

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

        def gain(actuator: int):
            def multiply(model, factor: float) -> None:
                model.actuator_gainprm[actuator, 0] *= factor
                model.actuator_biasprm[actuator, 1:3] *= factor  # of a position servo: k_p and k_v alike, not its target

            return multiply

        for name, b in self.robot.bodies.items():
            found.append((Constant(f"mass{AT}{name}", tolerance["mass"]), mass(b)))
            found.append((Constant(f"inertia{AT}{name}", tolerance["inertia"]), scaled("body_inertia", b)))
            found.append((Constant(f"centre{AT}{name}", tolerance["centre"]), scaled("body_ipos", b)))
        for name, a in self.robot.thrusters.items():
            found.append((Constant(f"gain{AT}{name}", tolerance["gain"]), gain(a)))
        for j in self.robot.joints:
            if j.actuator >= 0:
                found.append((Constant(f"gain{AT}{j.name}", tolerance["gain"]), gain(j.actuator)))
                if m.actuator_biasprm[j.actuator, 2] != 0.0:
                    own = scaled("actuator_biasprm", (j.actuator, 2))
                    found.append((Constant(f"damping_gain{AT}{j.name}", tolerance["gain"]), own))
            for field in ("dof_frictionloss", "dof_damping"):
                if getattr(m, field)[j.dof] > 0:
                    found.append((Constant(f"{field[4:]}{AT}{j.name}", tolerance["friction"]), scaled(field, j.dof)))
        return tuple(constant for constant, _ in found), [function for _, function in found]

    def _at(self, effect: Effect, form: effects.RobotForm, site: str) -> Effect:
        """The effect at one site, its sizes in SI."""
        name = placed_name(effect.name, site)
        units = form.scale if isinstance(form.scale, tuple) else (form.scale,) * len(form.parameters)
        sized = tuple(_scaled(p, self._scale(unit, form.site, site)) for p, unit in zip(form.parameters, units, strict=True))
        others = [(c, other.robot) for c in form.confusions if (other := effects.robot_catalogue().get(c.other)) and other.robot]
        confused = tuple(
            replace(c, other=placed_name(c.other, at))
            for c, other in others
            for at in ((site,) if site in self.robot.sites(other.site) else self.robot.sites(other.site))
        )
        bare: dict[str, Any] = dict.fromkeys(("servo", "gear", "fish", "flow", "body", "water", "command", "measure"))
        placed = form._replace(parameters=sized)
        bare |= dict.fromkeys(("shows", "memory", "handed"), ()) | {"stream": ""}
        return replace(effect, name=name, parameters=sized, confusions=confused, robot=placed, **bare)

    def _scale(self, unit: str, kind: str, site: str) -> float:
        """Size of a unit at a site of a kind."""
        m = self.robot.model
        if not unit:
            return 1.0
        if unit in ("mass", "length"):
            b = self.robot.bodies[site]
            return float(m.body_mass[b]) if unit == "mass" else max(float(np.linalg.norm(m.body_ipos[b])), SHORT)
        if kind == "actuator" and site in self.robot.thrusters:
            size = self.sizes.command if unit == "command" else self.sizes.force
            return max(float(size[self.robot.thrusters[site]]), LEAST)
        i = self.robot.channels.index(site)
        joint = self.robot.joints[self.robot.sites("joint").index(site)]
        torque, rate = self._usual_torque(site), max(float(self.sizes.rate[i]), LEAST)
        if unit == "command":
            return max(float(self.sizes.command[joint.actuator]), LEAST)
        inertia = float(m.dof_M0[joint.dof])
        sizes = {"torque": torque, "rate": rate, "inertia": inertia, "time": 1.0 / rate, "stiffness": torque}
        return (sizes | {"damping": torque / rate, "drag": torque / rate**2})[unit]

    def _usual_torque(self, joint: str) -> float:
        """Usual torque of a joint, or at least a small share of the robot's, N m."""
        usual = np.maximum(self.sizes.torque, LEAST * max(self.sizes.torque.max(), LEAST))
        return float(usual[self.robot.channels.index(joint)])

    def model(self, row: np.ndarray) -> Any:
        """MjModel with the constants and effects of one parameter row (P,), except for delays and readings."""
        return self._model(np.asarray(row, float), self._present(row))

    def _model(self, row: np.ndarray, present: list[PresentEffect]) -> Any:
        factors = [(float(factor), multiply) for factor, multiply in zip(row, self._factors, strict=False) if factor != 1.0]
        acting = [x for x in present if x.placed.form.fields is not None or x.placed.form.law is not None]
        if not factors and not acting:
            return self._plain
        m = copy.copy(self._plain)
        for factor, multiply in factors:
            multiply(m, factor)
        laws: dict[str, dict[str, tuple[float, ...]]] = {}
        for placed, p, _ in acting:
            if placed.form.fields is not None:
                placed.form.fields(self.robot.site(m, placed.form.site, placed.site), p)
            if placed.form.law is not None:
                laws.setdefault(placed.site, {})[placed.effect.name] = tuple(vars(p).values())
        mujoco.mj_setConst(m, self._data[0])
        if laws:
            joint_laws.write(m, self.robot.joints, laws, self.rest)
        return m

    def _present(self, row: np.ndarray) -> list[PresentEffect]:
        """The effects that are not at their null."""
        values = np.asarray(row, float)[len(self.constants) :]
        out = []
        for i in np.unique(self._owner[values != self.active.null]):
            placed = self.placed[i]
            mine = values[placed.first : placed.first + len(placed.form.parameters)].tolist()
            p = SimpleNamespace(**dict(zip((p.name for p in placed.form.parameters), mine, strict=True)))
            out.append(PresentEffect(placed, p))
        return out

    def delay(self, row: np.ndarray, t: Any = 0.0) -> Any:
        """Delay of commands and readings together at times t of a record, s."""
        fixed, drift = _delay(self._present(row))
        return fixed + drift * np.asarray(t)

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
        tried, names = np.array(rows), np.array(owners)
        for record in records:
            if len(tried):
                (told,) = self.predict([record], np.concatenate([self.nothing[None], tried]))
                change = np.abs(np.nan_to_num(told["joint"][1:] - told["joint"][:1], nan=np.inf)).max(1)
                hidden = ~np.isin(names, names[np.any(change > record.joint.sigma, axis=1)])
                tried, names = tried[hidden], names[hidden]
        return frozenset(names.tolist())

    def _reading(self, present: list[PresentEffect]) -> tuple[np.ndarray, np.ndarray]:
        """(J,) scale and zero of the joints' encoders."""
        scale, zero = np.ones(self.joints), np.zeros(self.joints)
        names = self.robot.channels
        for placed, p, _ in present:
            if placed.form.reading is not None:
                factor, offset = placed.form.reading(p)
                scale[names.index(placed.site)] *= factor
                zero[names.index(placed.site)] += offset
        return scale, zero

    # --------------------------------------------------------------------------------------------------------------- prediction
    def predict(self, records: list[RobotRecord], rows) -> list[dict]:
        """Predicted readings of every parameter row (R, P) on every record: {"joint": (R, K, J)} at its stamps."""
        rows = np.atleast_2d(np.asarray(rows, float))
        present = [self._present(row) for row in rows]
        models = [self._model(row, there) for row, there in zip(rows, present, strict=True)]
        seen = self._shoot(records, present, models)
        return [{"joint": one + self._defect(record)} for record, one in zip(records, seen, strict=True)]

    def _defect(self, record: RobotRecord) -> np.ndarray | float:
        """(K, J) discretisation correction: readings of the description at a fine step minus those at the step of the search."""
        if self._exact is None:
            return 0.0
        mark = record.mark
        if mark not in self._defects:
            exact = self._exact.predict([record], self._exact.nothing)[0]["joint"][0]
            _keep(self._defects, mark, exact - self._shoot([record], [[]], [self._plain])[0][0])
        return self._defects[mark]

    def _shoot(
        self, records: list[RobotRecord], present: list[list[PresentEffect]], models: list, moved=None, pushed=None
    ) -> list[np.ndarray]:
        """(R, K, J) readings of each record, for the effects and the model of each of R rows.

        moved: (R, 2, J) added to angles and rates at each start. pushed: (R, T, J) torques on the joints.
        """
        rows, counts = len(models), [len(record.starts) for record in records]
        segments, steps = sum(counts), max(self.steps(record) for record in records)
        scale, zero = (np.stack(part)[:, None] for part in zip(*map(self._reading, present), strict=True))
        still = np.zeros((rows, 2, self.joints)) if moved is None else moved
        every = lambda field: np.concatenate([getattr(record, field) for record in records])
        angle = (every("angles") + zero + still[:, :1]) / scale
        rate = (every("rates") - self._early * every("accelerations") + still[:, 1:]) / scale
        m = self.robot.model
        dofs = self.robot.dofs
        start = np.zeros((rows, segments, 1 + m.nq + m.nv))
        start[..., 1 : 1 + m.nq] = self.robot.qpos(angle, every("start_turns"))
        start[..., [1 + m.nq + d for d in dofs]] = rate
        out, marks = (
            [np.empty((rows, len(record.joint.t), self.joints)) for record in records],
            [record.mark for record in records],
        )
        lawful = any(x.placed.form.law is not None for there in present for x in there)
        few = max(1, AT_ONCE // segments)
        for begin in range(0, rows, few):
            some = slice(begin, min(begin + few, rows))
            sent = [self._commands(*one, steps, there) for there in present[some] for one in zip(records, marks, strict=True)]
            u = np.concatenate(sent)
            force = None
            if pushed is not None:
                force = np.zeros((len(u), steps, m.nv))
                force[..., dofs] = np.repeat(pushed[some], segments, 0)
            begins = np.ascontiguousarray(start[some].reshape(len(u), -1))
            state = self._rolled(models[some], begins, u, force, lawful)
            state = np.concatenate([begins[:, None], state], 1).reshape(-1, segments, steps + 1, begins.shape[1])
            q, v = self.robot.motion(state)
            first = 0
            for record, seen in zip(records, out, strict=True):
                edges = [*np.searchsorted(record.joint.t, record.starts), len(record.joint.t)]
                for k, (a, b) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
                    at = np.broadcast_to(record.joint.t[a:b] - record.starts[k], (len(q), b - a))
                    angles, rates = (np.ascontiguousarray(part[:, first + k]) for part in (q, v))
                    told = hermite(angles, rates, self.dt, np.ascontiguousarray(at))
                    seen[some, a:b] = record.beside(told, slice(a, b))
                first += len(record.starts)
        return [scale * seen - zero for seen in out]

    def _rolled(self, models: list, begins: np.ndarray, u: np.ndarray, force: np.ndarray | None, lawful: bool) -> np.ndarray:
        """(N, T, S) states of rollouts from `begins` (N, S) under u (N, T, A), as many of each model, and torques (N, T, J)."""
        which = np.repeat(np.arange(len(models)), len(begins) // len(models))
        if self._kernel is None:
            return self._stepped([models[k] for k in which], begins, u, force, lawful)
        state, known = self._kernel(models, which, begins, u, force)
        if not known.all():
            left = np.flatnonzero(~known)
            some = None if force is None else force[left]
            state[left] = self._stepped([models[k] for k in which[left]], begins[left], u[left], some, lawful)
        return state

    def _stepped(self, models: list, begins: np.ndarray, u: np.ndarray, force: np.ndarray | None, lawful: bool) -> np.ndarray:
        """The same by MuJoCo itself, a model for each."""
        spec = int(mujoco.mjtState.mjSTATE_CTRL)
        if force is not None:
            u, spec = np.concatenate([u, force], 2), spec | int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)
        state, sensors = np.empty((*u.shape[:2], begins.shape[1])), np.empty((*u.shape[:2], self.robot.model.nsensordata))
        given = {"control_spec": spec, "skip_checks": True, "nstep": u.shape[1], "state": state, "sensordata": sensors}
        many = len(self._data) if len(self._data) > 1 else 0
        with rollout.Rollout(nthread=many) as pool, joint_laws.acting(lawful), joint_laws.no_warnings():
            pool.rollout(models, self._data, begins, np.ascontiguousarray(u), **given)
        return state

    def steps(self, record: RobotRecord) -> int:
        """Number of steps of a segment."""
        return int(np.ceil(record.length / self.dt - 1e-9)) + 1

    def _commands(self, record: RobotRecord, mark: int, steps: int, present: list[PresentEffect]) -> np.ndarray:
        """(S, T, A) mean of each command over each step, after the delays; kept for the last few."""
        changes = [x for x in present if x.placed.form.command is not None]
        fixed, drift = _delay(present)
        acts = tuple((x.placed.first, x.draw, *vars(x.p).values()) for x in changes)
        key = (mark, steps, fixed, drift, acts)
        if key not in self._sent:
            _keep(self._sent, key, self._mean_commands(record, steps, changes, fixed + drift * record.starts[:, None]))
        return self._sent[key]

    def _mean_commands(self, record: RobotRecord, steps: int, changes: list[PresentEffect], delay: np.ndarray) -> np.ndarray:
        t = record.starts[:, None] + self.dt * np.arange(steps + 1) - delay
        out = np.empty((len(record.starts), steps, record.commands.shape[1]))
        for a in range(out.shape[2]):
            sent, asked = record.sent, record.commands[:, a]
            mine = self.robot.site_of(a)
            for placed, p, draw in changes:
                apart = placed.form.site == "thrusters" and mine not in self.robot.thrusters
                if placed.site not in ("", mine) or apart:
                    continue
                if draw and placed.form.scatter is not None:  # a packet has the commands of all actuators, so one seed for all
                    sent, asked = placed.form.scatter(np.random.default_rng(draw), p, sent, asked)
                elif placed.form.command is not None:
                    sent, asked = placed.form.command(p, sent, asked)
            edges = np.append(sent, sent[-1] + AFTERWARDS)
            whole = np.concatenate([[0.0], np.cumsum(asked * np.diff(edges))])
            own = t - self.robot.delays[a] - self._early  # the force at t_k changes the rate over half a step on either side
            summed = np.interp(own, edges, whole) + np.minimum(own - edges[0], 0.0) * asked[0]
            out[..., a] = np.diff(summed, axis=1) / self.dt
        return out

    # --------------------------------------------------------------------------------------------------------- errors of a record
    def record_errors(self, records: list[RobotRecord], layout: ResidualLayout) -> tuple[np.ndarray, ...]:
        """Response (K, m_l) of each record to the error of each start, and to an unexplained torque at each joint.

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
            there = self._present(self.reference)
            (seen,) = self._shoot([record], [there] * len(moved), [self.model(self.reference)] * len(moved), moved, pushed)
            change = -ResidualLayout([record]).residuals([{"joint": seen}])
            change = np.nan_to_num(change[1:] - change[0])
            mine = [b for b in layout.blocks if b.record == i]
            place = np.concatenate([np.searchsorted(record.starts, b.t, side="right") - 1 for b in mine])
            out.append(np.concatenate([change * (place == s) for s in range(len(record.starts))]))
        return tuple(out)

    def scatter(self, records: list[RobotRecord], layout: ResidualLayout, row: np.ndarray, keep=None) -> tuple[np.ndarray, ...]:
        """Covariance factors (K, m_l) of each record from random commands (RobotForm.scatter); () without such effects.

        keep: (L,) bool, records to compute; the others get none.
        """
        present = self._present(row)
        if not any(x.placed.form.scatter is not None for x in present):
            return ()
        there = [[x._replace(draw=k) for x in present] for k in range(DRAWS + 1)]
        models = [self._model(np.asarray(row, float), present)] * len(there)
        asked = range(len(records)) if keep is None else np.flatnonzero(keep).tolist()
        return scatter_of(layout, dict(zip(asked, self._shoot([records[i] for i in asked], there, models), strict=True)))

    def error_groups(self, record: RobotRecord) -> np.ndarray:
        """(K,) joint of the torque in each row of `record_errors`; the number of joints for the error of a start."""
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


def _keep(kept: dict, key: Any, value: np.ndarray) -> None:
    """Puts a value among the last `KEPT`."""
    while len(kept) >= KEPT:
        kept.pop(next(iter(kept)))
    kept[key] = value


def _delay(present: list[PresentEffect]) -> tuple[float, float]:
    """Delay of commands and readings together at the begin of a record [s], and its growth [s/s]."""
    fixed = sum(getattr(x.p, name) for x in present for name in x.placed.effect.delays.values())
    return fixed, sum(getattr(x.p, name) - 1.0 for x in present for name in x.placed.effect.drifts.values())


def _scaled(p: Parameter, scale: float) -> Parameter:
    """The parameter with null, bounds and typical sizes times `scale`."""
    typical = (scale * p.typical[0], scale * p.typical[1])
    return replace(p, null=scale * p.null, low=scale * p.low, high=scale * p.high, typical=typical)


def placed_name(effect: str, site: str) -> str:
    """Name of an effect at a site."""
    return effect + (AT + site if site else "")
