"""A bridge to ROS 2 over rosbridge, behind the extra `ros`: the host's inputs and outputs as standard messages.

    /fishmj/pose        geometry_msgs/msg/PoseStamped    accepted fixes, frame `tank`
    /fishmj/joints      sensor_msgs/msg/JointState       measured joint angles
    /fishmj/commands    sensor_msgs/msg/JointState       commands as sent
    /fishmj/battery     sensor_msgs/msg/BatteryState     voltage and current
    /fishmj/state       std_msgs/msg/String              the supervisor's changes

It only publishes: no ROS message moves the fish. A thread publishes, so a slow bridge delays no tick; messages that it cannot
take in time are dropped and counted. Stamps are wall-clock time.
"""

import queue
import threading
import time
from math import cos, sin
from typing import Any

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.deploy.loop.observation import Pose
from fishmj.deploy.loop.supervisor import Event, named
from fishmj.deploy.loop.trial_log import TrialLog
from fishmj.deploy.loop.watch import supply
from fishmj.deploy.protocols.messages import Telemetry

TOPICS = {
    "pose": "geometry_msgs/msg/PoseStamped",
    "joints": "sensor_msgs/msg/JointState",
    "commands": "sensor_msgs/msg/JointState",
    "battery": "sensor_msgs/msg/BatteryState",
    "state": "std_msgs/msg/String",
}
WAITING = 200  # messages that may wait
CONNECT = 5.0  # s
UNKNOWN = 0  # of BatteryState: status, health and technology are not told
Message = dict[str, Any]


class RosPublisher:
    """Context manager that publishes the rows of a log.

    Args:
        address: host and port of the rosbridge. log: its rows are published, too.

    Attributes:
        sent, dropped: numbers of messages.

    Raises (on entering):
        MissingExtra: roslibpy is not installed. ConfigError: no rosbridge answers.
    """

    def __init__(self, address: tuple[str, int], log: TrialLog):
        self.address, self.log, self.sent, self.dropped = address, log, 0, 0
        self._offset = time.time() - time.monotonic()
        self._queue: queue.Queue[tuple[str, Message] | None] = queue.Queue(WAITING)
        self._thread: threading.Thread | None = None

    def __enter__(self) -> "RosPublisher":
        import roslibpy

        host, port = self.address
        self._client = roslibpy.Ros(host=host, port=port)
        try:
            self._client.run(timeout=CONNECT)
        except Exception as error:  # noqa: BLE001  roslibpy raises what its network layer raises
            self._client.close()
            raise ConfigError(
                f"--ros {host}:{port}: no rosbridge answers ({str(error)[:100]}); start rosbridge_websocket"
            ) from error
        self._topics = {name: roslibpy.Topic(self._client, f"/fishmj/{name}", kind) for name, kind in TOPICS.items()}
        self._thread = threading.Thread(target=self._publish, name="ros", daemon=True)
        self._thread.start()
        self.log.listeners.append(self)
        return self

    def __exit__(self, kind, error, trace) -> None:
        self.log.listeners.remove(self)
        if self._thread is not None:
            try:
                self._queue.put(None, timeout=1.0)
            except queue.Full:  # the bridge hangs: the thread is a daemon
                pass
            self._thread.join(2.0)
        self._client.close()

    def command(self, t: float, joint: np.ndarray) -> None:
        """Publishes a sent command."""
        self._put("commands", joints(self._stamp(t), joint))

    def heard(self, t: float, packet: Telemetry) -> None:
        """Publishes a received packet."""
        self._put("joints", joints(self._stamp(t), packet.joint))
        if (volts := supply(packet)) is not None:
            self._put("battery", battery(self._stamp(t), volts, packet.current))

    def fix(self, pose: Pose) -> None:
        """Publishes an accepted fix."""
        self._put("pose", placed(self._stamp(pose.t), pose))

    def event(self, event: Event) -> None:
        """Publishes a change of state."""
        self._put("state", {"data": f"{event.after.name}: {named(event.because)}"})

    def _stamp(self, t: float) -> Message:
        return stamp(t + self._offset)

    def _put(self, name: str, message: Message) -> None:
        try:
            self._queue.put_nowait((name, message))
        except queue.Full:
            self.dropped += 1

    def _publish(self) -> None:
        import roslibpy

        while (entry := self._queue.get()) is not None:
            name, message = entry
            if self._client.is_connected:
                self._topics[name].publish(roslibpy.Message(message))
                self.sent += 1
            else:
                self.dropped += 1


def stamp(seconds: float) -> Message:
    """builtin_interfaces/Time of a time in s since 1970."""
    whole = int(seconds // 1)
    return {"sec": whole, "nanosec": int((seconds - whole) * 1e9)}


def joints(at: Message, angles: Any) -> Message:
    """sensor_msgs/msg/JointState of angles (J,) rad."""
    values = [float(angle) for angle in angles]
    names = [f"j{k + 1}" for k in range(len(values))]
    return {"header": {"stamp": at, "frame_id": "fish"}, "name": names, "position": values, "velocity": [], "effort": []}


def placed(at: Message, pose: Pose) -> Message:
    """geometry_msgs/msg/PoseStamped in the frame `tank`."""
    turn = {"x": 0.0, "y": 0.0, "z": sin(pose.yaw / 2), "w": cos(pose.yaw / 2)}
    place = {"x": float(pose.x), "y": float(pose.y), "z": 0.0}
    return {"header": {"stamp": at, "frame_id": "tank"}, "pose": {"position": place, "orientation": turn}}


def battery(at: Message, volts: float, amperes: float | None) -> Message:
    """sensor_msgs/msg/BatteryState; a current that drains is negative there."""
    state = {"voltage": float(volts), "present": True, "power_supply_technology": UNKNOWN}
    current = {} if amperes is None else {"current": -float(amperes)}
    return {"header": {"stamp": at, "frame_id": "fish"}, **state, **current}
