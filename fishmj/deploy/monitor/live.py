"""The monitor of a swim: rows of the trial go to a separate process, alarms come back.

    this process   collects rows as the log takes them in; a thread sends them, twice a second (`LiveMonitor`)
    the other one  `process`: 1.2 ms of arithmetic for every bus tick, at a lower priority, behind the loop by as much; it
                   may stay for several swims, one after the other (`MonitorProcess`), and then learns from healthy ones once

So no tick waits for the model. The swim continues after any alarm: protection is the supervisor's task.
"""

import json
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.processes import end_command, start_command
from fishmj.deploy.loop.observation import Pose
from fishmj.deploy.loop.supervisor import Event, SwimState
from fishmj.deploy.loop.trial_log import TrialLog
from fishmj.deploy.monitor.monitor import RATE, RUN_IN, SETTLE, Alarm, said
from fishmj.deploy.monitor.statistics import BLOCK, LEAST_BLOCKS
from fishmj.deploy.protocols.messages import Telemetry
from fishmj.log import read_trial
from fishmj.log.trial_folder import META_FILE
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot

EVERY = 0.5  # s between two deliveries
DRAIN, LEAVE = 60.0, 1.0  # s that the other process may take for what is still on its way; the same after Ctrl-C
PROCESS, OVER = "fishmj.deploy.monitor.process", "over"
Tables = dict[str, dict[str, list[float]]]


@dataclass(frozen=True, kw_only=True)
class Watched:
    """Settings of the comparison. model: description. flow: the ordered stream, m/s and rad, None if unknown.

    healthy: folders of healthy swims to learn from, none: the first `settle` s. rate: false alarms an hour.
    """

    model: str
    flow: tuple[float, float] | None = None
    healthy: tuple[Path, ...] = ()
    rate: float = RATE
    settle: float = SETTLE


def monitor_options(parser: console.Parser) -> None:
    """Adds the options for the monitor of a swim."""
    add = parser.add_argument
    model = "say while it swims when the robot parts from this description: shipped name or TOML file (default: not)"
    add("--monitor", type=console.text, metavar="MODEL", help=model)
    learnt = f"of --monitor: healthy swims of this robot to learn from (default: the first {SETTLE:.0f} s of the swim)"
    add("--healthy", nargs="+", type=console.path, default=[], metavar="TRIAL", help=learnt)
    rate = "of --monitor: false alarms an hour, all tests together"
    add("--alarm-rate", type=console.number(1e-6, 60), default=RATE, metavar="PER_HOUR", help=rate)


def watched_of(args: Any, robot: Robot, flow: tuple[float, float] | None, seconds: float) -> Watched | None:
    """Settings from the options, None without a monitor; prints the tables that will not be watched.

    Raises ConfigError: a model of another chain, a missing healthy swim, or --healthy without --monitor.
    """
    if args.monitor is None:
        if args.healthy:
            raise ConfigError("--healthy is for --monitor MODEL; add it, or leave --healthy out")
        return None
    model = load_robot(args.monitor)
    if model.n_joints != robot.n_joints:
        raise ConfigError(f"--monitor {args.monitor}: {model.n_joints} joints; the robot {robot.name} has {robot.n_joints}")
    for path in args.healthy:
        if not (path / META_FILE).is_file():
            raise ConfigError(f"--healthy {path}: no trial folder; expected one that deploy swim wrote")
    long = sum(trial.span[1] - trial.span[0] - RUN_IN for trial in map(read_trial, args.healthy))
    if args.healthy and long < LEAST_BLOCKS * BLOCK:
        raise ConfigError(
            f"--healthy: {max(long, 0):.0f} s to learn from; expected {LEAST_BLOCKS * BLOCK:.0f} s at least, better minutes"
        )
    if flow is None:
        console.warn("monitor: the stream is not known, still water is taken; give --flow, or every stream is an alarm")
    if not args.healthy and seconds < SETTLE:
        console.warn(f"monitor: it learns from the first {SETTLE:.0f} s, so that {seconds:.0f} s are not watched; give --healthy")
    return Watched(model=args.monitor, flow=flow, healthy=tuple(args.healthy), rate=args.alarm_rate)


class MonitorProcess:
    """The monitor's process: started when a swim needs it, ended by `close`; a context. words: its command line."""

    def __init__(self, words: Sequence[str] = (sys.executable, "-m", PROCESS)):
        self.words = list(words)
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> "MonitorProcess":
        return self

    def __exit__(self, kind, error, trace) -> None:
        self.close()

    def watch(self, hear: Callable[[dict], object]) -> IO[str]:
        """Begins a swim; returns the file for its lines. A thread passes the answers to `hear`."""
        self._hear = hear
        if self._process is None or self._process.poll() is not None:
            self.close()
            self._process = start_command(self.words, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
            threading.Thread(target=self._listen, args=(self._process,), name="monitor in", daemon=True).start()
        return cast(IO[str], self._process.stdin)

    def _listen(self, process: "subprocess.Popen[str]") -> None:
        """Thread that reads the answers."""
        with suppress(OSError, ValueError):
            for line in process.stdout or ():
                self._hear(json.loads(line))
        if process is self._process:
            self._hear({"failed": "its process ended"})

    def close(self) -> None:
        """Ends the process."""
        process, self._process = self._process, None
        if process is not None:
            end_command(process)


class LiveMonitor:
    """Context manager that watches the rows of a log.

    Args:
        log: whose rows are watched; alarms become events of it, and `monitor` in its meta data.
        say: shows a line. stopped: whether the operator wants an end, so that nothing is waited for.
        process: the monitor's; None: one of its own, which ends with this.

    Attributes:
        alarms: so far. failed: reason for the end of the watch, "" while it runs.
    """

    def __init__(
        self, watched: Watched, log: TrialLog, *, say: Callable[[str], object] = console.warn,
        stopped: Callable[[], bool] = lambda: False, process: MonitorProcess | None = None,
    ):  # fmt: skip
        self.watched, self.log, self.say, self.stopped = watched, log, say, stopped
        self.process, self._stays = process or MonitorProcess(), process is not None
        self.alarms: list[Alarm] = []
        self.failed = ""
        self._rows: Tables = {}
        self._zero: float | None = None
        self._shift = np.inf  # s, least of arrival - robot's clock so far
        self._over = False
        self._heard: deque[dict] = deque()
        self._end: dict[str, Any] = {}
        self._taking, self._done, self._last = threading.Lock(), threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> "LiveMonitor":
        w = self.watched
        wanted = {"model": w.model, "flow": list(w.flow or (0.0, 0.0)), "rate": w.rate, "settle": w.settle}
        wanted |= {"healthy": [str(path) for path in w.healthy]}
        pipe = self.process.watch(self._hear)
        self._thread = threading.Thread(target=self._send, args=(pipe, wanted), name="monitor out", daemon=True)
        self._thread.start()
        self.log.listeners.append(self)
        self._note()
        return self

    def __exit__(self, kind, error, trace) -> None:
        """Waits for pending answers, then records the result."""
        if self in self.log.listeners:
            self.log.listeners.remove(self)
        self._done.set()
        self._last.wait(LEAVE if self.stopped() or error is not None else DRAIN)
        self._take()
        if not self._end and not self.failed:
            self.failed = "it was behind at the end, and was not waited for"
        if self.failed or not self._stays:  # one that is behind would be so in the next swim, too
            self.process.close()
        if self._thread is not None:
            self._thread.join(LEAVE)
        self._note()

    def _hear(self, told: dict) -> None:
        """Receives an answer, in the reading thread."""
        self._heard.append(told)
        if "end" in told or "failed" in told:
            self._last.set()

    def command(self, t: float, joint: np.ndarray) -> None:
        """Adds a command sent at t [s]."""
        self._row("cmd", t, t, {f"c{k + 1}": float(value) for k, value in enumerate(joint)})
        if self._heard:
            self._take()

    def heard(self, t: float, packet: Telemetry) -> None:
        """Adds a packet that arrived at t [s]; if the robot has a clock, its rows use that clock (`rows.as_heard`)."""
        at = t
        if packet.time is not None:
            self._shift = min(self._shift, t - packet.time)
            at = packet.time + self._shift
        self._row("joint", t, at, {f"j{k + 1}": float(value) for k, value in enumerate(packet.joint)})
        if packet.voltage is not None and packet.current is not None:
            self._row("power", t, at, {"V": packet.voltage, "I": packet.current})

    def fix(self, pose: Pose) -> None:
        """Adds a fix at its time of exposure."""
        self._row("pose", pose.t, pose.t, {"x": pose.x, "y": pose.y, "yaw": pose.yaw})

    def event(self, event: Event) -> None:
        """Notes a change of the supervisor: rows after the swim are not watched."""
        self._over |= event.after is SwimState.NEUTRAL

    def _row(self, name: str, t: float, at: float, values: dict[str, float]) -> None:
        if self._zero is None:
            self._zero = t
        if self._over:
            return
        with self._taking:
            table = self._rows.setdefault(name, {})
            for column, value in {"t": at - self._zero, **values}.items():
                table.setdefault(column, []).append(value)

    def _send(self, pipe: IO[str], wanted: dict) -> None:
        """Thread that sends the rows."""
        try:
            pipe.write(json.dumps(wanted) + "\n")
            last = False
            while not last:
                last = self._done.wait(EVERY)
                with self._taking:
                    rows, self._rows = self._rows, {}
                if rows:
                    pipe.write(json.dumps(rows) + "\n")
                pipe.flush()
            pipe.write(json.dumps({OVER: True}) + "\n")
            pipe.flush()
        except (OSError, ValueError):  # the other process is gone, and the listening thread says why
            pass

    def _take(self) -> None:
        """Prints the answers, in the loop's own thread."""
        while self._heard:
            packet = self._heard.popleft()
            if "alarm" in packet:
                alarm = Alarm(**packet["alarm"])
                self.alarms.append(alarm)
                self.say(said(alarm))
                self._event(f"monitor: {alarm.channel}, {alarm.probe} {'+' if alarm.sign > 0 else '-'}", alarm.t)
                self._note()
            elif "watching" in packet:
                self._event(f"monitor: watches {', '.join(packet['watching'])}", packet["t"])
            elif "end" in packet:
                self._end = packet["end"]
            elif "failed" in packet and not self.failed and not self._end:
                self.failed = str(packet["failed"]).removeprefix("monitor: ")
                self.say(f"monitor: {self.failed}; nothing is watched any more, the swim goes on")

    def _event(self, text: str, t: float) -> None:
        self.log.say((self._zero or 0.0) + t, text)

    def _note(self) -> None:
        """Writes the table `monitor` of the trial's meta data."""
        w = self.watched
        learnt = [str(path) for path in w.healthy] or f"the first {w.settle:g} s"
        note: dict[str, Any] = {"model": w.model, "rate": w.rate, "learnt_from": learnt, **self._end}
        note |= {"failed": self.failed} if self.failed else {}
        note["alarms"] = [{"t": a.t, "channel": a.channel, "probe": a.probe, "sign": a.sign} for a in self.alarms]
        self.log.meta["monitor"] = note
