"""Claims about the live fish: keys change the current and the target, MeshCat shows it, the swim is saved as a log."""

import contextlib
import http.client
import json
import math
import os
import pty
import socket
import struct
import subprocess
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from fishmj import __version__, log
from fishmj.base import console, source
from fishmj.base.errors import ConfigError
from fishmj.mjcf import load_robot
from fishmj.mjcf.skin import posed, skin
from fishmj.view.play import LiveSession
from fishmj.view.play.__main__ import main, swim
from fishmj.view.play.live_session import Keyboard, press
from fishmj.view.replay.live_view import LiveView, SceneServer, arrow, ring, slices_of
from fishmj.water.flow import Flow


class Screen:
    """A view that remembers."""

    def __init__(self):
        self.shown, self.path, self.cleared = [], [], 0

    def show(self, q, target, current):
        self.shown.append((np.array(q), np.array(target), np.array(current)))

    def trail(self, point):
        self.path.append(point)

    def clear_trail(self):
        self.cleared += 1


class Script:
    """Keys by call."""

    def __init__(self, *calls):
        self.calls = list(calls)

    def read(self):
        return self.calls.pop(0) if self.calls else []


@pytest.fixture(scope="module")
def body():
    """One engine for all ponds: compiling it takes longer than swimming."""
    from fishmj import engines

    return engines.make("batch", load_robot())


@pytest.fixture
def pond(body):
    return LiveSession("dob", flow=Flow(speed=0.2, direction=math.pi, turbulence="default", intensity=0.05), engine=body)


def test_two_seconds_of_swimming_are_shown_and_logged(pond, tmp_path):
    screen = Screen()
    swim(pond, screen, Script(), 2.0, lambda text: None)
    assert len(screen.shown) == 51 and len(screen.path) == 10  # the start, then 25 pictures a second
    back = log.read_trial(log.write_trial(tmp_path / "a", pond.trial()))
    assert len(back.tables["truth"]["t"]) == 100 and back.tables["truth"]["t"][-1] == pytest.approx(2.0)
    assert np.allclose(back.tables["truth"]["x"][1::2], [q[0] for q, *_ in screen.shown[1:]], atol=1e-3)
    assert back.value("controller") == "dob" and back.value("origin") == "synthetic"
    assert np.abs(log.stacked(back.tables["truth"], "j#")).max() > 0.05, "it beats its tail"
    assert np.abs(log.stacked(back.tables["flow"], "u#x") + 0.2).max() < 0.1


def test_the_arrow_keys_steer_the_current(pond):
    brains = iter(())
    for key in ("up", "up", "left"):
        press(pond, key, brains)
    assert pond.flow.speed == pytest.approx(0.24) and pond.flow.direction == pytest.approx(math.pi + math.pi / 12)
    for _ in range(40):
        press(pond, "down", brains)
    assert pond.flow.speed == 0 and pond.loop.scenario.current.mean == pytest.approx(np.zeros((1, 2)))


def test_wasd_moves_the_target_but_not_out_of_the_tank(pond):
    for key in "wwas":
        press(pond, key, iter(()))
    assert pond.target == pytest.approx([0.6, 0.1])
    for _ in range(40):
        press(pond, "d", iter(()))
    assert pond.target == pytest.approx([1.5, 0.1])


def test_other_controllers_are_made_when_c_asks_for_them(pond, monkeypatch):
    tried = []
    monkeypatch.setattr(pond, "can_steer", lambda name: tried.append(name) or name in ("pi", "drift"))
    swim(pond, Screen(), Script(), 0.2, lambda text: None)
    assert tried == []
    seen, press_c = [], Script(["c"], ["c"], ["c"])
    monkeypatch.setattr(pond, "step", lambda step=pond.step: seen.append(pond.controller.name) or step())
    swim(pond, Screen(), press_c, 0.8, lambda text: None)
    assert set(seen[:2]) == {"pi", "drift"} and seen[2] == "dob" and tried


def test_a_passive_fish_drifts_with_the_current_that_the_keys_make(body):
    pond = LiveSession("drift", flow=Flow(speed=0.0), engine=body)
    start = pond.q
    swim(pond, Screen(), Script([], ["up"] * 10, ["left"] * 6), 6.0, lambda text: None)
    moved = pond.q - start
    assert moved[1] > 0.5 and abs(moved[0]) < 0.4 * moved[1]  # 0.2 m/s towards +y for most of the 6 s


def test_eddies_stay_in_place_when_the_mean_current_changes(pond):
    pond.step()
    before = log.stacked(pond.trial().tables["flow"], "u#x")[-1] + 0.2
    from fishmj.engines.planar import link_centres
    from fishmj.water.flow import sample

    pond.set_flow(0.2 + 1e-9, math.pi)
    tick = np.array([pond.loop.count[0] * 10])
    now = sample(np, pond.loop.scenario.current, link_centres(np, pond._chain, pond.q[None]), tick)[0][0, :, 0] + 0.2
    assert now == pytest.approx(before, abs=2e-4)
    pond.loop.count[0] = 500
    ahead = pond.loop.scenario.current
    pond.set_flow(0.3, math.pi)
    points = np.array([[[0.1, 0.2], [-0.4, 0.3]]])
    tick = np.array([pond.loop.count[0] * 10])
    eddies = [(sample(np, c, points, tick)[0] - c.mean) / c.rms for c in (ahead, pond.loop.scenario.current)]
    assert eddies[0] == pytest.approx(eddies[1], abs=1e-6)


def test_pause_stops_the_clock_and_q_ends_the_swim(pond):
    screen, texts = Screen(), []
    swim(pond, screen, Script([], [" "], [], [], [" "], [], ["q"]), 60.0, texts.append)
    assert pond.loop.count[0] == 3 and len(texts) == 3 and "dob  current 0.20 m/s to 180 deg" in texts[0]


def test_c_hands_the_fish_to_the_next_controller_and_r_starts_again(pond):
    screen = Screen()
    swim(pond, screen, Script([], ["c"], ["r"], [], ["q"]), 60.0, lambda text: None)
    assert pond.controller.name != "dob" and screen.cleared == 1 and pond.loop.count[0] == 2


def test_the_camera_is_as_late_as_in_every_task(pond):
    timing = pond.robot.timing
    expected = math.ceil(timing.camera_latency / timing.bus_dt - 1e-6)  # rounded up: a frame that is on its way is not there
    assert pond.loop.scenario.camera.tolist() == [expected] and expected * timing.bus_dt >= timing.camera_latency


def test_an_empty_swim_is_not_saved(pond):
    with pytest.raises(ConfigError, match="nothing recorded yet"):
        pond.trial()


def test_keys_are_read_from_a_terminal_without_enter_and_it_is_restored():
    import termios

    ours, theirs = pty.openpty()
    before = termios.tcgetattr(theirs)
    with Keyboard(theirs) as keys:
        assert keys.read() == []
        os.write(ours, b"\x1b[Aw\x1b[D\x1bOB Q")
        assert keys.read() == ["up", "w", "left", "down", " ", "q"]
    assert termios.tcgetattr(theirs) == before
    os.close(ours)
    os.close(theirs)
    with Keyboard() as none:
        assert none.read() == []


# ------------------------------------------------------------------------------------------------------- the MeshCat side
def test_slices_cover_the_skin_and_are_rigid_parts_of_it():
    s = skin(load_robot(), spacing=0.008, around=20, smooth=True)
    parts = slices_of(s)
    assert 12 <= len(parts) <= 30
    assert sum(len(faces) for *_, faces, _ in parts) >= len(s.faces)
    q = np.array([0.3, 0.2, 0.5, 0.4, -0.5, 0.6])
    whole = posed(s, q)
    from fishmj.mjcf.skin import hinge_frames

    hinges, headings = hinge_frames(s.hinge_x, q)
    worst = 0.0
    for hinge, share, vertices, _, _ in parts:
        a = headings[hinge] + share * q[3 + hinge]
        turn = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
        placed = hinges[hinge] + (vertices[:, :2] - [s.hinge_x[hinge], 0]) @ turn.T
        worst = max(worst, *(np.abs(whole[:, :2] - p).sum(1).min() for p in placed[::7]))
    assert worst < 0.012  # m, from the smooth skin, at strong bends


def test_ring_and_arrow_are_sound_meshes():
    for vertices, faces in (ring(0.1, 0.006), arrow()):
        assert faces.min() == 0 and faces.max() == len(vertices) - 1 and np.isfinite(vertices).all()


def test_the_command_serves_meshcat_swims_and_stops(tmp_path, capsys):
    assert main(["--controller", "drift", "--headless-seconds", "2", "--save", str(tmp_path / "a"), "--json"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("water: fitted") and lines[1].startswith("building swift")
    assert not [line for line in lines if "in a browser" in line]  # nobody could open it in time
    told = json.loads(lines[-1])
    assert told["seconds"] == pytest.approx(2.0) and told["controller"] == "drift"
    assert log.read_trial(tmp_path / "a").tables["truth"]["t"][-1] == pytest.approx(2.0)


def test_the_server_answers_and_holds_the_fish_and_dies_with_the_view():
    view = LiveView(load_robot())
    with view:
        view.show(np.zeros(6), [0.7, 0.0], [-0.2, 0.0])
        view.trail([0.0, 0.0])
        view.trail([0.1, 0.0])
        assert urllib.request.urlopen(view.url, timeout=600).status == 200
        page = view.page()
        assert page.count("viewer.handle_command_bytearray") > 2 * len(view.slices)
    assert view.server.process.poll() is not None


# ------------------------------------------------------------------------------------------------ who may reach the scene
def listening(process: int) -> set[tuple[str, int]]:
    """(address, port) on which a process listens, from /proc."""
    sockets = set()
    for handle in Path(f"/proc/{process}/fd").iterdir():
        with contextlib.suppress(OSError):
            if (target := os.readlink(handle)).startswith("socket:["):
                sockets.add(target[8:-1])
    found = set()
    for table, family in (("tcp", socket.AF_INET), ("tcp6", socket.AF_INET6)):
        for line in Path(f"/proc/{process}/net/{table}").read_text().splitlines()[1:]:
            local, state, inode = (line.split()[i] for i in (1, 3, 9))
            if state == "0A" and inode in sockets:
                words, port = local.split(":")
                raw = b"".join(struct.pack("=I", int(words[i : i + 8], 16)) for i in range(0, len(words), 8))
                found.add((socket.inet_ntop(family, raw), int(port, 16)))
    return found


@pytest.fixture(scope="module")
def server():
    made = SceneServer()
    yield made
    made.close()


@pytest.mark.skipif(not Path("/proc/net/tcp").is_file(), reason="reads the sockets of a process from /proc")
def test_the_server_listens_on_this_machine_alone(server):
    found = listening(server.process.pid)
    assert len(found) == 2 and {address for address, _ in found} == {"127.0.0.1"}, "pages and commands"
    for _, port in found:
        with pytest.raises(OSError, match="refused"):
            socket.create_connection(("127.0.0.2", port), timeout=600)


def test_a_page_that_came_by_a_foreign_name_is_refused(server):
    port = int(server.url.split(":")[2].partition("/")[0])
    key = {"Sec-WebSocket-Key": "x" * 22 + "==", "Sec-WebSocket-Version": "13", "Upgrade": "websocket", "Connection": "Upgrade"}

    def status(host: str, path: str = "/static/", **headers: str) -> int:
        asked = http.client.HTTPConnection("127.0.0.1", port, timeout=600)
        with contextlib.closing(asked):
            asked.request("GET", path, headers={"Host": host, **headers})
            return asked.getresponse().status

    here, foreign = f"127.0.0.1:{port}", f"evil.example:{port}"
    assert [status(here), status(f"localhost:{port}"), status("[::1]")] == [200, 200, 200]
    assert [status(foreign), status("evil.example")] == [403, 403]
    assert status(here, "/", Origin=f"http://{here}", **key) == 101, "the viewer itself"
    assert status(here, "/", Origin="http://evil.example", **key) == 403
    assert status(foreign, "/", Origin=f"http://{foreign}", **key) == 403, "a name of theirs that points here"


def test_the_server_ends_when_its_parent_does():
    made = SceneServer()
    made.process.stdin.close()  # what the system does when the parent dies
    assert made.process.wait(600) == 0
    made.process.stdout.close()


@pytest.mark.parametrize("host", ["192.0.2.1", "no such host", "1.2.3.4.5", "a" * 300])
def test_an_address_of_another_machine_is_one_line_before_anything_is_made(host, capsys):
    assert console.run(main, ["--host", host, "--headless-seconds", "1"]) == console.BAD_INPUT
    said = capsys.readouterr().err
    assert "cannot listen on" in said and said.count("\n") == 1


def test_a_saved_swim_is_not_replaced_unasked(tmp_path, capsys):
    assert console.run(main, ["--save", str(tmp_path), "--headless-seconds", "1"]) == console.BAD_INPUT
    assert "--overwrite" in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_a_fish_that_the_best_policy_is_not_made_for_drifts_and_it_is_said(capsys):
    from argparse import Namespace
    from dataclasses import replace

    from fishmj.mjcf.reading import load_robot
    from fishmj.view.play.__main__ import controller_of

    asked, fish = Namespace(controller=None, anyway=False), load_robot("fish")
    held = replace(fish, timing=replace(fish.timing, command_path="hold"))
    assert controller_of(asked, fish).name == "station-family"
    assert controller_of(asked, load_robot("tendon_fish")).name == "drift" and controller_of(asked, held).name == "drift"
    assert capsys.readouterr().err.count("made for another fish or command path") == 2
    asked.anyway = True
    assert controller_of(asked, held).name == "station-family" and controller_of(asked, load_robot("tendon_fish")).name == "drift"


def test_a_live_trial_says_its_target_and_what_made_it(tmp_path):
    pond = LiveSession("drift", flow=Flow(speed=0.1, direction=np.pi))
    pond.step()
    path = log.write_trial(tmp_path / "a", pond.trial())
    read = log.read_trial(path)
    assert not [note for note in read.notes if "missing" in note]
    assert read.value("target") == [0.7, 0.0] and read.value("commit") == source.commit() and read.value("versions.fishmj")
    pond.target = np.array([0.5, 0.1])
    pond.step()
    moved = pond.trial()
    assert moved.value("target") == [0.5, 0.1] and any("target was moved" in note for note in moved.value("notes"))


def test_a_package_in_somebody_elses_repository_says_its_version(tmp_path, monkeypatch):
    """As in an environment inside a checkout of something else: git knows of no such file there."""
    (tmp_path / "fishmj").mkdir()
    monkeypatch.setattr(source, "HERE", tmp_path / "fishmj")
    for command in (
        ["git", "init", "-q"],
        ["git", "-c", "user.name=x", "-c", "user.email=x@y", "commit", "-q", "--allow-empty", "-m", "x"],
    ):
        subprocess.run(command, cwd=tmp_path, check=True)
    assert source.commit.__wrapped__() == f"fishmj {__version__}"
