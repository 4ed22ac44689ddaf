"""A campaign over Ray: two workers on this machine, made-up segments, a worker that is killed. Marked ray, but for the first."""

from collections import deque
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import ray_toys
from absent import absent

from fishmj.base.errors import ConfigError, MissingExtra
from fishmj.base.ray_cluster import ATTEMPTS
from fishmj.hydro_fit.campaign.data.collect import Local, collect
from fishmj.hydro_fit.campaign.data.plan import CampaignPlan
from fishmj.hydro_fit.campaign.data.ray_pool import RayPool
from fishmj.hydro_fit.campaign.data.run_segments import Setup
from fishmj.hydro_fit.campaign.data.segment import Segment
from fishmj.hydro_fit.segment_dataset import open_dataset
from fishmj.lbm_oracle.run.domain import preset
from fishmj.mjcf import load_robot

SETUP = Setup(domain=preset("laptop"), device="cpu")


def segments(diary, number=6, **dies):
    """Made-up segments; `dies` says how many workers the segment of that name kills."""
    diary.mkdir(exist_ok=True)
    made = []
    for name in (f"e{i}" for i in range(number)):
        drive = {"kind": "gait", "diary": str(diary), "dies": dies.get(name, 0)}
        split = "test" if name == "e0" else "train"
        made.append(Segment(id=name, block="gait", episode=name, split=split, seconds=1.0, drive=drive))
    return tuple(made)


def begun(diary):
    """How often each segment was begun."""
    return {path.name: len(path.read_text().splitlines()) for path in sorted(diary.iterdir())}


HERE = Path(__file__).parent


@pytest.fixture
def local(monkeypatch):
    """Two workers, started and ended by the pool, that can import the made-up runner."""
    monkeypatch.setenv("PYTHONPATH", f"{HERE}:{HERE.parent}")
    return RayPool("local:2", runner=ray_toys.run)


@pytest.fixture
def two(cluster):
    """A pool of its two workers."""
    return RayPool("auto", runner=ray_toys.run)


def test_without_ray_the_message_has_the_install_line(monkeypatch):
    absent(monkeypatch, "ray")
    with pytest.raises(MissingExtra, match=r'pip install "fishmj\[ray\]"'):
        list(RayPool("local:2").run(deque(), SETUP, lambda water: True))


@pytest.mark.ray
def test_two_ray_workers_run_each_segment_once_and_match_one_process(tmp_path, local):
    plan = CampaignPlan(label="toy", robot=load_robot("fish"), seed=0, segments=segments(tmp_path / "diary"))
    found = collect(plan, tmp_path / "ray", SETUP, pool=local, quiet=True)
    assert found.complete and found.run == 6 and local.deaths == 0
    assert begun(tmp_path / "diary") == {f"e{i}": 1 for i in range(6)}
    data = open_dataset(tmp_path / "ray")
    assert data.names("train") == [f"e{i}" for i in range(1, 6)]

    class Here:
        def run(self, waiting, setup, go_on):
            return (ray_toys.toy(segment, setup) for segment in waiting)

    collect(plan, tmp_path / "here", SETUP, pool=Here(), quiet=True)
    for name in data.names("train"):
        assert (tmp_path / f"ray/segments/{name}.npz").read_bytes() == (tmp_path / f"here/segments/{name}.npz").read_bytes()


@pytest.mark.ray
def test_a_worker_that_is_killed_loses_only_its_segment(tmp_path, two, capsys):
    plan = CampaignPlan(label="toy", robot=load_robot("fish"), seed=0, segments=segments(tmp_path / "diary", e2=1, e4=ATTEMPTS))
    found = collect(plan, tmp_path / "data", SETUP, pool=two, quiet=True)
    assert found.run == 5 and found.missing == 1 and not found.complete
    assert begun(tmp_path / "diary") == {"e0": 1, "e1": 1, "e2": 2, "e3": 1, "e4": ATTEMPTS, "e5": 1}
    assert two.deaths == 1 + ATTEMPTS and dict(two.retried) == {"e2": 1, "e4": ATTEMPTS}
    assert f"given up after {ATTEMPTS} workers died over them: e4" in capsys.readouterr().err
    assert "e4" not in open_dataset(tmp_path / "data").about


@pytest.mark.ray
def test_a_task_may_hold_several_segments(tmp_path, two):
    two.tanks = 3
    done = list(two.run(deque(segments(tmp_path / "diary", 5)), SETUP, lambda water: True))
    assert sorted(item.segment.id for item in done) == [f"e{i}" for i in range(5)]


@pytest.mark.ray
@pytest.mark.oracle
def test_a_worker_with_water_records_what_this_process_records(cluster):
    small = Setup(domain=replace(preset("laptop"), shape=(60, 36, 16)), device="cpu")
    gait = {"kind": "gait", "frequency": 1.5, "amplitude": 0.4, "lag": 1.0, "bias": 0.3, "ramp": 0.1}
    swim = Segment(id="swim", block="gait", episode="swim", split="train", seconds=0.24, drive=gait)
    (there,), (here,) = (list(pool.run(deque([swim]), small, lambda water: True)) for pool in (RayPool("auto"), Local()))
    assert there.segment == here.segment and there.meta["start"] == here.meta["start"]
    for name, values in here.arrays.items():
        np.testing.assert_array_equal(there.arrays[name], values)


@pytest.mark.ray
def test_a_cluster_without_a_gpu_says_so(two):
    with pytest.raises(ConfigError, match="the cluster has no GPU"):
        list(two.run(deque(), Setup(domain=preset("laptop"), device="cuda"), lambda water: True))
