"""One fish in MuJoCo, in any water: `Sim.step` is the main loop.

    command -> clamp, quantise -> bus (latency) -> [ servo target -> remember -> water.step ] x 5 -> record

All waters have one interface (`engines.single.Water`): strips and learnt residual in MuJoCo's callback or as a wrench on every
link, the closed form with effects, or MuJoCo alone.

    sim = Sim("fish", flow=Flow(speed=0.2, direction=np.pi))
    trial = sim.run(lambda t: 0.5 * np.sin(2 * np.pi * t - np.arange(3)), seconds=4.0)

`fishmj.engines` simulates batches of fish; a test holds both equal.
"""

from collections import deque
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from fishmj import mjcf
from fishmj.base.errors import ConfigError, SimDiverged, UnknownName
from fishmj.base.options import checked, checked_array, checked_kind
from fishmj.engines.extensions import Extensions
from fishmj.engines.recorder import Recorder, rescue
from fishmj.engines.single import water_of
from fishmj.log import Trial
from fishmj.mjcf.model import personalise, reference_pose, reference_qpos
from fishmj.mjcf.servos import arrived_of, on_the_bus
from fishmj.water import choice
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import TURN, Current, Flow, sample
from fishmj.water.prior import flat, unflat

ELLIPSOID = "ellipsoid"  # MuJoCo's own fluid, for comparison
ENGINES = ("mujoco",)
SLOWEST = 60.0  # s, a command latency beyond it is a slip of the pen
KEPT = 100  # physics steps remembered for a diverged run


class Sim:
    """One fish, one flow, one water.

    Args:
        robot: description, TOML path or shipped name.
        water: as named in `fishmj.water.choice`: by default "fitted" if this body has a fitted water; "structured", "none", a
            fitted one by name or TOML, with "#2" for member 2 of its ensemble; "hybrid", which the flow solver corrects while
            the fish swims; or "ellipsoid" (MuJoCo's own fluid). `water_name` is the resulting name.
        flow: background flow; still water by default.
        root: "planar" or "free".
        pose: (x, y, yaw) at t = 0, m and rad; at rest over ground, straight.
        swimmer: this fish's own constants; the nominal ones by default.
        latency: of commands, s; the robot's nominal one by default.
        injection: coupling of the water to MuJoCo: "callback" (mjcb_passive; one thread a process), "xfrc" (a wrench on every
            link in `xfrc_applied`; any thread) or "qfrc" (the closed form in `qfrc_applied`; planar root). The swim is the same
            to round-off. Default "qfrc" for a robot with effects, else "callback".
        rescue_folder: folder for the last states of a diverged run; default, a private folder in the temporary directory.
        hybrid: for the water "hybrid", `fishmj.engines.hybrid.HybridOptions`, or your own `fishmj.engines.hybrid.Hybrid`.

    Attributes:
        hybrid: the `fishmj.engines.hybrid.Hybrid` that corrects the water (see its `report`), None in any other water.

    Raises UnknownName, ConfigError: an invalid name or time step; a hybrid with a free root.
    """

    def __init__(
        self,
        robot="fish",
        *,
        water: "str | Path | None" = None,
        flow: Flow | None = None,
        engine: str = "mujoco",
        root: str = "planar",
        pose=(0.0, 0.0, 0.0),
        swimmer: planar_chain.Swimmer | None = None,
        latency: float | None = None,
        injection: str | None = None,
        rescue_folder: Path | None = None,
        hybrid: Any = None,
    ):
        if engine not in ENGINES:
            raise UnknownName("engine", engine, ENGINES)
        own_fluid = water == ELLIPSOID
        can = (*choice.SELF_MADE, choice.HYBRID)
        chosen = choice.chosen(mjcf.load_robot(robot), choice.STRUCTURED if own_fluid else water).within(can, "Sim").announced()
        self.robot, corrected = chosen.robot, chosen.kind == choice.HYBRID
        if corrected and root != "planar":
            raise ConfigError(
                f"Sim: water 'hybrid' acts on a fish with a planar root, got root = {root!r}; take 'planar', or fitted"
            )
        model = ELLIPSOID if own_fluid else choice.label(self.robot)
        self.water_name = choice.HYBRID if corrected else model
        self.root = root
        self.start = tuple(checked_array("Sim: pose", pose, (3,)).tolist())
        checked("Sim: pose, yaw", self.start[2], *TURN)
        self.flow = checked_kind("Sim: flow", flow, Flow) or Flow()
        checked_kind("Sim: swimmer", swimmer, planar_chain.Swimmer)
        if hybrid is not None and not corrected:
            raise ConfigError(f"Sim: hybrid has the options of water 'hybrid', got water {self.water_name!r}; leave it out")
        self.rescue_folder = rescue_folder
        timing = self.robot.timing
        self.ticks_a_second = round(1 / timing.bus_dt)
        self.steps = round(timing.bus_dt / timing.physics_dt)
        self.added = Extensions.of(self.robot)
        late = float(self.added.late(np, self.added.row, "command"))
        bus = timing.command_latency if latency is None else checked("Sim: latency", latency, 0, SLOWEST)
        self.delay = round((bus + late) / timing.physics_dt)
        self.swimmer = swimmer or planar_chain.nominal(self.robot)
        self.model = mjcf.build(self.robot, root, ellipsoid=own_fluid)
        s = self.swimmer
        personalise(self.model, mass=s.mass, kp=s.kp, kv=s.kv, kb=s.kb, zero=s.zero)
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:] = reference_qpos(self.model, pose, np.zeros(self.robot.n_joints))
        self.water = water_of(model, self.robot, root, self.model, self.swimmer, self.added, injection)
        self.tick = 0
        self.commands = [np.zeros(self.robot.n_joints)]  # on the bus; number 0 was there before t = 0
        self.recent: deque = deque(maxlen=KEPT)
        self.recorder = Recorder(self)
        self._current = self.flow.current()
        self.hybrid: Any = self._hybrid(hybrid) if corrected else None

    def step(self, command) -> None:
        """Advances one bus tick (20 ms) after sending `command`, (J,) joint angles in rad.

        Raises:
            ConfigError: the command is not finite, beyond pi, or for another number of joints.
            SimDiverged: the state of the fish is not finite; the last 100 states are saved and named in the message.
        """
        current = self._current if self.hybrid is None else self._correct()
        sent = self._send(command)
        power = 0.0
        flow = self._sample_flow(current)
        try:
            for k in range(self.steps):
                self.data.ctrl[:] = self.arrived(self.tick * self.steps + k)
                self._remember()
                self.water.step(self.data)
                power += self.water.power / self.steps
        except SimDiverged as error:
            raise rescue(self, error) from error
        self.tick += 1
        self.recorder.add(sent, flow, power)

    def run(self, commands, seconds: float) -> Trial:
        """Swims for `seconds` and returns all records so far.

        Args:
            commands: a function of time [s] -> (J,) rad, called every bus tick, or an array (T, J) of bus commands.
        """
        ticks = round(checked("Sim.run: seconds", seconds, 0) * self.ticks_a_second)
        if not callable(commands):
            rows = len(commands) if hasattr(commands, "__len__") else 0
            given = checked_array("Sim.run: commands", commands, (rows, self.robot.n_joints))
            if len(given) < ticks:
                lasts = len(given) / self.ticks_a_second
                raise ConfigError(f"Sim.run: {len(given)} bus commands last {lasts} s, asked for {seconds} s")
        for i in range(ticks):
            self.step(commands(self.data.time) if callable(commands) else given[i])
        return self.trial()

    def trial(self) -> Trial:
        """Records so far, in the log's schema; origin "synthetic"."""
        return self.recorder.trial()

    def arrived(self, step: int) -> np.ndarray:
        """Servo target (J,) rad in physics step `step`: the newest command that is `delay` steps old.

        With the path "move_time" the servo moves linearly from one command to the next in one tick.
        """
        return arrived_of(self.commands, step, self.delay, self.steps, self.robot.timing.command_path == "move_time")

    def links(self) -> np.ndarray:
        """World positions of the link centres, (N, 3) m."""
        mujoco.mj_kinematics(self.model, self.data)
        return np.array([self.data.site(f"{link.name}_centre").xpos for link in self.robot.links])

    def _send(self, command) -> np.ndarray:
        """Puts a command on the bus; returns it, (J,) rad, as the servos get it."""
        what = f"Sim.step: command, rad ({self.robot.name} has {self.robot.n_joints} joints),"
        asked = checked_array(what, command, (self.robot.n_joints,))
        if (most := float(np.abs(asked).max())) > np.pi:
            raise ConfigError(f"{what} goes to {most:.4g}; expected at most {np.pi:.4g}; are these degrees?")
        sent = on_the_bus(self.robot.servo, asked)
        self.commands.append(sent)
        return sent

    def _hybrid(self, given):
        """Hybrid of this fish."""
        from fishmj import engines
        from fishmj.engines.hybrid import Hybrid

        s, rows = self.swimmer, lambda values: np.array([values], float)
        own = {name: rows(getattr(s, name)) for name in ("mass", "kp", "kv", "kb", "zero")}
        own |= {"water": rows(flat(s.water)), "delay": np.array([self.delay]), "net": np.array([s.net])}
        self._params = engines.nominal_params(self.robot, 1)._replace(**own)
        self._buffer = engines.rows_of(self.robot)
        return given if isinstance(given, Hybrid) else Hybrid(self.robot, given, kind=self.flow)

    def _correct(self) -> Current:
        """Flow of this tick with the hybrid's correction; also sets the water's coefficients."""
        from fishmj.engines import FishState

        water: Any = self.water
        sent = [*[self.commands[0]] * self._buffer, *self.commands[-self._buffer :]][-self._buffer :]
        batch = lambda values: np.array([values], float)
        fish = FishState(*map(batch, (self.data.qpos, self.data.qvel, water.attached, sent, water.memory)))
        params, current = self.hybrid.tick(fish, self._params, self._current, self.tick)
        if params is not self._params:
            water.swimmer = water.swimmer._replace(water=unflat(params.water[0].tolist()))
        return current

    def _sample_flow(self, current: Current) -> np.ndarray:
        """Samples the flow at every link, (N, 2) m/s, for this tick, and passes it to the water."""
        flow, ambient = sample(np, current, self.links()[None, :, :2], np.array([self.tick]))
        self.water.set_flow(flow[0], ambient[0])
        return flow[0]

    def _remember(self) -> None:
        """Keeps the state for the log of a run that diverges."""
        self.recent.append((self.data.time, self.data.qpos.copy(), self.data.qvel.copy(), self.data.ctrl.copy()))

    @property
    def pose(self) -> np.ndarray:
        """Pose and rates (x, y, yaw, x', y', yaw') of the reference point, tank frame."""
        return reference_pose(self.model, self.data)
