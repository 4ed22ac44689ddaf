"""Workers of a Ray cluster: what is sent, what comes back, and errors that a user can mend. Two workers on this machine."""

import os
import socket
import sys
import threading
import time
import types
from collections import deque
from pathlib import Path

import pytest

from fishmj.base import ray_cluster
from fishmj.base.errors import ConfigError, OracleUnstable
from fishmj.base.ray_cluster import RayCluster, RayTask, refuse_own_code, report

HERE = Path(__file__).parent


def spread(work, number=3, **options):
    tasks = deque(RayTask(f"t{i}", i) for i in range(number))
    return {task.id: result for task, result in RayCluster("auto").spread(work, tasks, device="cpu", **options)}


def test_code_of_the_user_is_refused_by_name():
    refuse_own_code([])
    with pytest.raises(ConfigError, match=r"no code of your own \(mine.py:Brain, --effects\); leave --ray out"):
        refuse_own_code(["mine.py:Brain", "--effects"])


def test_progress_outside_a_worker_goes_nowhere():
    assert report(3.0) is True


def test_an_address_without_a_cluster_is_refused_at_once(monkeypatch):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    with pytest.raises(OSError, match="refused"):
        ray_cluster._answers(address)
    for other in ("auto", "no-port"):
        ray_cluster._answers(other)


@pytest.mark.ray
@pytest.mark.parametrize("address", ["127.0.0.1:1", "local:0", "rubbish"])
def test_an_address_that_is_none_says_what_works(address):
    with pytest.raises(ConfigError, match=f"ray: .*{address}"):
        list(RayCluster(address).spread(print, deque([RayTask("t", 0)])))


@pytest.mark.ray
def test_progress_of_busy_workers_is_summed(cluster, tmp_path):
    flags, seen = [tmp_path / name for name in "ab"], []

    def work(tasks):
        while not tasks[0].given.exists():  # until the caller has seen the progress of both
            report(2.0)
            time.sleep(0.05)
        yield tasks[0].id, "done"

    def look(done):
        seen.append(done)
        if done == 4.0:
            for flag in flags:
                flag.touch()
        return True

    tasks = deque(RayTask(flag.name, flag) for flag in flags)
    found = list(RayCluster("auto").spread(work, tasks, device="cpu", go_on=look))
    assert sorted(task.id for task, _ in found) == ["a", "b"] and 4.0 in seen


@pytest.mark.ray
def test_results_of_a_group_arrive_and_are_not_made_again(cluster, tmp_path):
    def work(tasks):
        for name, folder in tasks:
            with (folder / name).open("a") as diary:
                diary.write("x")
            yield name, folder
            if name == "b" and (folder / "b").read_text() == "x" and not (folder / "c").exists():
                os._exit(1)

    cluster = RayCluster("auto", workers=1)
    tasks = deque(RayTask(name, tmp_path) for name in "abc")
    found = [task.id for task, _ in cluster.spread(work, tasks, device="cpu", group=3)]
    assert sorted(found) == ["a", "b", "c"] and cluster.deaths == 1
    assert (tmp_path / "a").read_text() == "x", "what had come back is not made again"


@pytest.mark.ray
def test_errors_of_the_work_arrive_unchanged(cluster, capsys):
    def work(tasks):
        yield from ()
        raise OracleUnstable("too fast", limit="mach")

    with pytest.raises(OracleUnstable, match="too fast") as found:
        spread(work, 1)
    assert found.value.limit == "mach" and "failed with t0" in capsys.readouterr().err


@pytest.mark.ray
def test_workers_with_another_fishmj_are_refused(cluster, monkeypatch):
    monkeypatch.setattr(ray_cluster, "package_sha256", lambda: "another")
    with pytest.raises(ConfigError, match="whose files are not those here; install the same fishmj"):
        spread(report)


@pytest.mark.ray
def test_what_cannot_be_sent_is_refused(cluster):
    lock = threading.Lock()
    with pytest.raises(ConfigError, match="cannot be sent to a worker"):
        spread(lambda tasks: lock)


@pytest.mark.ray
def test_a_worker_that_cannot_start_is_not_tried_again(cluster, monkeypatch):
    def work(tasks):
        yield

    module = types.ModuleType("on_this_machine_only")
    module.work, work.__module__, work.__qualname__ = work, module.__name__, "work"
    monkeypatch.setitem(sys.modules, module.__name__, module)
    with pytest.raises(ConfigError, match="a worker cannot start .*on_this_machine_only"):
        spread(work)


@pytest.mark.ray
def test_tasks_that_no_worker_ended_are_named(cluster):
    def work(tasks):
        if tasks[0].given == 1:
            os._exit(1)
        yield tasks[0].id, tasks[0].given

    one = RayCluster("auto")
    assert [result for _, result in one.spread(work, deque(RayTask(f"t{i}", i) for i in range(2)), device="cpu")] == [0]
    with pytest.raises(ConfigError, match="no worker ended t1; all others are kept"):
        one.check()
