"""Threads of linear algebra."""

from argparse import Namespace

import numpy as np
import pytest
import scipy.linalg
from threadpoolctl import threadpool_info, threadpool_limits

from fishmj.base.cores import one_blas_thread
from fishmj.gap.commands import find_robot


def blas_threads() -> set[int]:
    scipy.linalg.inv(np.eye(2))
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_blas_has_one_thread_inside_and_its_own_again_after_an_error():
    with threadpool_limits(limits=2, user_api="blas"):
        before = blas_threads()
        with pytest.raises(ZeroDivisionError), one_blas_thread():
            assert blas_threads() == {1}
            raise ZeroDivisionError
        assert blas_threads() == before


def test_search_of_a_robot_takes_one_blas_thread(monkeypatch):
    seen: list[set[int]] = []

    def gates():
        seen.append(blas_threads())
        raise ZeroDivisionError

    monkeypatch.setattr(find_robot, "robot_gates", gates)
    with threadpool_limits(limits=2, user_api="blas"), pytest.raises(ZeroDivisionError):
        find_robot.search(None, [], Namespace())
    assert seen == [{1}]
