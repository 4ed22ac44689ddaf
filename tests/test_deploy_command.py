"""The command line of `deploy`: what is missing or wrong is one line, before anything is opened; ROS hears every row."""

import inspect
import re
import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from absent import absent

from fishmj.base import console, interrupt
from fishmj.base.errors import ConfigError, MissingExtra, StoreError
from fishmj.deploy.__main__ import COMMANDS, main
from fishmj.deploy.commands import swim_command
from fishmj.deploy.commands.swim_command import options, target_warnings
from fishmj.deploy.link import ros
from fishmj.deploy.link.links import Fishmj1Link, MishLink
from fishmj.deploy.link.ros import TOPICS, RosPublisher, battery, placed, stamp
from fishmj.deploy.link.servo_bus_link import ServoBusLink
from fishmj.deploy.loop import wiring
from fishmj.deploy.loop.clock import MonotonicClock
from fishmj.deploy.loop.open_loop_experiment import SineGait
from fishmj.deploy.loop.supervisor import NONE, Condition, SwimState
from fishmj.deploy.loop.swim_loop import SwimOutcome
from fishmj.deploy.loopback import lockstep
from fishmj.deploy.loopback.camera_frames import FishLook
from fishmj.deploy.tracker.calibration import overhead
from fishmj.deploy.tracker.colour import PAPER_FISH
from fishmj.log import read_trial
from fishmj.log.excitation import LEAD
from fishmj.log.export import _KIND
from fishmj.log.foxglove import SCHEMAS
from fishmj.log.importers.message_sheets import KEPT
from fishmj.mjcf.description import RigSpec
from fishmj.mjcf.reading import load_robot
from studies.tracker import cases
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
    "--flow 0.1,3.14": "as it was before, would be 179.9 deg; if deg is meant, write 3.14deg",
    "--flow 0.1,180 --loopback=--flow=0.3,0": "--flow 0.1,180 beside a loopback robot in a stream of 0.3,0",
    "--flow 0.1,180": "--flow 0.1,180 beside a loopback robot in a stream of 0,0",
    "--link udp://127.0.0.1:9 --camera 0 --tag-mount 0.06,0": "expected X,Y,YAW such as 0,0,90",
    "--servo-ids 4,5,6": "--servo-ids has an effect with --link serial:DEVICE or --protocol servo-bus only",
    "--link udp://127.0.0.1:9 --baud 115200": "--baud has an effect with --link serial:DEVICE",
    "--link serial:/dev/none --protocol mish-fixed": "--protocol has an effect with --link udp://HOST or loopback only",
    "--link loopback --loopback=--protocol=servo-bus": "--loopback: --protocol is an option of deploy swim itself: give it",
    "--link loopback --loopback=--model=fish": "--loopback: --model is an option of deploy swim itself, --robot: give it",
    "--link loopback --loopback=--parent=1": "--loopback: --parent is set by deploy swim: leave it out",
    "--link udp://127.0.0.1:9 --loopback=--seed": "--loopback has an effect with --link loopback only",
    "--link udp://127.0.0.1:9 --tracker colour --tag-size 0.1": "--tag-size has an effect with --tracker tag only",
    "--link udp://127.0.0.1:9 --paint-height 0": "--paint-height has an effect with --tracker colour only",
    "--tag-number 3": "--tag-number has an effect with a camera other than the loopback's",
}


@pytest.mark.parametrize(
    ("words", "flow"),
    [("--flow 0.1,180", (0.1, np.pi)), ("--seed 3 --flow=0.1,-3deg", (0.1, -np.pi / 60)), ("--seed 3", (0.0, 0.0))],
)
def test_a_log_states_the_stream_of_its_loopback_robot(words, flow):
    given = ["--policy", "station", "--link", "loopback", "--loopback", words]
    assert wiring.parsed(options(), given).flow == pytest.approx(flow)


@pytest.mark.parametrize("words", BAD)
def test_a_bad_command_line_is_one_line_and_exit_code_2(words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = words.split() if "--policy" in words else ["--policy", "station", *words.split()]
    assert console.run(main, ["swim", *given, "--out", str(tmp_path / "swim")]) == console.BAD_INPUT
    said = capsys.readouterr().err.strip().splitlines()
    assert BAD[words] in said[-1]
    assert not (tmp_path / "swim").exists()


@pytest.mark.parametrize("cause", [Condition.OPERATOR_STOP, NONE])
def test_an_interrupted_swim_says_so_before_its_end(cause, monkeypatch, tmp_path):
    said: list[str] = []
    for say in ("say", "warn"):
        monkeypatch.setattr(console, say, lambda *lines: said.extend(lines))
    ended = SwimOutcome(cause=cause, refused=("no pose",), swim_seconds=3.0, figures={})
    monkeypatch.setattr(swim_command, "_swum", lambda *_: ended)
    monkeypatch.setattr(interrupt, "asked", lambda: True)
    assert swim_command.main(["--policy", "station", "--out", str(tmp_path / "a")]) == console.INTERRUPTED
    kept = f"what was swum is in {tmp_path / 'a'}" if cause else "nothing was swum"
    assert said[-2:-1] == [f"interrupted; {kept}; another swim needs another --out"] and ended.words in said[-1]


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
    assert made("--link", "udp://10.0.0.9").transport.port == 2334
    link = made("--link", "udp://10.0.0.9", "--protocol", "mish-fixed")
    assert isinstance(link, MishLink) and (link.transport.port, link.transport.listen) == (2333, 6060)
    link = made("--link", "serial:/dev/x", "--servo-ids", "4,5,6", "--servo-zeros-deg", "1,2,3")
    assert isinstance(link, ServoBusLink) and link.ids == (4, 5, 6)
    np.testing.assert_allclose(link.zeros, np.radians([1, 2, 3]))
    with pytest.raises(ConfigError, match="take fishmj-1"):
        args = options().parse_args(["--policy", "station", "--link", "udp://h", "--protocol", "mish-fixed"])
        wiring.make_link(args, load_robot("tendon_fish"), clock, None)


def test_the_help_says_the_ports_that_a_link_without_one_goes_to(capsys):
    with pytest.raises(SystemExit):
        main(["swim", "--help"])
    said = " ".join(capsys.readouterr().out.split())
    assert "default port 2334; of mish 2333" in said and "udp://192.168.1.40 --camera" in said


def test_tracked_paint_matches_the_bands_on_the_drawn_loopback_fish():
    args = options().parse_args(["--policy", "station", "--tracker", "colour"])
    assert wiring.make_tracker(args, overhead((1280, 720), 0.0028, 3.0)).paint == PAPER_FISH == cases.PAINT
    look = FishLook.of("fish", "colour")
    for drawn, bands in ((look.head, PAPER_FISH.head), (look.neck, PAPER_FISH.neck)):
        half = drawn[: len(drawn) // 2]
        for x, width in bands:
            assert 2 * np.interp(x, half[:, 0], half[:, 1]) == pytest.approx(
                width, abs=3e-3
            )  # a ruler; 20 mm would be another fish


def test_paint_comes_from_the_rig_and_an_unpainted_head_is_asked_for():
    shipped, camera = load_robot("tendon_fish"), overhead((1280, 720), 0.0028, 3.0)
    read = lambda *words: options().parse_args(["--policy", "station", "--tracker", "colour", *words])
    red, yellow = ((0.08, 0.05), (0.16, 0.03)), ((-0.02, 0.05), (0.03, 0.06))
    with pytest.raises(ConfigError, match="tendon_fish does not say where it is painted; write red and yellow"):
        wiring.make_tracker(read(), camera, shipped)
    painted = replace(shipped, rig=RigSpec(red=red, yellow=yellow, paint_height=-0.01))
    tracker = wiring.make_tracker(read(), camera, painted)
    assert (tracker.paint.head, tracker.paint.neck, tracker.height) == (red, yellow, -0.01)
    look = FishLook.of(painted, "colour")
    assert (look.head[:2] == np.array(red) * [1.0, 0.5]).all() and look.height == -0.01
    assert wiring.make_tracker(read("--red", "0.09:0.05,0.15:0.03"), camera, painted).paint.head[0] == (0.09, 0.05)


BANDS = {
    "0.09:0.05,0.5:0.03": "paint at x = 0.5 m; the head link of tendon_fish lies from",
    "-0.5:0.05,0.1:0.03": "paint at x = -0.5 m",
    "0.09:0.3,0.15:0.03": "paint of 0.3 m at x = 0.09 m; tendon_fish is",
}


@pytest.mark.parametrize("red", BANDS)
def test_paint_off_the_head_link_is_refused(red):
    given = options().parse_args(["--policy", "station", "--tracker", "colour", f"--red={red}", "--yellow=-0.02:0.05,0.03:0.06"])
    camera = overhead((1280, 720), 0.0028, 3.0)
    with pytest.raises(ConfigError, match=BANDS[red]):
        wiring.make_tracker(given, camera, "tendon_fish")
    bands = tuple(tuple(map(float, row.split(":"))) for row in red.split(","))
    painted = replace(load_robot("tendon_fish"), rig=RigSpec(red=bands, yellow=((-0.02, 0.05), (0.03, 0.06))))
    with pytest.raises(ConfigError, match=r"\[rig\] red: (got )?paint"):
        wiring.make_tracker(options().parse_args(["--policy", "station", "--tracker", "colour"]), camera, painted)


def test_a_zero_beyond_the_travel_of_the_servo_is_refused():
    words = ["--policy", "station", "--link", "serial:/dev/x", "--servo-zeros-deg", "0,-70"]
    with pytest.raises(ConfigError, match="a zero of 70 deg and commands of .-60 deg; a servo of lx turns .-120 deg"):
        wiring.make_link(options().parse_args(words), load_robot("tendon_fish"), MonotonicClock(), None)


def test_servo_numbers_are_refused_before_the_loopback_robot_starts(monkeypatch):
    monkeypatch.setattr(wiring, "_loopback", lambda *_: pytest.fail("the loopback robot was started"))
    words = ["--policy", "station", "--link", "loopback", "--protocol", "servo-bus", "--servo-ids", "7,7,8"]
    with ExitStack() as stack, pytest.raises(ConfigError, match="two servos of one number"):
        wiring.wire(options().parse_args(words), load_robot("fish"), stack)


def test_a_trial_that_is_there_is_refused_before_anything_is_opened(tmp_path, capsys):
    opened = lambda *_: pytest.fail("the robot was opened")
    words = ["--gait", "1,10,60", "--link", "loopback", "--out", str(tmp_path)]
    with pytest.raises(StoreError, match="exists; choose another name"):
        swim_command.main(words, opened)


def test_the_servo_bus_of_two_joints_asks_for_two_servos():
    robot, clock = load_robot("tendon_fish"), MonotonicClock()
    words = ["--policy", "station", "--link", "serial:/dev/x"]
    assert wiring.make_link(options().parse_args(words), robot, clock, None).ids == (1, 2)
    rig = RigSpec(bus="dynamixel-x", servo_ids=(8, 3), signs=(-1, 1), zeros=(0.1, 0.0), baud=2_000_000)
    link = wiring.make_link(options().parse_args(words), replace(robot, rig=rig), clock, None)
    assert (link.name, link.ids, link.signs, link.zeros, link.baud) == ("dynamixel-x-bus", (8, 3), (-1, 1), (0.1, 0.0), 2_000_000)
    link = wiring.make_link(options().parse_args([*words, "--servo-ids", "5,6"]), replace(robot, rig=rig), clock, None)
    assert link.ids == (5, 6)
    with pytest.raises(ConfigError, match="a servo bus is a line; take serial:DEVICE or loopback"):
        args = options().parse_args(["--policy", "station", "--link", "udp://h", "--protocol", "servo-bus"])
        wiring.make_link(args, robot, clock, None)


def test_a_target_where_the_fish_may_not_swim_or_is_not_seen_is_warned_of():
    camera = overhead((1280, 720), 0.0028, 3.0, distortion=cases.LENS)  # sees 3.6 by 2 m
    assert target_warnings((0.5, -0.8), 2.0, camera) == [] == target_warnings((0.0, 0.0), 2.0, None)
    assert ["beyond --bound 2" in told for told in target_warnings((2.5, 0.0), 2.0, None)] == [True]
    for place in ((0.0, 1.3), (1.99, 0.0), (40.0, -40.0)):
        assert "outside of the camera's picture" in target_warnings(place, 100.0, camera)[0]


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
    monkeypatch.setattr("fishmj.deploy.link.ros.WAITING", 100_000)  # a fake clock outruns the thread
    bench = Bench(tmp_path / "swim", seconds=0.5)
    publisher = []
    bench.at(0.0, lambda: publisher.append(RosPublisher(("localhost", 9090), bench.log).__enter__()))
    bench.swim()
    publisher[0].__exit__(None, None, None)
    names = {name for name, _, _ in fake.published}
    assert names == {f"/fishmj/{name}" for name in ("pose", "joints", "commands", "battery", "state")}
    kinds = {name: kind for name, kind, _ in fake.published}
    assert kinds["/fishmj/commands"] == "sensor_msgs/msg/JointState"
    sent = [message["position"] for name, _, message in fake.published if name == "/fishmj/commands"]
    np.testing.assert_allclose(sent[-1], bench.robot.sent[-1])
    assert bench.log.listeners == [] and publisher[0].dropped == 0


def test_a_rosbridge_that_is_not_there_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "roslibpy", FakeRos(reachable=False).module)
    with pytest.raises(ConfigError, match="no rosbridge answers"):
        RosPublisher(("localhost", 9090), SimpleNamespace(listeners=[])).__enter__()
    absent(monkeypatch, "roslibpy")
    with pytest.raises(MissingExtra, match=r"fishmj\[ros\]"):
        RosPublisher(("localhost", 9090), SimpleNamespace(listeners=[])).__enter__()


def test_ros_messages_are_in_ros_units_and_signs():
    assert stamp(12.25) == {"sec": 12, "nanosec": 250_000_000}
    assert battery({}, 7.4, 0.5)["current"] == -0.5 and "current" not in battery({}, 7.4, None)
    turned = placed({}, SimpleNamespace(x=1.0, y=2.0, yaw=np.pi))["pose"]["orientation"]
    np.testing.assert_allclose([turned["z"], turned["w"]], [1.0, 0.0], atol=1e-12)


def test_a_gait_swims_without_a_policy_and_meta_says_its_numbers(tmp_path, capsys):
    words = ["--gait", "1,15,60,-5", "--link", "loopback", "--seconds", "3", "--loopback", "--body structured"]
    words += ["--out", str(tmp_path / "swim")]
    assert swim_command.main(words, lockstep.wired) == console.OK
    trial = read_trial(tmp_path / "swim")
    cmd = trial.tables["cmd"]
    beating = cmd["state"] == int(SwimState.SWIMMING)
    t, sent = cmd["t"][beating], np.stack([cmd[f"c{k + 1}"][beating] for k in range(3)], 1)
    phase = 2 * np.pi * (t - t[0] - LEAD)
    wanted = np.radians(15) * np.sin(phase[:, None] - np.radians(60) * np.arange(3)) + np.radians(-5)
    steady = t - t[0] > LEAD + 1.0
    assert steady.sum() > 50
    np.testing.assert_allclose(sent[steady], wanted[steady], atol=np.radians(1.0))
    meta = trial.meta
    assert (meta["excitation"], meta["controller"], meta["policy_sha256"]) == ("sine_gait_1_15_60_-5", "open loop", "")
    assert meta["gait"] == {"frequency": 1.0, "amplitude_deg": 15.0, "lag_deg": 60.0, "bias_deg": -5.0}
    assert meta["host"]["opened"] == {"link": "loopback", "camera": "", "loopback": "--body structured"}
    assert meta["host"]["link"]["packets"] > 0  # the counts stand beside the address


@pytest.mark.parametrize(
    ("words", "told"),
    {
        "": "one of --policy NAME and --gait",
        "--policy station --gait 1,20,60": "not allowed with",
        "--gait 1,20": "expected HZ,AMPLITUDE_DEG,LAG_DEG",
        "--gait 0,20,60": "0 Hz; expected above 0",
        "--gait 25,0.1,60": "below 25 Hz",
        "--gait 1,0,60": "amplitude 0 deg; expected above 0",
        "--gait 1,50,60,-11": "reach 61 deg, the servos of",
        "--gait 3,20,60": "turns at 6.58 rad/s",
        "--gait 1,nan,60": "--gait",
        "--gait 1,20,60 --target 0.3,0": "--target is for --policy",
        "--gait 1,20,60 --anyway": "--anyway is for --policy",
    }.items(),
)
def test_a_gait_that_cannot_be_is_refused_in_one_line(words, told, tmp_path, capsys):
    assert console.run(main, ["swim", *words.split(), "--out", str(tmp_path / "swim")]) == console.BAD_INPUT
    assert told in capsys.readouterr().err.strip().splitlines()[-1] and not (tmp_path / "swim").exists()


def test_a_gait_beats_each_joint_of_any_fish_at_its_own_ticks():
    robot = load_robot("tendon_fish")
    robot = replace(robot, timing=replace(robot.timing, bus_dt=0.01))
    commands = SineGait(1.0, 10.0, 90.0).commands(robot, 3.0)
    assert commands.shape == (360, robot.n_joints)
    np.testing.assert_allclose(commands[60 + 225], np.radians([10.0, 0.0]), atol=1e-9)  # 2.25 s: a quarter of a beat
    with pytest.raises(ConfigError, match="finite numbers"):
        SineGait(1.0, float("nan"), 60.0).commands(robot, 3.0)


def test_the_page_on_ros_lists_each_topic_and_type_both_ways():
    page = (Path(__file__).resolve().parent.parent / "docs" / "tank" / "ros.md").read_text(encoding="utf-8")
    assert dict(re.findall(r"\| `/fishmj/(\w+)` \| `([\w/]+)` \|", page)) == TOPICS
    rows = [line.split("|")[1] for line in page.splitlines() if re.match(r"\| `\w+_msgs/msg/", line)]
    listed = set()
    for row in rows:
        package = re.match(r" `(\w+)/msg/", row)[1]
        listed |= {f"{package}/msg/{name.removeprefix(f'{package}/msg/')}" for name in re.findall(r"`([\w/]+)`", row)}
    assert listed == KEPT
    exported = {topic for topic in _KIND if f"`{topic}`" in page}
    assert exported == set(_KIND) and all(f"`{schema}`" in page for schema in SCHEMAS)
    assert not re.search(r"\.(subscribe|advertise)\(|Service\(", inspect.getsource(ros))
