"""Machine code is kept between runs: a second process compiles nothing again, and what the environment says goes."""

import os
import subprocess
import sys

import pytest

from fishmj.base import compile_cache

PROGRAM = """
import fishmj, jax
events = []
jax.monitoring.register_event_listener(lambda event, **_: events.append(event.rpartition("/")[2]))
jax.jit(lambda x: x * x + 1)(2.0).block_until_ready()
print(events.count("cache_hits"), events.count("cache_misses"))
"""


@pytest.fixture
def bare(monkeypatch, tmp_path):
    """A process that has neither imported JAX nor been told where to keep its programs."""
    monkeypatch.delitem(sys.modules, "jax", raising=False)
    monkeypatch.delenv(compile_cache.JAX, raising=False)
    monkeypatch.setenv("FISHMJ_CACHE", str(tmp_path / "made" / "later"))
    yield monkeypatch
    os.environ.pop(compile_cache.JAX, None)  # what `keep` has set; monkeypatch puts the one before back


def test_jax_keeps_its_programs_below_the_folder_of_fishmj(bare, tmp_path):
    compile_cache.keep()
    assert os.environ[compile_cache.JAX] == str(tmp_path / "made" / "later" / "jax")
    assert not (tmp_path / "made").exists(), "an import makes no folder"


@pytest.mark.parametrize("chosen", ("/elsewhere", ""))
def test_a_folder_that_the_user_chose_stays(bare, chosen):
    bare.setenv(compile_cache.JAX, chosen)
    compile_cache.keep()
    assert os.environ[compile_cache.JAX] == chosen


def test_nothing_is_kept_where_nothing_can_be_written(bare):
    bare.setenv("FISHMJ_CACHE", __file__)
    compile_cache.keep()
    assert compile_cache.JAX not in os.environ


COMPILED_FIRST = "import jax\njax.jit(lambda x: x + 2)(1.0).block_until_ready()\n"


@pytest.mark.parametrize("before", ("", COMPILED_FIRST))
def test_second_process_compiles_nothing_again(tmp_path, before):
    env = {key: value for key, value in os.environ.items() if key != compile_cache.JAX}
    env |= {"FISHMJ_CACHE": str(tmp_path), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    begin = lambda: subprocess.run([sys.executable, "-c", before + PROGRAM], env=env, capture_output=True, text=True, check=True)
    (hits, misses), (hits_again, misses_again) = (map(int, begin().stdout.split()) for _ in range(2))
    assert hits == 0 and misses > 0 and (hits_again, misses_again) == (misses, 0)


def test_folder_set_in_jax_config_stays(tmp_path):
    chosen = f"import jax\njax.config.update('jax_compilation_cache_dir', {str(tmp_path / 'mine')!r})\nimport fishmj\n"
    env = {key: value for key, value in os.environ.items() if key != compile_cache.JAX}
    told = "print(jax.config.jax_compilation_cache_dir)"
    done = subprocess.run([sys.executable, "-c", chosen + told], env=env, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(tmp_path / "mine")


SWIM = """
import jax, numpy as np
from fishmj import engines
from fishmj.engines.compiled import CompiledEngine
from fishmj.water.flow import Current
events = []
jax.monitoring.register_event_listener(lambda event, **_: events.append(event.rpartition("/")[2]))
engine, rest = CompiledEngine("fish", threads=1), np.zeros((2, 2), np.float32)
lean = lambda tree: jax.tree.map(lambda a: np.asarray(a, np.float32), tree)
state, params = lean(engines.at_rest(engine.robot, np.zeros((2, 3)))), lean(engines.nominal_params(engine.robot, 2))
params = params._replace(delay=np.zeros(2, int))
current = Current(rest, rest[0], np.zeros(2, int), rest, rest, np.zeros((1, 4, 4, 2), np.float32), np.float32(0.1))
commands = np.full((2, 10, 3), 0.3, np.float32)
after, _ = jax.jit(engine.advance)(state, commands, params, current, np.zeros(2, int))
print(events.count("cache_hits"), events.count("cache_misses"), np.asarray(after.q).tobytes().hex())
"""


def test_compiled_engine_program_is_cached_and_gives_the_same_result(tmp_path):
    pytest.importorskip("numba")
    env = {**os.environ, compile_cache.JAX: str(tmp_path), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    begin = lambda: subprocess.run([sys.executable, "-c", SWIM], env=env, capture_output=True, text=True, check=True)
    (hits, misses, q), (hits_again, misses_again, q_again) = (begin().stdout.split() for _ in range(2))
    assert hits == "0" and int(misses) > 0 and (hits_again, misses_again) == (misses, "0") and q == q_again
