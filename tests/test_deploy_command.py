"""The command line of `deploy`: what is missing or wrong is one line, before anything is opened; ROS hears every row."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from fishmj import console
from fishmj.deploy import wiring
from fishmj.deploy.__main__ import COMMANDS, main
from fishmj.deploy.clock import MonotonicClock
from fishmj.deploy.links import Fishmj1Link, MishLink
from fishmj.deploy.ros import RosPublisher, battery, placed, stamp
from fishmj.deploy.servo_bus import ServoBusLink
from fishmj.deploy.swim_command import options
from fishmj.errors import ConfigError, MissingExtra
from fishmj.mjcf.description import load_robot
from tests.deploying import Bench

BAD = {
    "--link tcp://host": "expected loopback, udp",
    "--link udp://host:99999": "expected HOST",
    "--policy no-such-policy": "unknown policy",
    "--target 1": "expected X,Y",
    "--flow 0.2": "expected SPEED,DIRECTION",
    "--red 0.05": "expected X:WIDTH",
    "--link udp://127.0.0.1:9": "--camera is missing",
    "--link udp://127.0.0.1:9 --camera 0": "--calibration is missing",
    "--link serial:/dev/none --servo-ids 1,2 --camera 0": "2 numbers",
    "--link serial:/dev/none --camera shm:none --calibration nowhere.toml": "nowhere.toml",
    "--link udp://127.0.0.1:9 --camera loopback": "only with --link loopback",
    "--loopback '": "No closing quotation",
}


@pytest.mark.parametrize("words", BAD)
def test_a_bad_command_line_is_one_line_and_exit_code_2(words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = words.split() if "--policy" in words else ["--policy", "station", *words.split()]
    assert console.run(main, ["swim", *given, "--out", str(tmp_path / "swim")]) == console.BAD_INPUT
    said = capsys.readouterr().err.strip().splitlines()
    assert BAD[words] in said[-1]
    assert not (tmp_path / "swim").exists()


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_a_help(name, capsys):
    with pytest.raises(SystemExit) as stop:
        main([name, "--help"])
    assert not stop.value.code and f"fishmj deploy {name}" in capsys.readouterr().out


def test_each_link_is_the_one_that_is_named():
    robot, clock = load_robot("fish"), MonotonicClock()
    made = lambda *words: wiring.make_link(options().parse_args(["--policy", "station", *words]), robot, clock, None)
    link = made("--link", "udp://10.0.0.9:77")
    assert isinstance(link, Fishmj1Link) and (link.transport.host, link.transport.port) == ("10.0.0.9", 77)
    link = made("--link", "udp://10.0.0.9", "--protocol", "mish-fixed")
    assert isinstance(link, MishLink) and (link.transport.port, link.transport.listen) == (2333, 6060)
    link = made("--link", "serial:/dev/x", "--servo-ids", "4,5,6", "--servo-zeros-deg", "1,2,3")
    assert isinstance(link, ServoBusLink) and link.ids == (4, 5, 6)
    np.testing.assert_allclose(link.zeros, np.radians([1, 2, 3]))
    with pytest.raises(ConfigError, match="take fishmj-1"):
        args = options().parse_args(["--policy", "station", "--link", "udp://h", "--protocol", "mish-fixed"])
        wiring.make_link(args, load_robot("tendon_fish"), clock, None)


def test_a_loopback_robot_that_cannot_start_says_why(capsys, tmp_path):
    words = ["swim", "--policy", "station", "--loopback", "--fault nonsense", "--out", str(tmp_path / "swim")]
    assert console.run(main, words) == console.BAD_INPUT
    assert "does not start: unknown fault" in capsys.readouterr().err


class FakeRos:
    """`roslibpy` with a rosbridge that takes everything."""

    def __init__(self, reachable=True):
        self.published, outer = [], self

        class Ros:
            is_connected = True

            def __init__(self, host, port):
                self.where = host, port

            def run(self, timeout):
                if not reachable:
                    raise RuntimeError("refused")

            def close(self): ...

        class Topic:
            def __init__(self, client, name, kind):
                self.name, self.kind = name, kind

            def publish(self, message):
                outer.published.append((self.name, self.kind, message))

        self.module = SimpleNamespace(Ros=Ros, Topic=Topic, Message=dict)


def test_the_ros_bridge_publishes_what_the_log_takes_in(tmp_path, monkeypatch):
    fake = FakeRos()
    monkeypatch.setitem(sys.modules, "roslibpy", fake.module)
    monkeypatch.setattr("fishmj.deploy.ros.WAITING", 100_000)  # a fake clock outruns the thread
    bench = Bench(tmp_path / "swim", seconds=0.5)
    publisher = []
    bench.at(0.0, lambda: publisher.append(RosPublisher(("localhost", 9090), bench.log).__enter__()))
    bench.swim()
    publisher[0].__exit__(None, None, None)
    names = {name for name, _, _ in fake.published}
    assert names == {f"/fishmj/{name}" for name in ("pose", "joints", "commands", "battery", "state")}
    kinds = {name: kind for name, kind, _ in fake.published}
    assert kinds["/fishmj/commands"] == "sensor_msgs/JointState"
    sent = [message["position"] for name, _, message in fake.published if name == "/fishmj/commands"]
    np.testing.assert_allclose(sent[-1], bench.robot.sent[-1])
    assert bench.log.listeners == [] and publisher[0].dropped == 0


def test_a_rosbridge_that_is_not_there_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "roslibpy", FakeRos(reachable=False).module)
    with pytest.raises(ConfigError, match="no rosbridge answers"):
        RosPublisher(("localhost", 9090), SimpleNamespace(listeners=[])).__enter__()
    monkeypatch.setitem(sys.modules, "roslibpy", None)
    with pytest.raises(MissingExtra, match=r"fishmj\[ros\]"):
        RosPublisher(("localhost", 9090), SimpleNamespace(listeners=[])).__enter__()


def test_ros_messages_are_in_ros_units_and_signs():
    assert stamp(12.25) == {"sec": 12, "nanosec": 250_000_000}
    assert battery({}, 7.4, 0.5)["current"] == -0.5 and "current" not in battery({}, 7.4, None)
    turned = placed({}, SimpleNamespace(x=1.0, y=2.0, yaw=np.pi))["pose"]["orientation"]
    np.testing.assert_allclose([turned["z"], turned["w"]], [1.0, 0.0], atol=1e-12)
