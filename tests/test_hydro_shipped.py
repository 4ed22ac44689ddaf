"""The shipped water against the shipped records that no fit has seen, and those records against the command that makes them."""

import json
from pathlib import Path

import pytest

from fishmj.base import console
from fishmj.hydro_fit import __main__ as verb
from fishmj.hydro_fit.campaign.data import plan
from fishmj.hydro_fit.campaign.data.segment import Segment
from fishmj.hydro_fit.segment_dataset import open_dataset
from fishmj.mjcf import load_robot

DATA = Path(__file__).parent.parent / "data" / "hydro" / "swift"
FRESH = DATA.with_name(DATA.name + verb.FRESH)
SEED, SCALE = 26, 4.0  # of the fresh episodes


@pytest.mark.slow
def test_shipped_water_is_within_every_tolerance_on_unseen_segments(capsys):
    assert console.run(verb.main, ["check", "--json"]) == console.OK
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert all(found["passed"].values()) and found["not_told"] == []
    free = [meta for folder in (DATA, FRESH) for meta in open_dataset(folder).about.values() if meta["split"] == "test"]
    swims = [
        m for m in free if m["grid"]["slip"] == 1 and not m["prescribed"]["root"] and not m.get("replicate_of") and "file" in m
    ]
    assert found["n"]["coverage90"] == len(swims) > 150, "both sets count"


def test_fresh_test_episodes_match_their_plan_and_are_never_fitted():
    data = open_dataset(FRESH)
    wanted = {s.id: s.sha256 for s in plan.fresh_test(load_robot("fish"), seed=SEED, scale=SCALE).segments if s.slip == 1}
    made = {name: Segment.of(meta["segment"]).sha256 for name, meta in data.about.items()}
    assert made == wanted and {meta["split"] for meta in data.about.values()} == {"test"}
    assert not {m["episode"] for m in open_dataset(DATA).about.values() if m["split"] != "test"} & {
        m["episode"] for m in data.about.values()
    }
    assert data.meta["origin"] == "synthetic" and sum(path.stat().st_size for path in FRESH.rglob("*") if path.is_file()) < 11e6
