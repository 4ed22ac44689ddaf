"""Rounds of what a policy does, solved and refitted. The flow solver is made up here."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fishmj.base.errors import ConfigError
from fishmj.base.store.atomic import plain, read_json, same_as_begun
from fishmj.hydro_fit.campaign.dagger import dagger
from fishmj.hydro_fit.campaign.data import plan
from fishmj.hydro_fit.campaign.data.run_segments import Finished, Setup
from fishmj.hydro_fit.fit import incremental, rollout
from fishmj.hydro_fit.prior_model import unfitted
from fishmj.lbm_oracle.run.domain import preset
from fishmj.mjcf import load_robot
from fishmj.water.dynamics import planar_chain
from fishmj.water.hydro_model import HydroModel

ROBOT = load_robot("fish")
TRUE = planar_chain.nominal(ROBOT).water


def model_in(water):
    return replace(unfitted(ROBOT), base=water)


class Tanks:
    """A pool: every segment is run in the strip water with the true coefficients."""

    def __init__(self):
        self.starts = {}

    def run(self, waiting, setup, go_on):
        for segment in waiting:
            self.starts[segment.id] = segment
            q, v = dagger.roll_out(ROBOT, model_in(TRUE), segment)
            names = ("id", "block", "episode", "split", "replicate_of")
            meta = {name: getattr(segment, name) for name in names} | setup.about | {"segment": segment.table()}
            meta["grid"] = meta["grid"] | {"slip": segment.slip}
            meta |= {"start": {"q": q[0].tolist(), "v": v[0].tolist()}, "tick": 0.02, "seconds": len(q) * 0.02, "stopped": ""}
            none = np.zeros((len(q), 4, 3))
            arrays = {"q": q, "v": v, "command": q[:, 3:], "wrench": none, "raw": none, "flow": none[..., :2]}
            yield Finished(segment, meta, arrays | {"power": np.ones(len(q))})


@pytest.mark.slow
def test_rounds_end_when_the_returns_agree(tmp_path):
    """Ten times the friction: the first round disagrees, the refit is used, the second agrees; the data grow by both."""
    pool, asked = Tanks(), []

    def refit(model, solver):
        asked.append(len(list((solver / "segments").glob("*.npz"))))
        return model_in(TRUE)

    slow = model_in(TRUE._replace(cf=30 * TRUE.cf, ke=0.1 * TRUE.ke))
    setup = Setup(domain=preset("laptop"), device="cpu")
    given = dict(refit=refit, episodes=1, seconds=6.0, pool=pool)
    found = dagger.correct("dob", ROBOT, slow, tmp_path / "data", setup, **given)
    assert found["agreed"] and len(found["rounds"]) == 2 and asked == [2]
    assert found["rounds"][0]["gap"] > dagger.AGREED > 1e-3 > found["rounds"][1]["gap"]
    first, last = found["rounds"]
    assert first["low"] == first["high"] == pytest.approx(first["surrogate"] - first["solver"]), "one episode has no spread"
    assert first["rmse_surrogate"] > first["rmse_solver"] == pytest.approx(last["rmse_solver"], rel=0.5)
    whole, part = (pool.starts[name] for name in list(pool.starts)[:2])
    half = dagger.roll_out(ROBOT, slow, whole)
    np.testing.assert_allclose(part.velocity, half.v[len(half.v) // 2])
    assert part.pose != whole.pose and part.seconds == dagger.SHORT
    given |= {"refit": lambda *_: pytest.fail("a round that was done is refitted again"), "pool": None}
    again = dagger.correct("dob", ROBOT, slow, tmp_path / "data", setup, **given)
    assert again["rounds"] == found["rounds"] and again["model"].base == model_in(TRUE).base


def test_rounds_that_never_agree_say_so(tmp_path):
    slow = model_in(TRUE._replace(cf=30 * TRUE.cf, ke=0.1 * TRUE.ke))
    setup = Setup(domain=preset("laptop"), device="cpu")
    given = dict(refit=lambda model, solver: slow, episodes=1, seconds=6.0, rounds=1, pool=Tanks())
    found = dagger.correct("dob", ROBOT, slow, tmp_path, setup, **given)
    assert not found["agreed"] and len(found["rounds"]) == 1 and found["model"] is slow


def test_a_folder_goes_on_with_the_options_of_before_only(tmp_path):
    begun = {"policy": "pd", "domain": "laptop", "speeds": None, "task": {"memory": 1, "hide": ()}}
    for _ in range(2):
        same_as_begun(tmp_path / dagger.BEGUN, begun)
    other = {"domain": "window", "task": {"memory": 8, "hide": []}}
    with pytest.raises(ConfigError, match=r"was begun with domain laptop, got window; task\.memory 1, got 8; repeat the options"):
        same_as_begun(tmp_path / dagger.BEGUN, begun | other)
    assert read_json(tmp_path / dagger.BEGUN) == plain(begun), "a refused command leaves what is there"


def test_every_sixth_episode_of_a_round_validates_and_of_fewer_the_last():
    splits = lambda n: [s.split for s in plan.on_policy(ROBOT, "dob", episodes=n, seconds=2.0, seed=1).segments]
    assert splits(1) == ["train"] and splits(3) == ["train", "train", "val"]
    assert [k for k, split in enumerate(splits(14)) if split == "val"] == [5, 11]


def test_streams_of_a_round_are_drawn_between_the_bounds_that_are_asked():
    speeds = lambda *bounds: [
        s.flow.speed for s in plan.on_policy(ROBOT, "dob", episodes=8, seconds=2.0, seed=1, speeds=bounds or None).segments
    ]
    np.testing.assert_allclose(speeds(0.1, 0.2), 0.1 + 0.1 * np.array(speeds()) / plan.STEERED)
    assert 0.1 < min(speeds(0.1, 0.2)) < max(speeds(0.1, 0.2)) < 0.2


def test_a_refit_takes_every_round_and_thins_all_earlier_data_sets(tmp_path, monkeypatch):
    """1,100 s of rounds leave 400 s, a third of the bound, for two earlier sets of 900 s: every fifth of theirs."""

    def swims(name: str, count: int):
        made = [SimpleNamespace(name=f"{name}{k}", seconds=100.0, meta={"block": "policy"}) for k in range(count)]
        return SimpleNamespace(sha256=name, records=lambda split, slip: made if split == "train" else made[:1])

    given = []
    monkeypatch.setattr(dagger, "open_dataset", lambda folder: swims("round", 11))
    monkeypatch.setattr(rollout, "is_free", lambda record: True)
    monkeypatch.setattr(incremental, "Refit", lambda *a, **k: given.append((a, k)) or SimpleNamespace(run=lambda: a[1]))
    model = HydroModel.load("swift-reference")
    dagger.refitted(ROBOT, model, [swims("a", 9), swims("b", 9)], tmp_path / "solver", tmp_path)
    ((_, _, train, (old, new)), more) = given[0]
    assert [r.name for r in train] == [*(f"round{k}" for k in range(11)), "a0", "a5", "b1", "b6"]
    assert [r.name for r in old] == ["a0", "b0"] and [r.name for r in new] == ["round0"]
    assert more["dataset"]["first"] == "a, b" and more["dataset"]["boundary"] == "rims"


def test_the_return_is_that_of_the_task():
    """At the target at rest: the whole of wG; further off or with moving joints: less."""
    segment = plan.on_policy(ROBOT, "dob", episodes=1, seconds=2.0, seed=3).segments[0]
    q, v = np.zeros((20, 6)), np.zeros((20, 6))
    q[:, :2] = segment.drive["target"]
    best = dagger.mean_return(ROBOT, segment, q, v)
    assert best > dagger.mean_return(ROBOT, segment, q + 0.1, v) and best > dagger.mean_return(ROBOT, segment, q, v + 1.0)
