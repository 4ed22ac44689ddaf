"""The flow solver as an engine: one tank of water for each fish, all tanks side by side.

`advance` has the common interface, so every controller runs in the solver unchanged. Unlike other engines, this one has state:
each tank is filled at the first call, from the pose, parameters and flow of its trial. A fish that comes too close to a wall, or
whose water is no longer finite, stays at its last pose; `stopped` has the reason.

In a stream every fish is held for `HELD` s before its trial, while the clock runs up to 0, so that the flow around it develops.
If released at once, a fish at rest would be carried along within 0.1 s.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.effects import RobotScales
from fishmj.effects.effect_calibration import activate
from fishmj.engines import FishParams, FishState, Steps, Trace, check_commands, drained, ticks_per
from fishmj.engines.tank_effects import check_effects
from fishmj.engines.tank_run import EffectRun, TankEffects
from fishmj.lbm_oracle.fluid.device import devices_of, several
from fishmj.lbm_oracle.immersed.markers import Sharpness
from fishmj.lbm_oracle.run.domain import preset
from fishmj.lbm_oracle.run.run import ConcurrentRuns, Run
from fishmj.lbm_oracle.run.setup import DomainWatch, SwimSetup
from fishmj.lbm_oracle.run.solver_water import PLAIN
from fishmj.mjcf.description import Robot
from fishmj.mjcf.model import personalise
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import Flow

HELD = 1.0  # s


class LbmEngine:
    """Tanks for the given flows, in their order.

    Args:
        robot: description; its effects act as described in `tank_effects`.
        domain: box of water by name; `paper` is 4 x 4 x 1 m at 2 cm, `paper_refined` the same with 1 cm round the fish.
        slip: slip ratio at the paper's grid. device: auto, cpu, cuda; `cuda:all` or a list distributes the tanks in turn.
        finer: number of time steps in one of the domain's. width, passes, sharpness: of the immersed boundary.
        storage: float type of the populations. dx: m, cell size in place of the domain's. nu: m2/s, kinematic viscosity.

    Raises ConfigError: an effect that cannot act in a tank.
    """

    jittable = False

    def __init__(
        self, robot: Robot, flows: Sequence[Flow], *, domain: str = "paper", slip: float = 1.0, device: str = "auto",
        finer: int = 1, width: int = PLAIN.width, passes: int = PLAIN.passes, sharpness: Sharpness = PLAIN.sharpness,
        storage: str = PLAIN.storage, dx: float | None = None, nu: float = PLAIN.nu,
    ):  # fmt: skip
        check_effects(robot)
        self.robot, self.flows = robot, list(flows)
        self.active = activate(robot.effects, robot.n_joints, RobotScales.of(robot))[0] if robot.effects else None
        box = preset(domain).changed(nu=nu).with_cells(dx)
        self.domain, self.slip = replace(box, dt=box.dt / finer), slip
        self.devices = devices_of(device) if several(device) else (device,)
        self.width, self.passes, self.sharpness, self.storage = width, passes, sharpness, storage
        self.tanks: ConcurrentRuns | None = None

    def __reduce__(self):
        raise ConfigError("engine lbm: a tank of water cannot be copied; make another engine of the same flows")

    @property
    def stopped(self) -> list[str]:
        """Reason for the stop of each tank; empty for a tank that did not stop."""
        return [] if self.tanks is None else [run.stopped for run in self.tanks.runs]

    @property
    def ticks(self) -> list[int]:
        """Numbers of bus ticks that each tank has done."""
        return [] if self.tanks is None else [run.ticks for run in self.tanks.runs]

    def advance(self, state: FishState, commands, params: FishParams, current, tick) -> tuple[FishState, Trace]:
        """Advances the B tanks by bus commands (B, T, J) [rad]; ignores `current`, because tanks have their own flows."""
        return drained(self.advancing(state, commands, params, current, tick))

    def advancing(self, state: FishState, commands, params: FishParams, current, tick) -> Steps[tuple[FishState, Trace]]:
        """Does the work of `advance`, pausing whenever the device has work and the host could serve other tanks."""
        check_commands(commands, self.robot.n_joints)
        if self.tanks is None:
            if len(state.q) != len(self.flows):
                raise ConfigError(f"tanks: got {len(state.q)} fish for {len(self.flows)} flows; expected one flow for each fish")
            runs = yield from self.filled(range(len(self.flows)), state, params)
            self.tanks = ConcurrentRuns(runs, pipelined=True)
        runs, batch = self.tanks.runs, len(self.flows)
        rows: list[tuple] = []
        for k in range(commands.shape[1]):
            before = [run.ticks for run in runs]
            yield from self.tanks.ticking(commands[:, k])
            moved = [run.ticks > n for run, n in zip(runs, before, strict=True)]
            poses = np.array([run.pose for run in runs])
            joints = np.array([run.angles() for run in runs]) - params.zero
            rates = np.array([run.rates() for run in runs])
            power = np.array([run.rows[-1][6] if run.rows and m else 0.0 for run, m in zip(runs, moved, strict=True)])
            rows.append((poses[:, :3], joints, rates, poses[:, 3:], power))
        trace = Trace(*(np.stack(column, 1) for column in zip(*rows, strict=True)))
        q = np.concatenate([trace.pose[:, -1], trace.joint[:, -1] + params.zero], -1)
        v = np.concatenate([trace.velocity[:, -1], trace.rate[:, -1]], -1)
        memory = np.array(state.memory, float)
        for row, run in zip(memory, runs, strict=True):
            if isinstance(run, EffectRun):
                row[: len(run.added.memory)] = run.added.memory
        return FishState(q, v, np.zeros(batch), np.asarray(state.buffer), memory), trace

    def filled(self, rows: Sequence[int], state: FishState, params: FishParams) -> Steps[list[Run]]:
        """Makes tanks for some of the fish, and holds these until their trials begin."""
        q, memory = np.asarray(state.q)[rows], np.asarray(state.memory)
        runs = [self.tank(i, q[k], params, memory[i]) for k, i in enumerate(rows)]
        tanks = ConcurrentRuns(runs, pipelined=True)  # the water of a trial is not recorded
        asked = q[:, 3:] - np.asarray(params.zero)[rows]  # present encoder angles of the joints
        streams = [flow.speed > 0 or flow.rms > 0 for flow in (run.coupled.fluid.flow for run in tanks.runs)]
        if any(streams):
            for run in tanks.runs:
                set_clock(run, -HELD)
            for _ in range(round(HELD / self.robot.timing.bus_dt)):
                yield from tanks.ticking(asked)
        for run, angles in zip(tanks.runs, asked, strict=True):
            run.tethered = False
            if not run.stopped:
                run.begin()
                run.commands = [angles.copy()]
        return tanks.runs

    def tank(self, i: int, q: np.ndarray, params: FishParams, memory: np.ndarray | None = None) -> Run:
        """Makes tank i with its fish at rest in undisturbed flow; memory: (M,) of its effects, by default the initial one."""
        own = {name: np.asarray(getattr(params, name))[i] for name in ("mass", "kp", "kv", "kb", "zero")}
        flow, added = self.flows[i], None
        if self.active is not None:
            swimmer = planar_chain.nominal(self.robot)._replace(**{name: value.tolist() for name, value in own.items()})
            kept = self.active.memory if memory is None else memory
            added = TankEffects(self.robot, self.active, np.asarray(params.effects)[i], kept, swimmer)
            flow = added.stream(flow)
        stage = SwimSetup(
            domain=self.domain, robot=self.robot, flow=flow, slip=self.slip, device=self.devices[i % len(self.devices)],
            pose=(float(q[0]), float(q[1]), float(q[2])), joints=tuple(float(a) for a in q[3:]),
            width=self.width, passes=self.passes, sharpness=self.sharpness, storage=self.storage,
        )  # fmt: skip
        acting = added if added is not None and added.acting else None
        coupled = stage.coupled(acting.body(self.domain.body_level.dt) if acting else None)
        if added is None:
            personalise(coupled.body.model, **own)
        elif acting is None:
            added.personalise(coupled.body.model)
        coupled.body.forward()
        edge = DomainWatch(self.domain, float(q[2]))
        steps, _ = ticks_per(self.robot)
        if round(self.robot.timing.bus_dt / coupled.body.dt) < steps:
            raise ConfigError(
                f"tanks: the time step of the water, {coupled.body.dt} s, is longer than the robot's physics_dt,"
                f" {self.robot.timing.physics_dt} s; take smaller cells, --dx, since the step is proportional to them"
            )
        latency = float(np.asarray(params.delay)[i]) * self.robot.timing.physics_dt
        run: Callable[..., Run] = partial(EffectRun, acting) if acting else Run
        return run(coupled, self.robot, latency=latency, follow=edge, tethered=True)


def set_clock(run: Run, time: float) -> None:
    """Sets the clock of fish and water to `time` s, and the undisturbed flow of that time everywhere."""
    coupled = run.coupled
    fluid = coupled.fluid
    with coupled.scope():
        fluid.set_steps(round(time / fluid.lattice.dt))
        fluid.settle()
    coupled.body.data.time = time
    run.begin()
