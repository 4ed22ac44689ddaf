"""Claims about replays with the water: the slices are those of the run, small, and drawn where they are."""

import base64

import numpy as np
import pytest
from synthetic import swim
from test_replay import data_of, needs_browser, visit

from fishmj import log
from fishmj.base.errors import ConfigError, StoreError
from fishmj.base.store import write_json
from fishmj.lbm_oracle.output.slices import INDEX, SCHEMA, Slice, write_slice
from fishmj.mjcf import load_robot
from fishmj.view.replay import track, write_html
from fishmj.view.replay.__main__ import main
from fishmj.view.replay.replay_data import colours, page_data, read_wake, strongest
from fishmj.view.replay.video import TopView

STRONG, PEAK, SIDE, WIDE = (
    10.0,
    6.0,
    0.22,
    0.07,
)  # 1/s; 1/s, m, m: two streaks beside the fish, red to its north and blue to its south


@pytest.fixture(scope="module")
def trial():
    return swim(4.0)


@pytest.fixture(scope="module")
def folder(trial, tmp_path_factory):
    return slices(tmp_path_factory.mktemp("fields"), trial)


def slices(folder, trial, *, off=0.0, cell=0.02):
    """Made-up slices in a window that moves with the fish."""
    truth = trial.tables["truth"]
    for n, i in enumerate(range(0, len(truth["t"]), 20)):
        middle = np.array([truth["x"][i], truth["y"][i]])
        x, y = (np.round(m / cell) * cell + cell * np.arange(-half, half + 1) for m, half in zip(middle, (30, 22), strict=True))
        north = np.broadcast_to(y - middle[1], (len(x), len(y)))
        omega = PEAK * (np.exp(-(((north - SIDE) / WIDE) ** 2)) - np.exp(-(((north + SIDE) / WIDE) ** 2)))
        rim = middle + off + 0.1 * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
        still = np.zeros_like(omega)
        write_slice(folder / "slices" / f"{n:05d}.npz", Slice(float(truth["t"][i]), 0.0, x, y, still, still, omega, [rim]))
    write_json(folder / INDEX, {"schema": SCHEMA})
    return folder


def wake_of(trial, folder):
    return read_wake(folder, trial, track(trial, load_robot()))


def test_the_page_holds_the_slices_on_its_own_clock(trial, folder, tmp_path):
    import cv2

    held = data_of(write_html([trial], tmp_path / "a.html", fields=folder).read_text())["wake"]
    assert held["strong"] == STRONG and len(held["images"]) == len(held["t"]) == 10
    np.testing.assert_allclose(held["t"], 0.4 * np.arange(10), atol=1e-6)
    image = cv2.imdecode(np.frombuffer(base64.b64decode(held["images"][3]), np.uint8), cv2.IMREAD_GRAYSCALE)
    west, east, south, north = held["rect"][3]
    assert image.shape == (45, 61) and (east - west, north - south) == pytest.approx((1.22, 0.9))
    y = north - 0.02 * (np.arange(45) + 0.5) - trial.tables["truth"]["y"][60]
    expected = 128 + 127 * PEAK / STRONG * (np.exp(-(((y - SIDE) / WIDE) ** 2)) - np.exp(-(((y + SIDE) / WIDE) ** 2)))
    np.testing.assert_allclose(image[:, 30], expected, atol=2)
    assert data_of(write_html([trial], tmp_path / "b.html").read_text())["wake"] is None


def test_a_log_whose_clock_starts_late_still_meets_its_water(trial, folder):
    late = {c: v[10:] for c, v in trial.tables["truth"].items()}
    first = float(late["t"][0])
    found = wake_of(log.Trial(trial.meta, {"truth": late}), folder)
    np.testing.assert_allclose(found.t + first, 0.4 * np.arange(10), atol=1e-6)


def test_fields_of_another_run_or_none_are_refused(trial, tmp_path):
    with pytest.raises(ConfigError, match="its fish is 0.7. m from where"):
        wake_of(trial, slices(tmp_path / "other", trial, off=0.5))
    with pytest.raises(ConfigError, match="swim --fields"):
        wake_of(trial, tmp_path)
    damaged = slices(tmp_path / "damaged", trial)
    path = damaged / "slices" / "00004.npz"
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(StoreError, match="00004.npz"):
        wake_of(trial, damaged)


def test_ten_seconds_of_a_large_window_stay_below_eight_megabytes(trial, folder):
    """Noise, the worst case: no picture packs. The cells are averaged two by two until they fit."""
    one = wake_of(trial, folder)
    noise = np.random.default_rng(0).integers(1, 256, (128, 192), dtype=np.uint8)
    many = type(one)(np.arange(250) * 0.04, 0.0, STRONG, np.tile(one.rect[0], (250, 1)), (noise,) * 250)
    packed = page_data(many)
    assert 0.9e6 < sum(map(len, packed["images"])) < 7e6


def test_the_scale_is_round_and_above_most_of_what_is_there():
    omega = np.concatenate([np.zeros(10000), np.linspace(0, 9.3, 100)])
    assert strongest(omega) == 10.0 and strongest(3 * omega) == 50.0 and strongest(np.zeros(5)) == pytest.approx(1e-3)
    table = colours().astype(int)
    assert table.shape == (256, 4) and table[230, 0] > table[230, 2] and table[26, 2] > table[26, 0]  # red turns left
    assert table[128, :3].max() < 40 and table[128, 3] < table[1, 3]


def test_a_film_draws_the_streaks_beside_the_fish(trial, folder):
    view = TopView([trial], size=(640, 560), fields=folder)
    plain = TopView([trial], size=(640, 560))
    for time in (0.4, 2.6):
        image, q = view.frame(time).astype(int), view.tracks[0].q[round(time * 50)]
        at = lambda side, image=image, q=q: image[tuple(np.round(view.view.pixel(q[:2] + [0.05, side])).astype(int)[::-1])]
        assert at(SIDE)[2] > 180 > 100 > at(SIDE)[0] and at(-SIDE)[0] > 180 > 120 > at(-SIDE)[2]  # BGR
        assert np.abs(image - plain.frame(time)).max() > 100


def test_the_command_takes_the_fields(trial, folder, tmp_path, capsys):
    log.write_trial(tmp_path / "a", trial)
    out = tmp_path / "r.html"
    assert main([str(tmp_path / "a"), "--fields", str(folder), "--out", str(out), "--png", str(tmp_path / "r.png")]) == 0
    assert len(data_of(out.read_text())["wake"]["images"]) == 10 and (tmp_path / "r.png").stat().st_size > 1e4


@pytest.mark.slow
@pytest.mark.browser
@needs_browser
def test_a_browser_draws_the_vorticity_north_up_and_hides_it_when_asked(trial, folder, tmp_path):
    import cv2

    page = write_html([trial], tmp_path / "a.html", fields=folder)
    seen = {}
    for shown in ("1", "0"):
        shot = tmp_path / f"{shown}.png"
        wish = f"t=2.6&play=0&view=top&wake={shown}"
        _, errors = visit(page, tmp_path / f"p{shown}", f"--screenshot={shot}", wish=wish, budget=4000)
        assert errors == []
        b, g, r = np.moveaxis(cv2.imread(str(shot)).astype(int)[:440, 300:600], -1, 0)  # clear of legend, panel and target
        seen[shown] = [np.argwhere(mask) for mask in ((r > 200) & (g > 100) & (b < 120), (b > 238) & (g > 180) & (r < 120))]
    orange, blue = seen["1"]
    assert len(orange) > 1500 and len(blue) > 1500
    assert orange[:, 0].mean() < blue[:, 0].mean() - 50, "counter-clockwise is in the north"
    assert abs(orange[:, 1].mean() - blue[:, 1].mean()) < 40
    assert max(map(len, seen["0"])) < 0.2 * min(map(len, seen["1"]))
