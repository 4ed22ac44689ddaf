"""Number of usable cores, and memory of the machine."""

import os


def usable_cores() -> int:
    """Number of cores that this process may run on (its affinity, where the system reports it)."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def memory_bytes() -> int:
    """Memory of this machine in bytes; where the system does not report it, a number too large to refuse anything."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return 2**62
