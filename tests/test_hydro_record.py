"""A segment in memory: what of it is used."""

from dataclasses import asdict

import numpy as np

from fishmj.hydro_fit.record import KICK, UNITS, SegmentRecord
from fishmj.water.flow import Flow


def test_free_swim_in_a_stream_drops_its_start_up_transient():
    rng = np.random.default_rng(0)
    arrays = {name: rng.normal(size=(40, 6)) for name in UNITS}
    meta = {
        "tick": 0.02,
        "start": {"q": [0.0] * 6, "v": [0.0] * 6},
        "settle": 0.0,
        "prescribed": {"root": False, "joints": False},
    }
    flow = asdict(Flow(speed=0.2))
    kicked = SegmentRecord(meta | {"segment": {"flow": flow}}, **arrays)
    whole, skip = kicked.steadied, round(KICK / 0.02)
    assert len(whole.q) == 40 - skip and whole.meta["settle"] == KICK
    np.testing.assert_allclose(whole.acceleration, kicked.acceleration[skip:])
    still = SegmentRecord(meta | {"segment": {"flow": asdict(Flow())}}, **arrays)
    held = SegmentRecord(kicked.meta | {"prescribed": {"root": True, "joints": True}}, **arrays)
    assert still.steadied is still and held.steadied is held
