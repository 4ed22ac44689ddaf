"""Claims about replays: they show the log, need nothing but the file, and a real browser draws them."""

import base64
import json
import math
import os
import re
import shutil
import subprocess
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from synthetic import swim

from fishmj import log
from fishmj.base import console
from fishmj.base.calib import resolve
from fishmj.base.errors import ConfigError, LogError, StoreError
from fishmj.log import __main__ as log_command
from fishmj.mjcf import load_robot
from fishmj.mjcf.identity import identity
from fishmj.mjcf.skin import posed, skin
from fishmj.view.replay import track, write_html, write_mp4, write_png
from fishmj.view.replay.__main__ import main
from fishmj.view.replay.replay_data import robot_of, unlike
from fishmj.view.replay.video import TopView


@pytest.fixture(scope="module")
def trial():
    return swim(6.0)


@pytest.fixture(scope="module")
def robot():
    return load_robot()


def data_of(page: str) -> dict:
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)[1])


def unpack(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4")


# --------------------------------------------------------------------------------------------------------------- tracks
def test_a_track_is_the_truth_on_a_uniform_clock(trial, robot):
    t, truth = track(trial, robot), trial.tables["truth"]
    assert np.allclose(np.diff(t.t), 0.02) and len(t.t) == len(truth["t"])
    assert np.allclose(t.q[:, 0], truth["x"]) and np.allclose(t.q[:, 3:], log.stacked(truth, "j#"))
    assert np.allclose(t.distance, np.hypot(truth["x"] - 0.7, truth["y"]))
    assert np.allclose(t.power, trial.tables["power"]["V"] * trial.tables["power"]["I"])
    assert t.flow.mean(0) == pytest.approx([-0.15, 0]) and t.origin == "synthetic"


def test_a_measured_log_with_pose_and_commands_only_is_enough(trial, robot):
    truth = trial.tables["truth"]
    wrapped = (truth["yaw"] + math.pi + 3.1) % (2 * math.pi) - math.pi
    tables = {"pose": {"t": truth["t"] + 100, "x": truth["x"], "y": truth["y"], "yaw": wrapped}, "cmd": trial.tables["cmd"]}
    t = track(log.Trial({"origin": "measured", "target": [0.5, 0.1]}, tables), robot)
    assert t.t[0] == 0 and np.abs(np.diff(t.q[:, 2])).max() < 0.5  # no jump of a turn
    assert (t.pose_from, t.joints_from) == ("pose", "cmd")
    assert np.allclose(t.target, [0.5, 0.1]) and np.isnan(t.flow).all() and np.isnan(t.power).all()


def test_a_target_holds_until_the_next_row(trial, robot):
    steps = {"t": np.array([1.0, 3.0]), "x": np.array([1.0, 2.0]), "y": np.zeros(2)}
    t = track(log.Trial(trial.meta, {**trial.tables, "target": steps}), robot)
    assert t.target[0, 0] == 1.0 and t.target[149, 0] == 1.0 and t.target[151, 0] == 2.0


def test_what_cannot_be_replayed_says_why(trial, robot, tmp_path):
    with pytest.raises(LogError, match="no table truth or pose; it has cmd"):
        track(log.Trial({}, {"cmd": trial.tables["cmd"]}), robot)
    two = {c: v for c, v in trial.tables["truth"].items() if c not in ("j3", "k3")}
    with pytest.raises(ConfigError, match="'truth' has 2 joints, robot 'swift' has 3; name the right description with --robot"):
        track(log.Trial({}, {"truth": two}), robot)
    for write in (write_html, write_mp4):
        with pytest.raises(LogError, match="at least one trial"):
            write([], tmp_path / "x")
        with pytest.raises(ConfigError, match="speed = 0"):
            write([trial], tmp_path / "x", speed=0)


def test_the_robot_is_the_one_that_the_log_names(trial):
    assert robot_of(trial).name == "swift"
    assert robot_of(log.Trial({}, {})).name == "swift"
    assert robot_of(log.Trial({"robot": "tendon_fish"}, {})).name != "swift"
    with pytest.raises(ConfigError, match='robot "someone else\'s", which does not come with fishmj; name its description'):
        robot_of(log.Trial({"robot": "someone else's"}, {}))


# ----------------------------------------------------------------------------------------------------------------- page
def test_the_page_holds_the_log_and_needs_no_network(trial, robot, tmp_path):
    page = write_html([trial], tmp_path / "a.html", title="A swim").read_text()
    t, held = track(trial, robot), data_of(page)["tracks"][0]
    assert np.allclose(unpack(held["q"]).reshape(t.q.shape), t.q, atol=1e-6)
    assert held["frames"] == len(t.t) and held["duration"] == pytest.approx(t.t[-1])
    assert "MeshCat" in page and "<title>A swim</title>" in page
    own = page.replace((Path(__import__("meshcat").__file__).parent / "viewer/dist/main.min.js").read_text(), "")
    assert not re.search(r"https?://|\bsrc=|\bhref=|@import|url\(|fetch\(|WebSocket|XMLHttpRequest|\.connect\(", own)
    assert len(page) < 2e6


def test_text_from_a_log_cannot_become_code(trial, tmp_path):
    evil = "</script><script>alert(1)</script>@DATA@"
    nasty = log.Trial({**trial.meta, "controller": evil}, trial.tables)
    page = write_html([nasty], tmp_path / "a.html", title=evil).read_text()
    assert "<script>alert" not in page and data_of(page)["tracks"][0]["label"] == evil
    assert data_of(page)["title"] == evil


def test_overlaid_trials_get_their_own_colour_and_label(trial, tmp_path):
    tracks = data_of(write_html([trial, trial], tmp_path / "a.html").read_text())["tracks"]
    assert tracks[0]["colour"] != tracks[1]["colour"]
    assert [t["label"] for t in tracks] == ["open loop 1 Hz (1: swim)", "open loop 1 Hz (2: swim)"]


# ----------------------------------------------------------------------------------------------------------------- film
def test_a_film_has_the_length_of_the_log_and_shows_it_moving(trial, tmp_path):
    import cv2

    path = write_mp4([trial], tmp_path / "a.mp4", fps=10, size=(480, 400), speed=2.0)
    film = cv2.VideoCapture(str(path))
    frames = []
    while (got := film.read())[0]:
        frames.append(got[1].astype(int))
    assert 30 <= len(frames) <= 31 and frames[0].shape == (400, 480, 3)  # 6 s at twice the speed, 10 pictures a second
    assert np.abs(frames[0] - frames[-1]).max() > 80
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]


def test_a_top_view_draws_the_fish_where_it_is(trial):
    view = TopView([trial], size=(640, 560))
    for time in (0.0, 5.0):
        image = view.frame(time).astype(int)[: 560 - 120]
        red = np.argwhere((image[..., 2] > 120) & (image[..., 1] < 60) & (image[..., 0] < 60))
        q = view.tracks[0].q[round(time * 50)]
        assert len(red) > 150
        expected = view.view.pixel(q[:2] + 0.08 * np.array([np.cos(q[2]), np.sin(q[2])]))  # the head is red
        assert np.linalg.norm(red.mean(0)[::-1] - expected) < 0.06 * view.scale


def test_a_picture_is_written_atomically(trial, tmp_path):
    assert write_png([trial], tmp_path / "a.png", 2.0).read_bytes().startswith(b"\x89PNG")
    with pytest.raises(StoreError, match="could not be written"):
        write_png([trial], tmp_path / "a.png" / "b.png", 2.0)


def test_a_film_into_nowhere_is_an_error(trial, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="its folder cannot be made"):
        write_mp4([trial], tmp_path / "file" / "a.mp4")


# ---------------------------------------------------------------------------------------------------------- command line
def test_the_command_writes_page_and_picture_and_reports(trial, tmp_path, capsys):
    log.write_trial(tmp_path / "a", trial)
    out, png = tmp_path / "r.html", tmp_path / "r.png"
    assert main([str(tmp_path / "a"), str(tmp_path / "a"), "--out", str(out), "--png", str(png), "--at", "2", "--json"]) == 0
    files = json.loads(capsys.readouterr().out.splitlines()[-1])["files"]
    assert [(f["path"], f["bytes"]) for f in files] == [(str(p), p.stat().st_size) for p in (out, png)]


def test_a_picture_alone_writes_no_page_beside(trial, tmp_path, monkeypatch):
    log.write_trial(tmp_path / "a", trial)
    monkeypatch.chdir(tmp_path)
    assert main(["a", "--png", "x.png"]) == 0
    assert (tmp_path / "x.png").is_file() and not (tmp_path / "replay.html").exists()
    assert main(["a"]) == 0 and (tmp_path / "replay.html").is_file()


def test_another_robot_is_refused_and_other_numbers_are_said(trial, robot, tmp_path, capsys):
    swum = log.Trial({**trial.meta, **identity(robot)}, trial.tables, name="a")
    log.write_trial(tmp_path / "a", swum)
    heavier = replace(robot, links=(replace(robot.links[0], mass=2 * robot.links[0].mass), *robot.links[1:]))
    longer = replace(robot, name="mine", links=(replace(robot.links[0], length=2 * robot.links[0].length), *robot.links[1:]))
    assert unlike(swum, robot) == ""
    assert re.search(r"a: the log is of robot 'swift' \(\w{12}\), drawn as 'swift' \(\w{12}\)", unlike(swum, heavier))
    with pytest.raises(ConfigError, match="not to be drawn as 'mine' of another structure: lengths"):
        unlike(swum, longer)
    with pytest.raises(ConfigError, match="another structure: 5 joints, expected 3"):
        unlike(log.Trial({"robot": "eel", "joints": 5}, {}, name="b"), robot)
    assert unlike(log.Trial({"origin": "measured"}, trial.tables), robot) == ""
    argv = [str(tmp_path / "a"), "--out", str(tmp_path / "r.html"), "--robot", "tendon_fish"]
    assert console.run(main, argv) == console.BAD_INPUT
    assert "another structure" in capsys.readouterr().err and not (tmp_path / "r.html").exists()


def test_a_log_of_a_robot_with_another_timing_is_of_the_same_description(trial, robot):
    quick = replace(robot, timing=replace(robot.timing, control_dt=0.1, command_path="hold"))
    timing = {"control_dt": 0.1, "command_path": "hold"}
    swum = log.Trial({**trial.meta, **identity(quick), "timing": timing}, trial.tables, name="a")
    assert unlike(swum, robot) == ""
    stiffer = replace(robot, servo=replace(robot.servo, kp=9.0))
    assert unlike(swum, stiffer).endswith(": the same body, but other masses, servo, timing or effects")


def test_a_log_that_fishmj_wrote_is_replayed_and_checked_without_a_remark_on_its_own_columns(trial, tmp_path, capsys):
    cmd = trial.tables["cmd"]
    tables = {**trial.tables, "cmd": {**cmd, "asked1": cmd["c1"], "state": 0 * cmd["t"], "salt": cmd["t"]}}
    events = ["0.100 s ARMED -> SWIMMING: ASK_SWIM", "4.483 s SWIMMING -> NEUTRAL: POSE_LOST; also POSE_OLD"]
    meta = {key: value for key, value in trial.meta.items() if key not in ("source", "replicate_of", "sigma")}
    for source, missing in (("fishmj deploy swim", False), ("a camera", True)):
        log.write_trial(tmp_path / source, log.Trial({**meta, "source": source, "host": {"events": events}}, tables))
        assert main([str(tmp_path / source), "--png", str(tmp_path / "a.png")]) == 0
        log_command.main(["check", str(tmp_path / source)])
        said = capsys.readouterr()
        for text in (said.err, said.out):
            assert "cmd: 'salt' is not in the schema" in text and ("meta.toml: missing " in text) == missing, text
        assert "\n  ended by POSE_LOST; also POSE_OLD at 4.483 s\n" in said.out


@pytest.fixture
def deep_tail(tmp_path):
    """A description of the name of a shipped one, with another tail."""
    path, tail = tmp_path / "deep_tail.toml", "[0.148, 0.120, 0.004], [0.18, 0.120, 0.001]"
    text = resolve("fish").read_text(encoding="utf-8")
    path.write_text(text.replace(tail, tail.replace("0.120", "0.180")), encoding="utf-8")
    return path


@pytest.mark.parametrize("name", ["swift", "fish"])
def test_a_log_of_another_body_is_not_drawn_as_the_shipped_one(deep_tail, trial, tmp_path, capsys, name):
    other, out = load_robot(deep_tail), tmp_path / "r.html"
    swum = log.Trial({**trial.meta, **identity(other), "robot": name}, trial.tables)
    log.write_trial(tmp_path / "a", swum)
    for argv in (["--out", str(out)], ["--png", str(out.with_suffix(".png"))]):
        assert console.run(main, [str(tmp_path / "a"), *argv]) == console.BAD_INPUT
    said = capsys.readouterr().err
    assert "body_sha256" in said and "another body" in said and "--robot FILE.toml" in said and not out.exists()
    with pytest.raises(ConfigError, match="another body"):
        write_html([swum], out)
    assert main([str(tmp_path / "a"), "--out", str(out), "--robot", str(deep_tail)]) == 0 and out.exists()


def test_an_imported_log_of_another_body_is_not_drawn_as_the_shipped_one(deep_tail, trial, tmp_path, capsys):
    log.write_trial(tmp_path / "a", log.Trial(trial.meta, trial.tables))
    words = ["import", str(tmp_path / "a"), "--out", str(tmp_path / "data"), "--robot", str(deep_tail), "--yes"]
    assert console.run(log_command.main, words) == 0
    assert console.run(main, [str(tmp_path / "data" / "a"), "--out", str(tmp_path / "r.html")]) == console.BAD_INPUT
    words = ["export", str(tmp_path / "data" / "a"), "--to", "mcap", "--out", str(tmp_path / "a.mcap")]
    assert console.run(log_command.main, words) == console.BAD_INPUT and not (tmp_path / "a.mcap").exists()
    assert capsys.readouterr().err.count("another body") == 2


def test_a_log_of_the_same_body_is_drawn_and_an_older_one_with_a_remark(trial, robot, tmp_path, capsys):
    heavier = replace(robot, links=(replace(robot.links[0], mass=1.01 * robot.links[0].mass), *robot.links[1:]))
    swum = {**trial.meta, **identity(heavier)}
    older = {key: value for key, value in swum.items() if key != "body_sha256"}
    oldest = {key: value for key, value in older.items() if key != "robot_sha256"}
    for name, meta, noted in (("new", swum, False), ("older", older, True), ("oldest", {**oldest, "robot": "fish"}, False)):
        log.write_trial(tmp_path / name, log.Trial(meta, trial.tables))
        assert main([str(tmp_path / name), "--png", str(tmp_path / "a.png")]) == 0
        assert ("not the same description" in capsys.readouterr().err) == noted, name


def test_a_log_of_an_own_fish_is_not_drawn_as_a_shipped_one(trial, tmp_path, capsys):
    mine, out = tmp_path / "my_fish.toml", tmp_path / "r.html"
    mine.write_text(resolve("fish").read_text(encoding="utf-8").replace('name = "swift"', 'name = "my_fish"'), encoding="utf-8")
    log.write_trial(tmp_path / "a", log.Trial({**trial.meta, **identity(load_robot(mine))}, trial.tables))
    capsys.readouterr()
    for argv in (["--out", str(out)], ["--png", str(out.with_suffix(".png"))]):
        assert console.run(main, [str(tmp_path / "a"), *argv]) == console.BAD_INPUT
    said = capsys.readouterr().err
    told = "the log is of robot 'my_fish', which does not come with fishmj; name its description with --robot FILE.toml"
    assert said.count(told) == 2 and "drawn" not in said and not out.exists()
    assert main([str(tmp_path / "a"), "--out", str(out), "--robot", str(mine)]) == 0 and "drawn" not in capsys.readouterr().err


def test_help_teaches_by_example(capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["--help"])
    assert "examples:" in capsys.readouterr().out


# -------------------------------------------------------------------------------------------------------------- browser
def browser() -> str | None:
    names = (os.environ.get("FISHMJ_BROWSER", ""), "chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    return next((found for name in names if name and (found := shutil.which(name))), None)


needs_browser = pytest.mark.skipif(browser() is None, reason="no chromium or chrome found; set FISHMJ_BROWSER to one")
QUIET = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking --disable-sync "
    "--disable-component-update --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --hide-scrollbars "
    "--window-size=960,640 --enable-logging=stderr"
).split()


def visit(page: Path, profile: Path, *options: str, wish: str = "", budget: int = 3000) -> tuple[str, list[str]]:
    """Open a page in a fresh browser; its standard output and the errors of its console."""
    profile.mkdir()
    command = [browser(), *QUIET, f"--user-data-dir={profile}", f"--virtual-time-budget={budget}", *options]
    done = subprocess.run([*command, f"{page.as_uri()}#{wish}"], capture_output=True, text=True, timeout=600, check=True)
    return done.stdout, [line for line in done.stderr.splitlines() if "ERROR:CONSOLE" in line or "Uncaught" in line]


@pytest.mark.part("page")
@pytest.mark.browser
@needs_browser
def test_a_browser_draws_the_fish_and_it_moves(trial, tmp_path):
    import cv2

    page = write_html([trial], tmp_path / "a.html")
    shots = []
    for k, time in enumerate((1.0, 5.0)):
        shot = tmp_path / f"{k}.png"
        _, errors = visit(page, tmp_path / f"p{k}", f"--screenshot={shot}", wish=f"t={time}&play=0&view=near")
        assert errors == []
        shots.append(cv2.imread(str(shot)).astype(int))
    for image in shots:
        b, g, r = (image[160:470, 300:, i] for i in range(3))  # clear of legend and panel
        assert np.sum((r > 130) & (g < 90) & (b < 90)) > 1500, "red head"
        assert np.sum((r > 130) & (g > 110) & (b < 90)) > 300, "yellow neck"
        assert np.sum((b > 120) & (r < 100) & (g < 125)) > 300, "blue tail"
        assert np.sum((b > 130) & (g > 110) & (r < 110)) > 20000, "water"
    assert np.mean(np.abs(shots[0] - shots[1]).max(-1) > 40) > 0.02


@pytest.mark.slow
@pytest.mark.browser
@needs_browser
def test_the_page_bends_the_skin_as_python_does_and_plays(robot, tmp_path):
    trial = swim(20.0)  # long enough not to begin again: the page may play twice as long as its budget says
    page = write_html([trial, trial], tmp_path / "a.html")
    q = [0.3, -0.2, 0.9, 0.5, -0.7, 0.4]
    bent = "Array.from(fishes[0].mesh.geometry.attributes.position.array)"
    script = f"fishes[0].bend({q}); document.body.dataset.probe = JSON.stringify({bent});"
    probe = f"<script>setTimeout(() => {{ {script} }}, 2000)</script>"
    text = re.sub(r"<meta http-equiv=[^>]*>", "", page.read_text())  # the page's policy lets only its own scripts run
    page.write_text(text.replace("</body>", probe + "</body>"))
    dom, errors = visit(page, tmp_path / "p", "--dump-dom", wish="t=0.5", budget=3000)
    assert errors == [] and "data-error" not in dom
    assert f'data-ready="ready: {len(track(trial, robot).t)} frames"' in dom
    got = np.array(json.loads(re.search(r'data-probe="([^"]*)"', dom)[1])).reshape(-1, 3)
    assert np.allclose(got, posed(skin(robot, smooth=True), q), atol=2e-6)
    assert float(re.search(r'id="clock">([\d.]+) /', dom)[1]) > 0.5, "it plays"  # a busy machine draws few frames
    assert dom.count('<div class="fish" style="--colour:#') == 2


MEASURED = """const box = e => { const r = e.getBoundingClientRect(); return [r.left, r.top, r.right, r.bottom]; };
const shown = id => getComputedStyle(document.getElementById(id)).display;
const seen = inThree(fishes[0].state[0], fishes[0].state[1], 0).project(viewer.camera);
parent.postMessage(JSON.stringify({bar: box(document.querySelector(".dg.main")), title: box(document.querySelector("#legend")),
  panel: box(document.querySelector("#panel")), sheet: shown("sheet"), trouble: shown("trouble"), fish: [seen.x, seen.y],
  wide: innerWidth, scroll: document.documentElement.scrollWidth}), '*');"""


@pytest.mark.browser
@needs_browser
@pytest.mark.parametrize("size", ["390,844", "1200,800"])
def test_replay_on_phone_and_desktop_shows_title_and_fish_uncovered(trial, tmp_path, size):
    page = write_html([trial], tmp_path / "a.html", title="Holding station at 0.2 m/s in gusts of 10 %")
    text = re.sub(r"<meta http-equiv=[^>]*>", "", page.read_text())  # the page's policy lets only its own scripts run
    page.write_text(text.replace("</body>", f"<script>setTimeout(() => {{ {MEASURED} }}, 1500)</script></body>"))
    wide, high = size.split(",")
    framed = tmp_path / "framed.html"  # a browser's own window is no narrower than 500 pixels
    told = "onmessage = event => { document.body.dataset.probe = event.data; };"
    inside = f'<script>{told}</script><iframe src="a.html#play=0" width="{wide}" height="{high}" style="border:0"></iframe>'
    framed.write_text(f"<!DOCTYPE html><body>{inside}</body>")
    dom, errors = visit(framed, tmp_path / "p", "--dump-dom", "--window-size=1300,1000")
    assert errors == [] and "data-probe" in dom
    found = json.loads(unescape(re.search(r'data-probe="([^"]*)"', dom)[1]))
    assert found["scroll"] <= found["wide"] == int(wide)
    assert found["sheet"] == "none" and found["trouble"] == "none", "no box for a vorticity that is not there"
    (left, _, _, low), (_, top, right, foot) = found["bar"], found["title"]
    assert low <= top or left >= right, "MeshCat's bar beside or above the title"
    assert foot <= found["panel"][1] and max(map(abs, found["fish"])) < 0.95
