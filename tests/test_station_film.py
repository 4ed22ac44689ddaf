"""The moving picture of the README: a second of its trial, drawn."""

import numpy as np
import pytest

from fishmj.log import read_trial


@pytest.mark.slow
@pytest.mark.oracle
def test_a_second_of_the_swim_becomes_frames_of_fish_wake_and_target(tmp_path):
    from studies import station_film as film

    film.swim(tmp_path, "cpu", seconds=1.0)
    assert read_trial(tmp_path / "trial").value("controller") == film.POLICY
    frames = film.drawn(tmp_path, start=0.0)
    assert len(frames) == round(1.0 / film.EVERY)
    assert all(frame.shape == (film.SIZE[1], film.SIZE[0], 3) and frame.dtype == np.uint8 for frame in frames)
    assert np.abs(frames[-1].astype(int) - frames[0]).max() > 100, "something moves"
    data = film.animated(frames)
    assert data[8:12] == b"WEBP" and data.count(b"ANMF") == len(frames)
