"""The same draws on every run, no time limit that a busy machine could break, and a bound on the CPU time of quick tests.

A test without the mark `slow` takes at most 5 s of CPU, its child processes included: CPU time, because wall time is
also that of the other work on the machine. It fails above `OF_A_TEST`, twice that: a machine may be half as fast.
Where the speed of the machine is not known, `FISHMJ_SLOWNESS` multiplies all bounds (`.ci/run` sets 3). `FISHMJ_SHARE`
runs a part of the files, so that a slow tier is spread over several runs. What a setup
makes may be shared by a file or by all files and has `OF_SHARED`; one part of the product from end to end (mark
`part`) has `OF_A_PART`. A test during which something was compiled that is kept between runs (`fishmj.machine_code`,
numba, Warp, null runs of the search) is not judged: the next run does so.
"""

import os
import resource
import signal
import time
from importlib.metadata import version
from pathlib import Path

import pytest
from hypothesis import settings
from packaging.version import Version

from fishmj import machine_code

os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")  # s; JAX's own default is for longer programs
# A test's programs run for milliseconds: XLA compiles them in a third of the time where it does not optimise them.
# XLA ends a process at a flag that it does not know; jaxlib 0.11 has no longer that of the emitters.
EMITTERS = "--xla_cpu_use_fusion_emitters=false " if Version(version("jaxlib")) < Version("0.11") else ""
QUICKLY = f"--xla_backend_optimization_level=0 {EMITTERS}--xla_cpu_parallel_codegen_split_count=1"
os.environ.setdefault("XLA_FLAGS", f"{QUICKLY} --xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")

# A command in the background of a script ignores Ctrl-C, and one under nohup a closed terminal; what tests start shall not.
for asked in (signal.SIGINT, signal.SIGHUP):
    if signal.getsignal(asked) is signal.SIG_IGN:
        signal.signal(asked, signal.default_int_handler if asked == signal.SIGINT else signal.SIG_DFL)

settings.register_profile("fishmj", derandomize=True, deadline=None)
settings.load_profile("fishmj")

SLOWNESS = float(os.environ.get("FISHMJ_SLOWNESS", "1"))
OF_A_TEST, OF_SHARED, OF_A_PART = 10.0 * SLOWNESS, 120.0 * SLOWNESS, 120.0 * SLOWNESS  # s of CPU
LONGEST = "test_whole_loop.py"
GRAIN = 0.01  # s, that the stamp of a folder may be behind the clock
SHARE, SHARES = map(int, os.environ.get("FISHMJ_SHARE", "1/1").split("/"))  # 2/5: every fifth file of tests, from the second on
UNBOUNDED = ("slow", "gpu", "sb3", "ray")  # marks of what the default run leaves out

_HOME = machine_code.cache_folder()
_WARP = Path(os.environ.get("WARP_CACHE_PATH") or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "warp")
_KEPT = (_HOME, _HOME / "__pycache__", Path(os.environ.get(machine_code.JAX) or _HOME / "jax"), _HOME / "null")
_SOURCES = Path(machine_code.__file__).parent


def spent() -> float:
    """CPU seconds of this process and of its children that have ended."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def compiled_since(moment: float) -> bool:
    """Has anything been written since then, s of the clock, that is compiled once and kept?"""
    folders = (*_KEPT, *_WARP.glob("*"), *_SOURCES.rglob("__pycache__"))
    return any(folder.is_dir() and folder.stat().st_mtime > moment - GRAIN for folder in folders)


def bounded(item: pytest.Item, bound: float, what: str):
    """Runs a phase of a test; fails it where it took more CPU than `bound`, in s, and nothing was compiled in it."""
    if any(item.get_closest_marker(mark) for mark in UNBOUNDED):
        return (yield)
    moment, began = time.time(), spent()
    result = yield
    took = spent() - began
    if took > bound and not compiled_since(moment):
        pytest.fail(f"{what} took {took:.1f} s of CPU, at most {bound:g} s: make it cheaper, or mark it slow", pytrace=False)
    return result


def pytest_collection_modifyitems(config, items):
    """The longest file first: begun last, it keeps one worker busy for minutes while the others have nothing left to do.

    Of a share of the tests only the files of that share.
    """
    items.sort(key=lambda item: item.path.name != LONGEST)
    mine = set(sorted({item.path.name for item in items})[SHARE - 1 :: SHARES])
    if others := [item for item in items if item.path.name not in mine]:
        config.hook.pytest_deselected(items=others)
        items[:] = [item for item in items if item.path.name in mine]


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup(item):
    return (yield from bounded(item, OF_SHARED, "the setup"))


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_call(item):
    return (yield from bounded(item, OF_A_PART if item.get_closest_marker("part") else OF_A_TEST, "the test"))
