"""One fish, one controller, a current and a target that may change while it swims, and the keys that change them."""

import os
import select
import sys
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fishmj import control, engines
from fishmj.base.errors import ConfigError, FishmjError
from fishmj.base.source import made_by
from fishmj.base.units import wrap
from fishmj.control import Controller
from fishmj.control.learned import LearnedController
from fishmj.engines.planar import link_centres
from fishmj.log import SCHEMA, Trial, numbered
from fishmj.mjcf.description import Robot
from fishmj.mjcf.identity import identity
from fishmj.mjcf.reading import load_robot
from fishmj.tasks.episode import ControlLoop, Scenario
from fishmj.tasks.sensing import NOTE, logged, logged_meta
from fishmj.water.choice import HYBRID, NONE, in_water, label
from fishmj.water.dynamics.planar_chain import chain_of
from fishmj.water.flow import Flow, sample, shifted

FASTEST = 0.5  # m/s
SENSED = 4  # stream of random numbers of what is logged, beside that of the observations
SPEED_STEP, TURN_STEP, TARGET_STEP = 0.02, np.pi / 12, 0.1  # m/s, rad, m a key press
REACH = 1.5  # m, the target stays in |x|, |y| <= REACH
ARROWS = {"\x1b[A": "up", "\x1b[B": "down", "\x1b[C": "right", "\x1b[D": "left"}
ARROWS |= {code.replace("[", "O"): name for code, name in ARROWS.items()}  # terminals in application mode
MOVES = {"w": (0, 1), "a": (-1, 0), "s": (0, -1), "d": (1, 0)}


class Chunk(NamedTuple):
    """One control step: T bus ticks, N links."""

    t: np.ndarray  # (T,) s
    q: np.ndarray  # (T, 2 + N) m, rad
    v: np.ndarray  # (T, 2 + N) m/s, rad/s
    flow: np.ndarray  # (T, N, 2) m/s
    power: np.ndarray  # (T,) W with idle
    command: np.ndarray  # (T, N - 1) rad
    target: np.ndarray  # (2,) m
    obs: np.ndarray  # (5 + 2 J,)
    action: np.ndarray | None  # (J,) of a policy
    controller: str
    current: tuple[float, float]  # m/s, rad: the mean, as it was set


class LiveSession:
    """One nominal fish under a controller, in a current and with a target that may change between control steps."""

    def __init__(
        self,
        controller: "Controller | str" = "dob",
        robot: "Robot | str" = "fish",
        flow: Flow | None = None,
        engine="batch",
        noise: float = 1.0,
        water=None,
    ):
        self.robot = in_water(load_robot(robot), water, who="play") if isinstance(engine, str) else load_robot(robot)
        self.flow, self.noise = flow or Flow(speed=0.2, direction=np.pi), noise
        self.loop = ControlLoop(self.robot, engine)
        self.engine_name = engines.name_of(self.loop.engine)
        self._chain = chain_of(self.robot)
        params = engines.nominal_params(self.robot, 1)
        camera = self.loop.sensors.ticks(np, np.array([self.robot.timing.camera_latency]), params.effects, "pose")
        self._nominal = Scenario(params, camera, self.flow.current())
        self.choose(controller)
        self.reset()

    def choose(self, controller: "Controller | str") -> None:
        """Hands the fish to another controller, given as an object or by name."""
        self.controller = control.make(controller, self.robot) if isinstance(controller, str) else controller
        self.controller.reset(1)

    def can_steer(self, name: str) -> bool:
        """Returns True if the controller of this name can steer this fish."""
        try:
            control.make(name, self.robot)
        except FishmjError:
            return False
        return True

    def reset(self) -> None:
        """Goes back to the start: at rest 0.7 m from the target, heading upstream. The recording is dropped."""
        start = np.array([[-0.7, 0.0, wrap(np, np.pi + self.flow.direction)]])
        self.target = np.array([0.7, 0.0])
        self._start = start[0]
        self.loop.start(start, self._nominal._replace(current=self.flow.current()))
        self._random = np.random.default_rng(self.flow.seed)
        self.controller.reset(1)
        self.chunks: list[Chunk] = []

    def set_flow(self, speed: float, direction: float) -> None:
        """Changes the mean current [m/s, rad]; the eddies around the fish stay where they are."""
        before = self.loop.scenario.current
        self.flow = Flow(**{**vars(self.flow), "speed": float(np.clip(speed, 0, FASTEST)), "direction": direction % (2 * np.pi)})
        now = self.flow.current()
        if now.table.ndim == 4:  # frozen eddies ride on the mean: carry their phase over
            turned = now._replace(mean=before.mean, offset=before.offset)
            now = shifted(turned, now.mean - before.mean, self.loop.count * self.loop.ticks)
        self.loop.scenario = self.loop.scenario._replace(current=now)

    @property
    def time(self) -> float:
        """Simulated seconds since the start."""
        return int(self.loop.count[0]) * self.robot.timing.control_dt

    @property
    def q(self) -> np.ndarray:
        """(2 + N,) pose and joint angles now, m, rad."""
        return np.concatenate([self.loop.window.pose[0, -1], self.loop.window.joint[0, -1, : self.robot.n_joints]])

    def step(self) -> Chunk:
        """One control step of 0.2 s."""
        noise = self.noise * self._random.standard_normal((1, 5 + 2 * self.robot.n_joints))
        obs = self.loop.observe(self.target[None], noise)
        self.loop.inform(self.controller)
        command = np.asarray(self.controller(obs), float)
        ticks = self.loop.count * self.loop.ticks + 1 + np.arange(self.loop.ticks)
        trace = self.loop.act(command)
        q = np.concatenate([trace.pose[0], trace.joint[0]], -1)
        action = getattr(self.controller, "action", None)
        chunk = Chunk(
            t=ticks * self.robot.timing.bus_dt,
            q=q,
            v=np.concatenate([trace.velocity[0], trace.rate[0]], -1),
            flow=sample(np, self.loop.scenario.current, link_centres(np, self._chain, q), ticks)[0],
            power=trace.power[0] + self.robot.servo.idle_power,
            command=command[0],
            target=self.target.copy(),
            obs=obs[0],
            action=None if action is None else np.array(action, float)[0],
            controller=self.controller.name,
            current=(self.flow.speed, self.flow.direction),
        )
        self.chunks.append(chunk)
        return chunk

    def trial(self) -> Trial:
        """The recording since the start, in the log's schema: the log of a robot in a tank, and the truth."""
        if not self.chunks:
            raise ConfigError("play: nothing recorded yet; swim for a moment before saving")
        t, q, v, flow, power, command = (np.concatenate([getattr(c, name) for c in self.chunks]) for name in Chunk._fields[:6])
        begun = t - self.robot.timing.bus_dt
        slow = begun[:: self.loop.ticks]
        target, obs = (np.array([getattr(c, name) for c in self.chunks]) for name in ("target", "obs"))
        motion = (begun, t, command, q[:, :3], v[:, :3], q[:, 3:], v[:, 3:], power)
        random = np.random.default_rng([self.flow.seed, SENSED])
        fish, camera = self._nominal.params, self._nominal.camera
        tables = {
            **logged(self.robot, *motion, fish, camera, start=self._start, random=random, strength=self.noise),
            "target": {"t": slow, "x": target[:, 0], "y": target[:, 1]},
            "obs": {"t": slow, **numbered("o#", obs)},
            "flow": {"t": t, **numbered("u#x", flow[..., 0]), **numbered("u#y", flow[..., 1])},
        }
        acted = [i for i, c in enumerate(self.chunks) if c.action is not None]  # by a policy; a classical controller has none
        if acted:
            tables["action"] = {"t": slow[acted], **numbered("a#", np.array([self.chunks[i].action for i in acted]))}
        return Trial(self._meta(tables), tables)

    def _meta(self, tables: dict) -> dict:
        """Meta data of the swim for its readers."""
        names, hybrid = list(dict.fromkeys(c.controller for c in self.chunks)), getattr(self.loop.engine, "hybrid", None)
        steady = len({c.current for c in self.chunks}) == 1
        notes = [NOTE]
        if not steady:
            notes.append(
                "the current was changed by hand: flow.speed and flow.direction are the last ones set, the table flow is exact"
            )
        if not (still := len({(*c.target,) for c in self.chunks}) == 1):
            notes.append("the target was moved by hand: target is where it was last, the table target is exact")
        if len(names) > 1:
            notes.append(f"steered by {', '.join(names)}, one after the other")
        return {
            "schema": SCHEMA,
            "origin": "synthetic",
            **identity(self.robot),
            "medium": "air" if label(self.robot) == NONE else "water",
            "flow": {**vars(self.flow), "known": steady},
            "water": label(self.robot) if hybrid is None else HYBRID,
            **({} if hybrid is None else {"hybrid": hybrid.report()}),
            "root": "planar",
            "engine": self.engine_name,
            "controller": names[-1],
            "policy_sha256": str(getattr(self.controller, "sha256", "")),
            **({"policy": self.controller.trained()} if isinstance(self.controller, LearnedController) else {}),
            "target": self.chunks[-1].target.tolist(),
            "excitation": "station holding" if still and steady else "live",
            **logged_meta(self.robot, tables, self._nominal.params, self._nominal.camera, self._start, self.noise),
            "seed": self.flow.seed,
            **made_by("numpy", "mujoco"),
            "source": "fishmj.play",
            "licence": "Apache-2.0",
            "notes": notes if len(notes) > 1 else notes[0],
        }


class Keyboard:
    """Context manager that reads keys without Enter and restores the terminal afterwards.

    Without a handle there are never keys.
    """

    def __init__(self, handle: int | None = None):
        self.handle = handle

    @classmethod
    def of_terminal(cls) -> "Keyboard":
        """Standard input, if it is a terminal."""
        return cls(sys.stdin.fileno() if sys.stdin and sys.stdin.isatty() else None)

    def __enter__(self) -> "Keyboard":
        if self.handle is not None:
            import termios
            import tty

            self._before = termios.tcgetattr(self.handle)
            tty.setcbreak(self.handle)
        return self

    def __exit__(self, *failure) -> None:
        if self.handle is not None:
            import termios

            termios.tcsetattr(self.handle, termios.TCSADRAIN, self._before)

    def read(self) -> list[str]:
        """The keys pressed since the last call, by name; never waits."""
        if self.handle is None or not select.select([self.handle], [], [], 0)[0]:
            return []
        text, keys = os.read(self.handle, 256).decode("utf-8", "ignore"), []
        while text:
            length = 3 if text[:3] in ARROWS else 1
            keys.append(ARROWS.get(text[:length], text[:length].lower()))
            text = text[length:]
        return keys


def press(session: LiveSession, key: str, choices: Iterator[Controller | str]) -> None:
    """Carries out a key: arrows change the current, w a s d the target, c the controller, r starts again; others do nothing."""
    flow = session.flow
    if key in ("up", "down"):
        session.set_flow(flow.speed + (SPEED_STEP if key == "up" else -SPEED_STEP), flow.direction)
    elif key in ("left", "right"):
        session.set_flow(flow.speed, flow.direction + (TURN_STEP if key == "left" else -TURN_STEP))
    elif key in MOVES:
        session.target = np.clip(session.target + TARGET_STEP * np.array(MOVES[key]), -REACH, REACH)
    elif key == "c":
        session.choose(next(choices))
    elif key == "r":
        session.reset()
