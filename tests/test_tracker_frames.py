"""Drawn frames: the fish is where it should be, the effects do what they say, and the same arguments give the same frame."""

from dataclasses import replace

import numpy as np
import pytest

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.deploy.loopback.camera_frames import FishLook, FrameArtist, FrameOptions, TagPlate
from fishmj.deploy.tracker.calibration import overhead
from studies.tracker import cases
from studies.tracker.error_statistics import autocovariance, parts

cv2 = pytest.importorskip("cv2")
CAMERA = overhead((640, 360), 0.0028, 3.0, distortion=cases.LENS)
QUIET = FrameOptions(noise=0.0, blur=0.0, vignetting=0.0)
STRAIGHT = (0.0, 0.0, 0.0)


def frame(options: FrameOptions = QUIET, pose=(0.1, 0.05, 0.6), t: float = 1.0, marks: str = "colour", joint=STRAIGHT, **look):
    return FrameArtist(CAMERA, FishLook.of("fish", marks, **look), options).draw(pose, joint, t, (0.3, 0.0, 1.0))


def test_the_red_is_drawn_where_the_calibration_puts_it():
    """Centre of the red pixels, by thresholding of the bare drawing, against the polygon's own."""
    look, random = FishLook.of("fish"), np.random.default_rng(0)
    assert look.head is not None
    inside = np.random.default_rng(1).uniform([0.05, -0.04], [0.175, 0.04], (4000, 2))
    ours = np.array([cv2.pointPolygonTest(look.head.astype(np.float32), tuple(map(float, p)), False) >= 0 for p in inside])
    middle, away, artist = inside[ours].mean(0), [], FrameArtist(CAMERA, look, QUIET)
    y, x = np.mgrid[:360, :640]
    for _ in range(8):
        pose = np.array([*random.uniform(-0.4, 0.4, 2), random.uniform(-3, 3)])
        image = artist.draw(pose, STRAIGHT, 0.0).astype(float)
        score = np.clip(image[..., 2] - image[..., :2].max(-1), 0, None)
        score[score < 45] = 0  # the yellow is a little red too
        flat = (score > 0) * 1.0
        c, s = np.cos(pose[2]), np.sin(pose[2])
        expected = CAMERA.to_pixel([pose[:2] + np.array([[c, -s], [s, c]]) @ middle], look.height)[0]
        away.append(np.array([(flat * x).sum(), (flat * y).sum()]) / flat.sum() - expected)
    assert np.abs(away).max() < 0.35 and np.abs(np.mean(away, 0)).max() < 0.15, "px"


def test_a_bent_fish_is_drawn_bent():
    straight, bent = frame(), frame(joint=(0.6, 0.6, 0.6))
    head = CAMERA.to_pixel([np.array([0.1, 0.05]) + 0.1 * np.array([np.cos(0.6), np.sin(0.6)])])[0].astype(int)
    assert np.abs(straight[head[1] - 4 : head[1] + 4, head[0] - 4 : head[0] + 4].astype(int)).sum() > 0
    same = (
        straight[head[1] - 8 : head[1] + 8, head[0] - 8 : head[0] + 8]
        == bent[head[1] - 8 : head[1] + 8, head[0] - 8 : head[0] + 8]
    )
    assert same.all() and (straight != bent).any()


EFFECTS = {
    "noise": {"noise": 4.0},
    "blur": {"blur": 1.0},
    "vignetting": {"vignetting": 0.4},
    "exposure": {"exposure": 0.02},
    "glare": {"glare": 1.0},
    "ripple": {"ripple": 1.0},
    "occlusion": {"occlusion": 0.3},
    "decoy": {"decoy": True},
    "light": {"light": 0.3},
    "jpeg": {"jpeg": 60},
}


@pytest.mark.parametrize("effect", EFFECTS)
def test_every_effect_changes_the_frame_and_is_repeatable(effect):
    options = replace(QUIET, **EFFECTS[effect])
    once, again = frame(options), frame(options)
    assert once.shape == (360, 640, 3) and once.dtype == np.uint8
    assert np.array_equal(once, again)
    assert not np.array_equal(once, frame())


def test_ripple_displaces_by_its_root_mean_square():
    artist = FrameArtist(CAMERA, FishLook.of("fish", "tag"), replace(QUIET, ripple=1.0))
    y, x = np.mgrid[:360, :640].astype(np.float32)
    ramp = cv2.merge([np.clip(x / 4, 0, 255), np.clip(y / 4, 0, 255), x * 0]).astype(np.uint8)
    shifts = []
    for t in np.arange(12) * 0.37:
        artist.waves = artist.waves[:]
        bent = artist._rippled(ramp, float(t)).astype(float)
        light = bent[..., 2:]  # the third channel holds the brightness alone
        moved = 4 * (bent[..., :2] - light - ramp[..., :2])
        shifts.append(moved[40:-40, 40:-40][light[40:-40, 40:-40, 0] > 0])
    rms = np.sqrt(np.mean(np.concatenate(shifts) ** 2))
    assert 0.6 < rms < 3.0, "px, coarse: the ramp has steps of 4 px"


def test_a_decoy_never_touches_the_fish():
    artist = FrameArtist(CAMERA, FishLook.of("fish"), replace(QUIET, decoy=True))
    pose = np.array([0.1, 0.05, 0.6])
    near = min(np.hypot(*(artist._decoy(pose, t)[0].points.mean(0) - pose[:2])) for t in np.arange(0, 60, 0.5))
    assert 0.1 < near < 0.25, "it does come near"


def test_a_fish_out_of_sight_leaves_the_empty_tank():
    artist = FrameArtist(CAMERA, FishLook.of("fish"), QUIET)
    assert np.array_equal(artist.draw((30.0, 0.0, 0.0), STRAIGHT, 0.0), artist.empty)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("place", [(50.0, 50.0, 0.0), (1e9, 0.0, 0.0), (np.nan, 0.0, 0.0)])
def test_a_fish_that_is_nowhere_near_is_no_matter_of_numbers(place):
    options = FrameOptions(glare=1.0, decoy=True, noise=0.0)
    drawn = FrameArtist(CAMERA, FishLook.of("fish", "tag"), options).draw(place, np.zeros(3), 1.0)
    assert drawn.shape == (*CAMERA.size[::-1], 3) and (drawn == 255).any()  # the other glints


def test_a_fish_at_the_edge_is_cut_off_there():
    half = CAMERA.to_tank([(0.0, 180.0)])[0]
    assert frame(pose=(half[0], half[1], 0.0)).shape == (360, 640, 3)


def test_impossible_looks_are_refused():
    with pytest.raises(UnknownName, match="colour"):
        FishLook.of("fish", "stripes")
    with pytest.raises(ConfigError, match="band of the head"):
        FishLook.of("fish", red=(0.05, 0.4))
    with pytest.raises(UnknownName, match="36h11"):
        frame(marks="tag", plate=TagPlate(family="7x7"))


def test_white_and_lasting_parts_of_an_error_are_told_apart():
    random, n, dt = np.random.default_rng(3), 200_000, 0.02
    lasting = np.zeros(n)
    keep = np.exp(-dt / 0.1)
    kicks = random.normal(0, 0.003 * np.sqrt(1 - keep**2), n)
    for k in range(1, n):
        lasting[k] = keep * lasting[k - 1] + kicks[k]
    error = lasting + random.normal(0, 0.002, n)
    error[random.random(n) < 0.05] = np.nan
    found = parts(autocovariance(error), dt)
    assert found["white"] == pytest.approx(0.002, rel=0.08)
    assert found["lasting"] == pytest.approx(0.003, rel=0.08) and found["tau"] == pytest.approx(0.1, rel=0.15)
    assert parts(autocovariance(random.normal(0, 0.002, n)), dt)["lasting"] == pytest.approx(0.0, abs=4e-4)
