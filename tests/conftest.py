"""The same draws on every run, and the slowest tests by CPU time at the end of a run. No test fails because of time.

A test without the mark `slow` should take at most 5 s of CPU, its child processes included. The end of a run lists the
ten slowest and says which of them should be marked. CPU time, because wall time also holds the other work on the machine.
`FISHMJ_SHARE` runs a part of the files, so that a slow tier is spread over several runs.
"""

import gc
import os
import resource
import signal
import time
from importlib.metadata import version
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from packaging.version import Version

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when NumPy is imported; its threads spin, and tests run side by side
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

# no test fails because the machine is slow: neither by a deadline nor by the time that examples take to draw
settings.register_profile("fishmj", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("fishmj")

QUICK, LISTED = 5.0, 10  # s of CPU of a test without the mark `slow`; tests listed at the end
LONGEST = "test_whole_loop.py"
SHARE, SHARES = map(int, os.environ.get("FISHMJ_SHARE", "1/1").split("/"))  # 2/5: every fifth file of tests, from the second on


def spent() -> float:
    """CPU seconds of this process and of its children that have ended."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


@pytest.fixture
def catalogue():
    """The catalogue of effects, afterwards as it was: an own effect joins it for the rest of the process."""
    from fishmj import effects

    before = dict(effects.catalogue())
    yield effects.catalogue()
    effects.catalogue().clear()
    effects.catalogue().update(before)


@pytest.fixture(scope="module")
def cluster():
    """A Ray cluster of two workers for all tests of a file, which can import what tests import: starting Ray takes longest."""
    here = Path(__file__).parent
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", f"{here}:{here.parent}")
        ray = pytest.importorskip("ray")
        ray.init("local", num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="error")
        yield
        ray.shutdown()


def pytest_collection_modifyitems(config, items):
    """The longest file first: begun last, it keeps one worker busy for minutes while the others have nothing left to do.

    Of a share of the tests only the files of that share.
    """
    items.sort(key=lambda item: item.path.name != LONGEST)
    mine = set(sorted({item.path.name for item in items})[SHARE - 1 :: SHARES])
    if others := [item for item in items if item.path.name not in mine]:
        config.hook.pytest_deselected(items=others)
        items[:] = [item for item in items if item.path.name in mine]


def pytest_collection_finish(session):
    """Leaves modules and tests, which live to the end, out of garbage collection, and collects the rest less often."""
    gc.collect()
    gc.freeze()
    gc.unfreeze = lambda: None  # a swim ends with it, and the next one begins with a collection of everything
    gc.set_threshold(100_000, 20, 20)  # Python's own: 700 objects; traces of JAX hold millions


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_call(item):
    began = spent()
    try:
        return (yield)
    finally:
        item.user_properties.append(("cpu_s", spent() - began))


def pytest_terminal_summary(terminalreporter):
    """Lists the slowest tests; workers of pytest-xdist send their figures with their reports."""
    calls = [r for kind in ("passed", "failed") for r in terminalreporter.stats.get(kind, ()) if r.when == "call"]
    rows = sorted(((dict(r.user_properties)["cpu_s"], r) for r in calls), key=lambda row: -row[0])[:LISTED]
    if rows:
        terminalreporter.section(f"slowest {len(rows)} tests, s of CPU")
    for seconds, report in rows:
        mark = seconds > QUICK and not {"slow", "part", "gpu", "sb3", "ray"} & set(report.keywords)
        terminalreporter.line(f"{seconds:7.1f}  {report.nodeid}{'  <- over 5 s: cheaper, or marked slow?' if mark else ''}")
