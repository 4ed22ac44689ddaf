"""The loopback robot behind UDP: on this machine only, in real time, gone when it ends. And in lockstep, without a socket."""

import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from fishmj.base.calib import calib_folder, read_toml
from fishmj.base.errors import ConfigError, UnknownName, UsageError
from fishmj.deploy.camera.cameras import SharedFrames
from fishmj.deploy.loopback import bodies, loopback_command, loopback_server
from fishmj.deploy.loopback.faults import FAULTS, parse
from fishmj.deploy.loopback.lockstep import FixNoise, LockstepCamera, LockstepClock, LockstepTransport, PoseTracker
from fishmj.deploy.loopback.loopback_server import LoopbackServer, ServeOptions
from fishmj.deploy.loopback.loopback_settings import LoopbackSettings, artist_of, calibration_of, make_robot
from fishmj.deploy.protocols import fishmj1, mish
from fishmj.deploy.protocols.messages import RobotInfo
from studies.tracker.cases import GATES
from studies.tracker.error_statistics import autocovariance

ROOT = Path(__file__).resolve().parents[1]
TELLING = (
    "from fishmj.base import console; from fishmj.deploy.loopback.loopback_command import main; "
    "raise SystemExit(console.run(main))"
)


class FakeClock:
    """Seconds that a test moves."""

    def __init__(self):
        self.t = 500.0

    def __call__(self):
        return self.t


@pytest.fixture
def host():
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.1", 0))
    made.settimeout(600.0)
    yield made
    made.close()


def made_server(clock, **options):
    return LoopbackServer(ServeOptions(camera=False, port=0, **options), clock)


def heard(host):
    """Datagrams that are there."""
    found = []
    while select.select([host], [], [], 0.05)[0]:
        found.append(host.recv(2048))
    return found


def test_its_socket_is_bound_to_this_machine_alone(host):
    made = made_server(FakeClock())
    assert made.line.socket.getsockname()[0] == "127.0.0.1"
    made.close()


def test_a_body_that_is_slower_than_real_time_is_refused():
    with pytest.raises(ConfigError, match="lockstep only"):
        ServeOptions(settings=LoopbackSettings(body="lbm"))


def test_a_port_that_is_taken_is_said(host):
    with pytest.raises(ConfigError, match="does another robot run"):
        LoopbackServer(ServeOptions(camera=False, port=host.getsockname()[1]))


def test_it_answers_whoever_spoke_last_and_keeps_with_the_clock(host):
    clock = FakeClock()
    made = made_server(clock)
    for k in range(10):
        if k == 2:
            host.sendto(fishmj1.encode_hello(1, 7.0), ("127.0.0.1", made.line.port))
            select.select([made.line.socket], [], [], 600.0)
        made.turn(0.02 * k + 0.0007)
    found = [fishmj1.decode(data) for data in heard(host)]
    made.close()
    assert sum(isinstance(message.value, RobotInfo) for message in found) == 1
    times = [message.time for message in found if not isinstance(message.value, RobotInfo)]
    np.testing.assert_allclose(np.diff(times), 0.02, atol=1e-9)
    assert made.robot.time == pytest.approx(0.18, abs=1e-9)


def test_the_open_robot_speaks_unasked_to_the_hosts_port(host):
    made = made_server(FakeClock(), settings=LoopbackSettings(protocol="mish-fixed"), host_port=host.getsockname()[1])
    for k in range(5):
        made.turn(0.02 * k + 0.01)
    found = [mish.decode_telemetry(data) for data in heard(host)]
    made.close()
    assert len(found) >= 4 and found[0].servo_voltage[0] > 7.0


def test_a_machine_that_slept_does_not_make_the_robot_catch_up(host):
    clock = FakeClock()
    made = made_server(clock)
    made.turn(0.1)
    made.turn(30.0)
    assert made.robot.time < 0.2 and made.figures["lost"] == pytest.approx(29.9, abs=0.05)
    made.close()


def test_frames_reach_shared_memory_when_they_are_due(monkeypatch):
    clock = FakeClock()
    made = LoopbackServer(ServeOptions(port=0, settings=LoopbackSettings(camera_latency=0.05)), clock)
    made.start = clock.t
    monkeypatch.setattr(loopback_server.time, "sleep", lambda seconds: setattr(clock, "t", clock.t + seconds))
    reader = SharedFrames(made.ring.name)
    reader.open()
    made.turn(0.0235)
    while not made._jobs.empty():
        made._show(made._jobs.get())
    ((t, image),) = reader.read(0.0)
    assert made.figures["frames"] == 2 and clock.t == pytest.approx(500.0 + 0.02 + 0.05, abs=0.0021)
    assert t == pytest.approx(500.02, abs=0.0021) and image.shape == (720, 1280, 3) and image.std() > 1
    name = made.ring.name
    reader.close()
    made.close()
    with pytest.raises(ConfigError):
        SharedFrames(name).open()


def test_the_command_reads_all_its_options_and_refuses_what_cannot_be(tmp_path):
    text = (
        "--fault loss=0.1 --fault brown_out@30 --effect command_latency:delay=0.15 --flow 0.2,180 --turbulence gust --marks tag"
    )
    made = loopback_command.served(
        loopback_command.options().parse_args([*text.split(), "--start", "-0.5,0.2,1deg", "--camera-latency", "0.03"])
    )
    settings = made.settings
    assert [fault.name for fault in settings.faults] == ["loss", "brown_out"] and settings.start == (-0.5, 0.2, np.radians(1))
    assert settings.effects == {"command_latency": {"delay": 0.15}} and settings.flow.rms > 0 and settings.marks == "tag"
    for bad in ("--flow 0.2", "--flow 9,0", "--address 0.0.0.0", "--start 0,0", "--flow 0.2,3.14"):
        with pytest.raises(UsageError):
            loopback_command.options().parse_args(bad.split())
    with pytest.raises(UnknownName):
        loopback_command.served(loopback_command.options().parse_args(["--effect", "nonsense"]))
    with pytest.raises(ConfigError, match="virtual"):
        loopback_command.served(loopback_command.options().parse_args(["--effect", "gear_backlash", "--body", "fitted"]))
    assert all(f"  {name} " in loopback_command.options().format_help() for name in FAULTS)


def test_as_a_child_it_says_where_it_is_serves_and_ends_with_its_parent(tmp_path, host):
    """A parent in between is killed; the robot ends by itself and takes its shared memory with it."""
    camera, inner = tmp_path / "camera.toml", repr(["-c", TELLING, "--write-calibration", str(tmp_path / "camera.toml")])
    parent = (
        "import os, subprocess, sys, time\n"
        f"subprocess.Popen([sys.executable, *{inner}, '--parent', str(os.getpid())])\n"
        "time.sleep(60)"
    )
    process = subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    told = json.loads(process.stdout.readline())
    assert told["protocol"] == "fishmj-1" and told["size"] == [1280, 720] and camera.is_file()
    reader = SharedFrames(told["frames"])
    reader.open()
    host.settimeout(600.0)
    host.sendto(fishmj1.encode_hello(1, 0.0), ("127.0.0.1", told["robot_port"]))
    kinds = {fishmj1.decode(host.recv(2048)).kind for _ in range(4)}
    assert kinds == {fishmj1.Kind.INFO, fishmj1.Kind.TELEMETRY}
    ((t, _),) = reader.wait(600.0)
    assert t < time.monotonic()
    process.send_signal(signal.SIGKILL)
    process.wait()
    end = time.monotonic() + 600.0
    while _alive(told["pid"]) and time.monotonic() < end:
        time.sleep(0.05)
    assert not _alive(told["pid"])
    reader.close()
    with pytest.raises(ConfigError):
        SharedFrames(told["frames"]).open()
    process.stdout.close()


def test_ctrl_c_is_the_usual_way_to_end_it():
    words = [sys.executable, "-c", TELLING, "--no-camera"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    assert json.loads(process.stdout.readline())["frames"] is None
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=600)
    assert process.returncode == 0 and errors == ""


def _alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{pid}/stat")
    return not (state.is_file() and state.read_text().rsplit(")", 1)[1].split()[0] == "Z")


def lockstep(*faults, artist=None, **settings):
    robot = make_robot(LoopbackSettings(faults=parse(faults), **settings))
    clock = LockstepClock(robot, origin=70.0)
    transport, camera = LockstepTransport(clock), LockstepCamera(clock, artist)
    transport.open()
    camera.open()
    return clock, transport, camera


def test_in_lockstep_time_moves_only_when_the_host_sleeps():
    clock, transport, _ = lockstep()
    transport.send(fishmj1.encode_hello(1, clock.now()))
    assert transport.receive() == [] and clock.now() == 70.0
    clock.sleep_until(70.0155)
    clock.sleep_until(60.0)
    assert clock.now() == 70.0155 and clock.robot.time == pytest.approx(0.016)
    times = [t for t, data in transport.receive()]
    assert times and all(70.0 < t <= 70.016 for t in times)


def test_in_lockstep_the_camera_gives_each_frame_once_when_it_is_readable():
    clock, _, camera = lockstep(camera_latency=0.05)
    stamps = []
    for k in range(1, 51):
        clock.sleep_until(70.0 + 0.02 * k)
        for t, pose in camera.read(clock.now()):
            assert clock.now() - t >= 0.05 - 1e-9 and pose.shape == (6,)
            stamps.append(t)
    assert stamps == sorted(set(stamps)) and len(stamps) == pytest.approx(48, abs=1)
    began = clock.now()
    assert len(camera.wait(1.0)) == 1 and 0.0 < clock.now() - began <= 0.04


def test_lockstep_frames_show_the_fish_and_camera_freeze_repeats_one():
    settings = LoopbackSettings()
    clock, _, camera = lockstep("camera_freeze@0.1-1", artist=artist_of(settings), start=(0.3, 0.1, 0.5))
    clock.sleep_until(70.3)
    images = [image for _, image in camera.read(clock.now())]
    x, y = np.round(calibration_of(settings).to_pixel([[0.3, 0.1]])[0]).astype(int)
    patch = images[0][y - 30 : y + 30, x - 30 : x + 30].astype(int)
    assert ((patch[..., 2] > 140) & (patch[..., 1] < 90)).sum() > 100  # the red head
    assert (images[-1] == images[-3]).all() and not (images[0] == images[1]).all()


def test_the_pose_tracker_has_the_errors_that_it_is_given():
    noise = FixNoise(position=0.004, heading=0.02, slow=0.5, memory=0.1, missed=0.1)
    tracker, pose = PoseTracker(noise, seed=2), np.array([0.5, -0.2, 3.1, 0.0, 0.0, 0.0])
    fixes = [tracker.locate(pose, 10.0 + 0.02 * k) for k in range(6000)]
    found = [fix for fix in fixes if fix is not None]
    assert 1 - len(found) / 6000 == pytest.approx(0.1, abs=0.02)
    errors = np.array([(f.x - 0.5, f.y + 0.2, np.angle(np.exp(1j * (f.yaw - 3.1)))) for f in found])
    np.testing.assert_allclose(errors.std(0), (0.004, 0.004, 0.02), rtol=0.08)
    follow = np.array([(f.t, f.x) for f in found])
    near = np.diff(follow[:, 0]) < 0.021
    a, b = follow[:-1][near][:, 1] - 0.5, follow[1:][near][:, 1] - 0.5
    assert np.mean(a * b) / 0.004**2 == pytest.approx(0.5 * np.exp(-0.2), abs=0.08)
    np.testing.assert_allclose(np.diag(found[0].covariance), (0.004**2, 0.004**2, 0.02**2))


@pytest.mark.parametrize("case", ["tag_clean", "tag_glare", "colour_clean", "colour_glare"])
def test_the_errors_that_were_measured_come_out_of_the_pose_tracker(case):
    noise, pose, dt = FixNoise.measured(case), np.array([0.5, -0.2, 3.1, 0.0, 0.0, 0.0]), 0.02
    tracker = PoseTracker(noise, seed=3)
    fixes = [tracker.locate(pose, 10.0 + dt * k) for k in range(8000)]
    error = np.array([[np.nan] * 3 if f is None else (f.x - 0.5, f.y + 0.2, np.angle(np.exp(1j * (f.yaw - 3.1)))) for f in fixes])
    table = read_toml(calib_folder() / "camera_noise.toml")[case]
    for column, name in ((0, "position"), (2, "yaw")):
        part, lags = table[name], autocovariance(error[:, column])
        assert lags[0] == pytest.approx(part["white"] ** 2 + part["lasting"] ** 2, rel=0.35 if part["tau"] > 1.0 else 0.12)
        after = part["lasting"] ** 2 * np.exp(-dt / part["tau"]) if part["tau"] else 0.0
        assert lags[1] == pytest.approx(after, abs=0.1 * lags[0] if part["tau"] < 1.0 else 0.35 * lags[0])
    assert np.isnan(error[:, 0]).mean() == pytest.approx(table["missed"], abs=0.01)
    most_mm, most_deg, least = GATES[case.partition("_")[2]]
    assert np.sqrt(2) * noise.position < 1e-3 * most_mm and noise.heading < np.radians(most_deg)
    assert noise.missed <= 1 - least / 100


def test_same_settings_same_run_to_the_last_byte():
    def run(seed):
        clock, transport, camera = lockstep("loss=0.1", "corrupt=0.1", seed=seed)
        tracker, out = PoseTracker(seed=seed), []
        for k in range(1, 60):
            transport.send(fishmj1.encode_hello(k, clock.now()))
            clock.sleep_until(70.0 + 0.02 * k)
            out += transport.receive()
            out += [tracker.locate(pose, t)[:4] for t, pose in camera.read(clock.now())]
        return out

    assert run(3) == run(3)
    assert run(3) != run(4)


@pytest.mark.parametrize("body", [bodies.FITTED, bodies.STRUCTURED])
def test_mujoco_swims_in_lockstep_too(body):
    clock, transport, camera = lockstep(body=body, engine="compiled")
    transport.send(fishmj1.encode_arm(1, clock.now(), 0.2, 0.4))
    clock.sleep_until(70.02)
    for k in range(1, 100):
        transport.send(fishmj1.encode_command(k + 1, clock.now(), tuple(0.4 * np.sin(0.126 * k - np.arange(3)))))
        clock.sleep_until(70.02 + 0.02 * k)
    assert clock.robot.pose()[0] > 0.05 and camera.read(clock.now())
    told = fishmj1.decode(transport.receive()[-1][1]).value
    assert np.abs(told.joint).max() > 0.2 and told.voltage == pytest.approx(7.4, abs=0.01)
