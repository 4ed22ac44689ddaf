"""Does one piece of work for each of many inputs, a process and a core each.

A search or a roll-out in NumPy leaves most of a second core idle. Each process is bound to one core, so that everything in it
(rollouts, BLAS, null runs) uses one thread.
"""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import active_children, get_context
from typing import Any

from fishmj.base.cores import usable_cores
from fishmj.base.processes import bind, ends_with_its_parent, sigint_blocked

ALONE = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
    "JAX_PLATFORMS": "cpu",
}


def ask_all(todo: list, ask: Callable[..., Any], jobs: int) -> Iterator[Any]:
    """Results of `ask` for each of `todo`, as they are done; both must be picklable. With one job it runs here, in order.

    Raises:
        the error of `ask`, once; the others are stopped at once, as by Ctrl-C.
    """
    if jobs <= 1 or len(todo) < 2:
        yield from map(ask, todo)
        return
    context, others = get_context("spawn"), active_children()
    with one_thread(), sigint_blocked():
        pool = ProcessPoolExecutor(min(jobs, len(todo)), context, bound, (context.Value("i", 0),))
        waiting = [pool.submit(ask, one) for one in todo]
    try:
        for done in as_completed(waiting):
            yield done.result()
    except BaseException:
        for child in active_children():
            if child not in others:
                child.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def one_thread() -> Iterator[None]:
    """Context in which started processes find libraries set to one thread; existing settings stay."""
    before = dict(os.environ)
    os.environ.update({key: value for key, value in ALONE.items() if key not in before})
    try:
        yield
    finally:
        for key in ALONE.keys() - before.keys():
            del os.environ[key]


def bound(begun) -> None:
    """First call in each process: binds it to its own core, and ends it with its parent. begun: counter of the processes."""
    ends_with_its_parent()
    with begun.get_lock():
        number, begun.value = begun.value, begun.value + 1
    bind(number, usable_cores())
