"""The loopback robot in real time: a process of its own behind UDP on 127.0.0.1 or a serial line, its camera in shared memory.

    {"robot_port": 2333, "host_port": 0, "protocol": "fishmj-1", "frames": "psm_1a2b3c", "size": [1280, 720],
     "frame_rate": 50.0, "pid": 7, "device": null}

is the line that `serve` prints when it is ready. With the protocol servo-bus the ports are null and `device` is a
pseudo-terminal, the servos' line. Telemetry goes to the sender of the last datagram, or to `host_port` before the first one. One
thread keeps the robot's clock with the machine's monotonic clock, another draws frames while their latency runs. Both run before
other programs if the system permits it, since a robot and its camera keep time on a busy computer too.
"""

import contextlib
import os
import queue
import select
import socket
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import floor
from typing import Any

from fishmj.base import console, interrupt
from fishmj.base.errors import ConfigError, FishmjError
from fishmj.base.options import number, setting, whole
from fishmj.deploy.loop.clock import first_in_line
from fishmj.deploy.loopback.bodies import SOLVER
from fishmj.deploy.loopback.camera import CameraFrame
from fishmj.deploy.loopback.loopback_body import MILLISECOND
from fishmj.deploy.loopback.loopback_settings import LoopbackSettings, artist_of, calibration_of, make_robot
from fishmj.deploy.loopback.robot import LoopbackRobot
from fishmj.deploy.loopback.shared_frames import FrameWriter
from fishmj.deploy.protocols import PROTOCOLS, SERVO_BUS, mish

LOCAL, PORT = "127.0.0.1", whole(0, 65535)
LONGEST = 2048  # bytes of a datagram that is looked at
MOST = 200  # datagrams that are taken in one turn
BEHIND = 0.5  # s; whoever is further behind the clock sets it back instead of catching up
LOOK = 0.25  # s between two looks whether the parent is there
WAITING = 8  # frames that may wait to be drawn
CLOCK, DRAWING = 8, 4  # priorities, below that of a host's loop
SWITCH = 5e-4  # s that the drawing thread may keep the clock's thread waiting, where it holds the interpreter


@dataclass(frozen=True, kw_only=True)
class ServeOptions:
    """Options of the server.

    Attributes:
        port, host_port: 0 lets the system choose. camera: True to draw frames.
    """

    settings: LoopbackSettings = LoopbackSettings()
    port: int | None = setting(None, PORT, "of the robot; default 2333 of mish, else the system's choice")
    host_port: int | None = setting(None, PORT, "of the host, before it has sent anything; default 6060 of mish, else none")
    camera: bool = setting(True, None, "draw no frames")
    seconds: float | None = setting(None, number(0.1, 1e6), "end after this time; default never")
    parent: int | None = setting(None, whole(1, 2**31), "end with this process (default: none)", metavar="PID")

    def __post_init__(self):
        if self.settings.body == SOLVER:
            raise ConfigError("loopback: the flow solver is slower than real time; it runs in lockstep only")
        for name in ("port", "host_port"):
            value = getattr(self, name)
            if value is not None and not 0 <= value <= 65535:
                raise ConfigError(f"loopback: {name} = {value}; expected 0 to 65535")


class UdpPort:
    """A socket on 127.0.0.1. port: of the robot, 0 lets the system choose; host_port: of a silent host, 0 for none."""

    def __init__(self, port: int, host_port: int):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self.socket.bind((LOCAL, port))
        except OSError as error:
            self.socket.close()
            raise ConfigError(f"loopback: port {port} of {LOCAL}: {error.strerror or error}; does another robot run?") from error
        self.socket.setblocking(False)
        self.port, self.peer = self.socket.getsockname()[1], (LOCAL, host_port) if host_port else None
        self._host_port = host_port

    @classmethod
    def of(cls, options: ServeOptions) -> "UdpPort":
        """Opens the port in the options. Raises ConfigError: it is taken."""
        is_mish = options.settings.protocol != PROTOCOLS[0]
        port = (mish.ROBOT_PORT if is_mish else 0) if options.port is None else options.port
        return cls(port, (mish.HOST_PORT if is_mish else 0) if options.host_port is None else options.host_port)

    def connection(self) -> dict:
        """Ports for the host."""
        return {"robot_port": self.port, "host_port": self._host_port}

    def fileno(self) -> int:
        """File descriptor for `select`."""
        return self.socket.fileno()

    def receive(self) -> list[bytes]:
        """The waiting datagrams."""
        found: list[bytes] = []
        while len(found) < MOST:
            try:
                data, self.peer = self.socket.recvfrom(LONGEST)
            except OSError:  # nothing more, or an earlier datagram of ours found nobody
                break
            found.append(data)
        return found

    def send(self, data: bytes) -> bool:
        """Sends a datagram to the host; returns False while the host is unknown. Raises OSError: the system did not take it."""
        if self.peer is None:
            return False
        self.socket.sendto(data, self.peer)
        return True

    def close(self) -> None:
        """Closes the socket; may be called twice."""
        self.socket.close()


class SerialPort:
    """A pseudo-terminal in place of a USB adapter: the host opens `device`. Raises ConfigError: this system has none."""

    def __init__(self) -> None:
        try:
            import pty
            import tty
        except ImportError:
            raise ConfigError(f"loopback: {SERVO_BUS} needs pseudo-terminals, which this system does not have") from None
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.device = os.ttyname(self._slave)

    def connection(self) -> dict:
        """Device for the host."""
        return {"device": self.device}

    def fileno(self) -> int:
        """File descriptor for `select`."""
        return self._master

    def receive(self) -> list[bytes]:
        """The waiting bytes, as one piece."""
        try:
            data = os.read(self._master, LONGEST)
        except OSError:  # nothing there
            return []
        return [data] if data else []

    def send(self, data: bytes) -> bool:
        """Sends bytes to the host. Raises OSError: the host does not read, and the line is full."""
        os.write(self._master, data)
        return True

    def close(self) -> None:
        """Closes the line; may be called twice."""
        for handle in (self._master, self._slave):
            if handle >= 0:
                os.close(handle)
        self._master = self._slave = -1


class LoopbackServer:
    """A robot, its line to the host and its ring of frames.

    Attributes:
        figures: turns, datagrams in and out, frames and late and dropped ones, the robot's seconds lost and its largest lag, s;
            after `run` its seconds and the share of a core that it took.
    """

    def __init__(self, options: ServeOptions, clock: Callable[[], float] = time.monotonic):
        self.options, self.clock = options, clock
        settings = options.settings
        self.figures: dict[str, float] = dict.fromkeys(
            ("turns", "received", "sent", "refused", "frames", "late_frames", "dropped_frames", "lost", "lag"), 0
        )
        self.robot, self.ring = self._warmed(settings), None
        self.line: UdpPort | SerialPort = SerialPort() if settings.protocol == SERVO_BUS else UdpPort.of(options)
        self._jobs: queue.Queue[CameraFrame] = queue.Queue(WAITING)
        self._artist: Any = None
        self._drawn: float | None = None  # s, the scene of `_image`
        self._image: Any = None
        self._painter: threading.Thread | None = None
        self._failed: FishmjError | None = None
        self._over = threading.Event()
        try:
            if options.camera:
                self._artist = artist_of(settings)
                width, height = calibration_of(settings).size
                self.ring = FrameWriter(width, height, settings.frame_rate)
                self._artist.draw((0.0, 0.0, 0.0), [0.0] * self.robot.body.robot.n_joints, 0.0)
        except FishmjError:
            self.close()
            raise
        self.start = self.clock()

    @staticmethod
    def _warmed(settings: LoopbackSettings) -> LoopbackRobot:
        """The robot, built after another one has loaded the machine code."""
        make_robot(replace(settings, faults=())).advance(0.1)
        return make_robot(settings)

    def connection(self) -> dict:
        """Connection data for a host."""
        size = list(calibration_of(self.options.settings).size) if self.ring else None
        return {
            **dict.fromkeys(("robot_port", "host_port", "device")), **self.line.connection(),
            "protocol": self.options.settings.protocol, "frames": self.ring.name if self.ring else None, "size": size,
            "frame_rate": self.options.settings.frame_rate, "pid": os.getpid(),
        }  # fmt: skip

    def run(self, stop: Callable[[], bool] = lambda: False) -> None:
        """Serves until `stop` returns True, the time is over, or the parent is gone."""
        self.start, looked, used = self.clock(), -LOOK, time.process_time()
        begun = self.start
        if self.ring:
            self._painter = threading.Thread(target=self._paint, name="frames", daemon=True)
            self._painter.start()
        while not stop():
            now = self.clock() - self.start
            if self.options.seconds is not None and now >= self.options.seconds:
                break
            if self.options.parent is not None and now - looked >= LOOK:
                if os.getppid() != self.options.parent:
                    break
                looked = now
            if self._failed is not None:
                raise self._failed
            self.turn(now)
            ahead = self.robot.next_event() - (self.clock() - self.start)
            if ahead > 0.0:
                select.select([self.line], [], [], min(ahead, LOOK))
        self.figures["seconds"] = self.clock() - begun
        self.figures["cpu_share"] = (time.process_time() - used) / max(self.figures["seconds"], 1e-9)

    def turn(self, now: float) -> None:
        """Advances the robot to `now` [s since the start], passes it the input, sends its output."""
        lag = now - self.robot.next_event()
        self.figures["lag"] = max(self.figures["lag"], lag)
        if lag > BEHIND:  # a machine that slept, or a body that is too slow: the robot's clock stands still meanwhile
            self.start += lag
            self.figures["lost"] += lag
            now -= lag
        self.figures["turns"] += 1
        arrived = self.robot.advance_to(max(floor(now / MILLISECOND) * MILLISECOND, self.robot.time))
        incoming = self.line.receive()
        self.figures["received"] += len(incoming)
        for data in incoming:
            self.robot.receive(data)
        for arrival in arrived:
            self._send(arrival.data)
        for frame in self.robot.camera.exposed():
            if self.ring:
                self._hand_over(frame)

    def close(self) -> None:
        """Closes the line and the shared memory; may be called twice."""
        if self._painter is not None:
            painter, self._painter = self._painter, None
            self._over.set()
            painter.join()
        self.line.close()
        if self.ring:
            self.ring.close()
            self.ring = None

    def _send(self, data: bytes) -> None:
        try:
            self.figures["sent"] += self.line.send(data)
        except OSError:
            self.figures["refused"] += 1

    def _hand_over(self, frame: CameraFrame) -> None:
        try:
            self._jobs.put_nowait(frame)
        except queue.Full:
            self.figures["dropped_frames"] += 1

    def _paint(self) -> None:
        """Thread that draws each frame, and publishes it when it is due."""
        try:
            with first_in_line(DRAWING):
                while not self._over.is_set():
                    with contextlib.suppress(queue.Empty):
                        frame = self._jobs.get(timeout=LOOK)
                        if self.clock() - self.start > frame.readable and not self._jobs.empty():
                            self.figures["dropped_frames"] += 1  # a slow machine shows fewer frames, not older ones
                        else:
                            self._show(frame)
        except FishmjError as error:
            self._failed = error

    def _show(self, frame: CameraFrame) -> None:
        if self.ring is None:
            return
        if frame.drawn != self._drawn:
            self._drawn, self._image = frame.drawn, self._artist.draw(frame.pose[:3], frame.pose[3:], frame.drawn)
        left = self.start + frame.readable - self.clock()
        if left > 0.0:
            time.sleep(left)
        self.figures["late_frames"] += left < -MILLISECOND
        self.ring.write(self._image, self.start + frame.t)
        self.figures["frames"] += 1


def serve(options: ServeOptions) -> dict[str, float]:
    """Serves in real time until Ctrl-C, the end of the time, or of the parent; prints the line above first. Returns the figures.

    Raises ConfigError: a port that is taken, a body that is too slow.
    """
    before = sys.getswitchinterval()
    server = LoopbackServer(options)
    sys.setswitchinterval(SWITCH)
    try:
        with interrupt.raising(), interrupt.finishing(lambda: ""), first_in_line(CLOCK):
            console.emit_json(server.connection())
            server.run(interrupt.asked)
    except KeyboardInterrupt:
        pass  # the usual way to end it
    finally:
        server.close()
        sys.setswitchinterval(before)
    return server.figures
