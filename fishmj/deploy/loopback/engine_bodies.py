"""Bodies on the engines: one fish in MuJoCo (`sim.Sim`), in compiled code (`engines.compiled`), or in the flow solver."""

import numpy as np

from fishmj import engines
from fishmj.base.errors import SimDiverged
from fishmj.deploy.loopback.ticked_body import Moment, TickedBody
from fishmj.mjcf.description import Robot
from fishmj.sim import Sim
from fishmj.water import choice
from fishmj.water.flow import Flow, stack


class SteppedSim(Sim):
    """A `Sim` whose servo targets are set from outside, step by step."""

    goals: np.ndarray  # (S, J) rad, of the present tick

    def arrived(self, step: int) -> np.ndarray:
        """Targets of the servos in this physics step, (J,) rad."""
        return self.goals[step % self.steps]


class MujocoBody(TickedBody):
    """One fish in MuJoCo; arguments as `bodies.make`."""

    def __init__(self, robot: Robot, water: str, start: tuple[float, float, float], flow: Flow, radio: float):
        self.stage = stage = SteppedSim(robot, water=water, flow=flow, pose=start, latency=0.0)
        late = float(stage.added.late(np, stage.added.row, "command"))
        super().__init__(stage.robot, stage.swimmer.zero, start, radio, late)
        self._gains = stage.model.actuator_gainprm.copy(), stage.model.actuator_biasprm.copy()
        joints = slice(-stage.model.nu, None)
        self._begin = self._end = self._moment(0.0)._replace(q=np.array([*start, *stage.data.qpos[joints]]))

    def tick(self, goals: np.ndarray) -> Moment:
        """Simulates one tick; goals (S, J) rad, one row a physics step."""
        stage = self.stage
        stage.goals = goals
        stage.step(goals[-1])
        watts = float(stage.recorder.rows[-1][-1])
        stage.recorder.rows.clear()  # hours of them would fill the memory
        stage.commands = stage.commands[-1:]
        return self._moment(watts)

    def torque(self, on: bool) -> None:
        """Switches the servos' torque, by their gains."""
        super().torque(on)
        gain, bias = self._gains
        self.stage.model.actuator_gainprm[:] = gain if on else 0.0
        self.stage.model.actuator_biasprm[:] = bias if on else 0.0

    def _moment(self, watts: float) -> Moment:
        pose, data, joints = self.stage.pose, self.stage.data, slice(-self.stage.model.nu, None)
        return Moment(np.r_[pose[:3], data.qpos[joints]], np.r_[pose[3:], data.qvel[joints]], watts)


class CompiledBody(TickedBody):
    """The same fish by the compiled engine, which a test holds equal to MuJoCo: for hours in lockstep.

    If several commands arrive within one tick, it uses the last.
    """

    def __init__(self, robot: Robot, water: str, start: tuple[float, float, float], flow: Flow, radio: float):
        wet = choice.chosen(robot, water).within(choice.SELF_MADE, "the loopback's compiled body").robot
        self.engine = engines.make("compiled", wet)
        self._params = engines.nominal_params(self.engine.robot, 1)
        late = float(self._params.delay[0]) * wet.timing.physics_dt - wet.timing.command_latency
        super().__init__(wet, self._params.zero[0], start, radio, max(late, 0.0))
        self._limp = self._params._replace(kp=0.0 * self._params.kp, kv=0.0 * self._params.kv)
        self._state, self._current = engines.at_rest(wet, [start]), stack([flow])
        self._begin = self._end = Moment(np.array(self._state.q[0], float), np.array(self._state.v[0], float))
        begun = self._state
        for _ in range(2):  # loads the machine code now: who serves in real time has no second for it later
            self.tick(np.zeros((1, wet.n_joints)))
        self._state = begun

    def tick(self, goals: np.ndarray) -> Moment:
        """Simulates one tick; of the goals (S, J) rad only the newest counts, from its step on. Raises SimDiverged."""
        fresh = int(np.argmax((goals == goals[-1]).all(1)))  # the step from which the newest one counts
        params = (self._params if self.on else self._limp)._replace(delay=np.array([fresh], np.int32))
        sent = np.array(goals[-1])[None, None]
        state, trace = self.engine.advance(self._state, sent, params, self._current, np.array([self._ticks]))
        self._state = state
        if not np.isfinite(state.q).all():
            raise SimDiverged(f"the loopback's fish left the finite numbers at t = {self.time:.2f} s", time=self.time)
        return Moment(np.array(state.q[0], float), np.array(state.v[0], float), float(trace.power[0, -1]))


class SolverBody(TickedBody):
    """One fish in the flow solver. A command waits for the next tick; the mean of that wait is subtracted from its delay.

    The solver's joints always have servos: without torque, each tick sets the target to the present angle.
    """

    def __init__(self, robot: Robot, start: tuple[float, float, float], flow: Flow, radio: float, domain: str):
        from fishmj.engines.lbm import LbmEngine

        params = engines.nominal_params(robot, 1)
        super().__init__(robot, params.zero[0], start, radio + 0.5 * robot.timing.bus_dt)
        self._params = params._replace(delay=0 * params.delay)
        self.engine = LbmEngine(robot, [flow], domain=domain)
        self._state = engines.at_rest(robot, [start])

    def tick(self, goals: np.ndarray) -> Moment:
        """Simulates one tick with the first of the goals (S, J) rad. Raises SimDiverged if the solver has stopped."""
        aim = goals[0] if self.on else self._end.q[3:] - self.zero
        self._state, trace = self.engine.advance(self._state, np.array(aim)[None, None], self._params, None, None)
        if self.engine.stopped[0]:
            raise SimDiverged(f"the loopback's tank stopped at t = {self.time:.2f} s: {self.engine.stopped[0]}", time=self.time)
        return Moment(np.array(self._state.q[0], float), np.array(self._state.v[0], float), float(trace.power[0, -1]))
