"""Transports of bytes between host and robot: a UDP socket, a serial line. Links put protocols on top."""

import socket
import threading
from collections import deque
from typing import Any, Protocol

from fishmj.base.errors import ConfigError, StoreError
from fishmj.deploy.loop.clock import HEARING, Clock, first_in_line

LONGEST = 2048  # bytes of a datagram that is looked at; no protocol here sends more than a few hundred
KEPT = 1000  # datagrams that may wait unread: 20 s of telemetry


class Transport(Protocol):
    """Interface of a datagram transport; no call waits."""

    def open(self) -> None:
        """Opens the socket or line. Raises ConfigError if it is not available."""

    def send(self, data: bytes) -> None:
        """Sends one datagram now; one that the network refuses is lost, as on any radio."""

    def receive(self) -> list[tuple[float, bytes]]:
        """Datagrams since the last call, each with its time of arrival on the host's clock, s."""

    def close(self) -> None:
        """Closes the socket or line; may be called twice."""


class UdpTransport:
    """Datagrams to one address. A thread receives them, so that each is stamped on arrival and not at the next tick.

    Args:
        host, port: of the robot. listen: port of this computer that the robot sends to; 0 lets the system choose.

    Attributes:
        refused: datagrams that the system did not take. foreign: datagrams from another address, which are ignored.
    """

    def __init__(self, host: str, port: int, clock: Clock, listen: int = 0):
        self.host, self.port, self.clock, self.listen = host, port, clock, listen
        self.refused = self.foreign = 0
        self._heard: deque[tuple[float, bytes]] = deque(maxlen=KEPT)
        self._socket: socket.socket | None = None
        self._thread: threading.Thread | None = None
        self._open = threading.Event()

    def open(self) -> None:
        """Binds the socket and starts to listen. Raises ConfigError: no such host, or the port of this computer is taken."""
        try:
            self._address = socket.getaddrinfo(self.host, self.port, socket.AF_INET, socket.SOCK_DGRAM)[0][4]
            made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            made.bind(("", self.listen))
        except OSError as error:
            there = f"udp://{self.host}:{self.port} (listening on port {self.listen})"
            raise ConfigError(
                f"{there}: {error.strerror or error}; is the host right, or another program on that port?"
            ) from error
        made.settimeout(0.1)
        self._socket = made
        self._open.set()
        self._thread = threading.Thread(target=self._listen, args=(made,), name="udp", daemon=True)
        self._thread.start()

    def _listen(self, opened: socket.socket) -> None:
        with first_in_line(HEARING):
            while self._open.is_set():
                try:
                    data, sender = opened.recvfrom(LONGEST)
                except TimeoutError:
                    continue
                except OSError:  # closed, or the robot's port is not open yet
                    continue
                if sender[0] == self._address[0]:
                    self._heard.append((self.clock.now(), data))
                else:
                    self.foreign += 1

    def send(self, data: bytes) -> None:
        """Sends one datagram now; counts one that the system refuses."""
        if self._socket is not None:
            try:
                self._socket.sendto(data, self._address)
            except OSError:
                self.refused += 1

    def receive(self) -> list[tuple[float, bytes]]:
        """Datagrams since the last call, each with its time of arrival, s."""
        return [self._heard.popleft() for _ in range(len(self._heard))]

    def close(self) -> None:
        """Stops to listen and closes the socket."""
        self._open.clear()
        if self._thread is not None:
            self._thread.join(1.0)
        if self._socket is not None:
            self._socket.close()
        self._socket = self._thread = None


def open_serial(device: str, timeout: float, baud: int) -> Any:
    """Opens a serial line of 8N1, as `serial.Serial`; reads give up after `timeout` s.

    Raises MissingExtra: pyserial is not installed; ConfigError: no such device, or no permission to open it.
    """
    import serial

    try:
        return serial.Serial(device, baud, timeout=timeout, write_timeout=timeout, exclusive=True)
    except (serial.SerialException, ValueError) as error:
        listed = ", ".join(serial_devices()) or "none"
        raise ConfigError(f"serial:{device}: {str(error)[:200]}; devices here: {listed}") from error


def serial_devices() -> list[str]:
    """Serial devices of this computer.

    Raises StoreError: the system cannot list them. MissingExtra: pyserial is not installed.
    """
    from serial.tools import list_ports

    try:
        return [port.device for port in list_ports.comports()]
    except OSError as error:
        raise StoreError(f"serial devices: cannot be listed: {error.strerror or error}") from error
