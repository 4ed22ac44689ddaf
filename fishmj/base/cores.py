"""Number of usable cores, threads of linear algebra, and memory of the machine."""

import os
from collections.abc import Iterator
from contextlib import contextmanager


def usable_cores() -> int:
    """Number of cores that this process may run on (its affinity, where the system reports it)."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """NumPy's and SciPy's linear algebra in one thread: on small matrices its threads spend their time waiting for each other."""
    from threadpoolctl import threadpool_limits  # here: the doctor counts cores where nothing is installed

    with threadpool_limits(limits=1, user_api="blas"):
        yield


def memory_bytes() -> int:
    """Memory of this machine in bytes; where the system does not report it, a number too large to refuse anything."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return 2**62
