"""A Ray cluster of several machines, which here are processes: one leaves while its worker is busy."""

from collections import deque
from pathlib import Path

import pytest

from fishmj.base.ray_cluster import RayCluster, RayTask, report

HERE = Path(__file__).parent


@pytest.mark.ray
def test_a_machine_that_leaves_the_cluster_loses_only_its_task(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PYTHONPATH", f"{HERE}:{HERE.parent}")
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    machines = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    leavers = [machines.add_node(num_cpus=1) for _ in range(2)]

    def work(tasks):
        import time

        (task,) = tasks
        with (tmp_path / task.id).open("a") as diary:
            diary.write("x")
        while not (tmp_path / "go").exists():
            time.sleep(0.05)
        yield task.id, report(1.0)

    def look(done):
        if len(list(tmp_path.glob("t*"))) == 2 and len(leavers) == 2:
            ours = ray.get_runtime_context().get_node_id()
            leavers.remove(leaver := next(node for node in leavers if node.unique_id != ours))
            machines.remove_node(leaver, allow_graceful=False)
        if some.deaths:
            (tmp_path / "go").touch()
        return True

    some = RayCluster(machines.address)
    try:
        tasks = deque(RayTask(f"t{i}", None) for i in range(3))
        found = sorted(task.id for task, _ in some.spread(work, tasks, device="cpu", go_on=look))
    finally:
        machines.shutdown()
    assert found == ["t0", "t1", "t2"] and sorted(some.retried.values()) == [1] and not some.given_up
    assert sorted(len((tmp_path / name).read_text()) for name in found) == [1, 1, 2]
    assert "a worker died" in capsys.readouterr().err
