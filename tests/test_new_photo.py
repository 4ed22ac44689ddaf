"""`fishmj new --photo`: the outline of a synthetic side view is the fish that was drawn; unclear and hostile ones are refused."""

import numpy as np
import pytest
import silhouettes
from describing import new, refused

from fishmj.base import console
from fishmj.mjcf import load_robot
from fishmj.mjcf.new.shape import typical

cv2 = pytest.importorskip("cv2")


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def drawn(path, *, nose="left", tilt=0.0, noise=3.0, size=(800, 450), fish=((400, 225),), long=600.0):
    """A synthetic side view: typical fish on a background whose light falls off, blurred, with noise."""
    rows = typical(0.6, 0.11, 0.07, 0.14).rows * (long / 0.6)
    x, half = rows[:, 0] - long / 2, rows[:, 1] / 2
    points = np.stack([np.r_[x, x[::-1]], np.r_[-half, half[::-1]]], 1) * [1 if nose == "left" else -1, 1]
    c, s = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
    v, u = np.mgrid[0 : 1 : size[1] * 1j, 0 : 1 : size[0] * 1j]
    image = np.stack([170 + 30 * u - 25 * v, 160 - 10 * u, 120 + 20 * v], -1)
    for middle in fish:
        cv2.fillPoly(image, [np.round(points @ [[c, s], [-s, c]] + middle).astype(np.int32)], (60, 80, 200))
    rng = np.random.default_rng(0)
    image = np.clip(cv2.GaussianBlur(image, (0, 0), 1.0) + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8)
    cv2.imwrite(str(path), image)
    return rows * (0.6 / long)


PHOTO = ["--width=0.07", "--mass=1.6", "--links=5", "--servo=lx-824"]


@pytest.mark.parametrize(
    ("name", "view"),
    [("p.png", {}), ("p.png", {"nose": "right", "tilt": 12.0}), ("p.jpg", {"noise": 14.0, "tilt": -8.0})],
)
def test_the_outline_of_a_photo_is_the_fish_that_was_drawn(tmp_path, name, view):
    rows = drawn(tmp_path / name, **view)
    assert new("pike", f"--photo={name}", "--length=0.6", f"--nose={view.get('nose', 'left')}", *PHOTO) == console.OK
    robot = load_robot("pike.toml")
    starts = np.cumsum([0, *(link.length for link in robot.links)])
    found = np.concatenate([np.array(link.sections)[:, :2] + [a, 0] for link, a in zip(robot.links, starts, strict=False)])
    inside = (found[:, 0] > 0.015) & (found[:, 0] < 0.585)
    off = np.abs(found[:, 1] - np.interp(found[:, 0], rows[:, 0], rows[:, 1]))[inside]
    assert robot.length == pytest.approx(0.6, abs=1e-6) and off.max() < 0.006 and off.mean() < 0.0015  # m; a pixel is 1 mm
    plate = [a + link.fin_from for a, link in zip(starts, robot.links, strict=False) if link.fin_from is not None]
    assert plate[0] == pytest.approx(0.765 * 0.6, abs=0.015)
    overlay = cv2.imread("pike-outline.png")
    assert overlay.shape == (450, 800, 3) and (overlay != cv2.imread(name)).any()


def test_the_scale_of_a_photo_gives_the_length(tmp_path, capsys):
    drawn(tmp_path / "p.png")
    assert new("pike", "--photo=p.png", "--scale=1mm", *PHOTO) == console.OK
    assert load_robot("pike.toml").length == pytest.approx(0.6, rel=0.01)
    assert "mend one of them" in refused(capsys, "roach", "--photo=p.png", "--scale=2mm", "--length=0.6", *PHOTO)
    assert "no scale" in refused(capsys, "roach", "--photo=p.png", *PHOTO)


@pytest.mark.parametrize(
    ("view", "reason"),
    [
        ({"fish": ()}, "no clear outline"),
        ({"fish": (), "noise": 60.0}, "no clear outline"),
        ({"fish": ((400, 110), (400, 340))}, "two things"),
        ({"fish": ((150, 225),)}, "touches the edge"),
        ({"long": 60.0}, "covers"),
    ],
)
def test_a_photo_without_a_clear_outline_is_refused(tmp_path, capsys, view, reason):
    drawn(tmp_path / "p.png", **view)
    said = refused(capsys, "pike", "--photo=p.png", "--length=0.6", *PHOTO)
    assert "p.png: no clear outline" in said and reason in said


def huge(width, height):
    """The header of a PNG that says it is this large."""
    return (
        b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR"
        + width.to_bytes(4, "big")
        + height.to_bytes(4, "big")
        + b"\x08\x02\x00\x00\x00IDATIEND"
    )


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "not a PNG or JPG"),
        (b"hello", "not a PNG or JPG"),
        (huge(100_000, 100_000), "100000 x 100000 pixels"),
        (huge(2**32 - 1, 1), "4294967295 x 1 pixels"),
        (huge(200, 200), "damaged"),
        (b"\xff\xd8\xff\xe0\x00\x04AB\xff\xc0\x00\x11\x08\xff\xff\xff\xff\x03", "65535 x 65535 pixels"),
        (b"\xff\xd8\xff\xe0\x00\x00" * 3, "not a PNG or JPG"),
    ],
)
def test_hostile_pictures_are_refused_before_they_are_decoded(tmp_path, capsys, data, reason):
    (tmp_path / "p.png").write_bytes(data)
    assert reason in refused(capsys, "pike", "--photo=p.png", "--length=0.6", *PHOTO)


@pytest.mark.parametrize("name", ["p.png", "p.jpg"])
@pytest.mark.parametrize("share", [0.3, 0.9, 0.9999])
def test_truncated_pictures_are_refused(tmp_path, capsys, name, share):
    drawn(tmp_path / name)
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data[: int(share * len(data)) - 1])
    assert "truncated" in refused(capsys, "pike", f"--photo={name}", "--length=0.6", *PHOTO)


# ------------------------------------------------------------------------------------- silhouettes whose sizes are known
LEAST = {
    "length": 0.012,
    "area": 0.02,
    "tail": 0.06,
    "volume": 0.015,
    "height": 0.07,
}  # docs/simulate/your_own_fish.md has what was measured


@pytest.mark.parametrize("view", ["plain", "-4 deg, nose right", "all"])
@pytest.mark.parametrize("name", silhouettes.SHAPES)
def test_a_photo_has_the_sizes_of_the_fish_without_its_fins(tmp_path, name, view):
    shape, options = silhouettes.SHAPES[name], silhouettes.VIEWS[view]
    off, notes = silhouettes.errors(shape, options, tmp_path)
    least = LEAST | ({"tail": 0.15} if name == "flare in the last 3 %" else {})  # a pixel of the fish's end is 0.04 of its height
    assert {key: value for key, value in off.items() if abs(value) > least[key]} == {}
    assert notes[0].startswith(f"nose: {options.get('nose', 'left')}, because")
    assert "".join(notes).count("m high") == len(shape.fins)


def test_what_was_guessed_is_said_with_the_option_that_changes_it(tmp_path, capsys):
    silhouettes.render(tmp_path / "p.png", silhouettes.SHAPES["five fins"], nose="right")
    assert new("pike", "--photo=p.png", "--length=0.6", "--mass=1.6", "--links=5", "--servo=lx-824") == console.OK
    said = capsys.readouterr().out
    assert "nose: right, because the tail fin is at the other end; --nose left turns it" in said
    assert "fins left out of the hull" in said and said.count("m high") == 4
    assert "width: a side view does not show it" in said and "is a guess: measure it, --width" in said
    assert new("roach", "--photo=p.png", "--length=0.6", "--nose=left", *PHOTO) == console.OK
    said = capsys.readouterr().out
    assert "nose: left, as --nose says, although the tail fin" in said and "is a guess" not in said
    violet = [np.abs(cv2.imread(f"{name}-outline.png").astype(int) - [180, 65, 200]).max(-1) < 60 for name in ("pike", "roach")]
    assert violet[0].sum() > 3000, "fins that are left out are shown"


def test_ends_that_look_alike_are_asked_for(tmp_path, capsys):
    same = silhouettes.Shape((0, 0.1, 0.5, 0.9, 1.0), (0.05, 0.15, 0.2, 0.15, 0.05))
    silhouettes.render(tmp_path / "p.png", same)
    said = refused(capsys, "pike", "--photo=p.png", "--length=0.6", *PHOTO)
    assert "both ends look alike" in said and "--nose left or --nose right" in said
    assert new("pike", "--photo=p.png", "--length=0.6", "--nose=left", *PHOTO) in (console.OK, console.FAILED_CHECK)


def test_an_upright_photo_is_refused(tmp_path, capsys):
    silhouettes.render(tmp_path / "p.png", silhouettes.SHAPES["default"])
    cv2.imwrite("p.png", cv2.rotate(cv2.imread("p.png"), cv2.ROTATE_90_CLOCKWISE))
    assert "turn the photo" in refused(capsys, "pike", "--photo=p.png", "--length=0.6", *PHOTO)


@pytest.mark.parametrize("option", ["--nose=left", "--scale=1mm"])
def test_options_of_a_photo_ask_for_one(capsys, option):
    assert "goes with --photo" in refused(capsys, "pike", "--yes", option)
