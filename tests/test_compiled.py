"""The compiled engine is the closed form: same physics, same ticks, vector code, safe cache.

Tolerances: float64 differs from the closed form by rounding only (1e-12 a step). float32 carries 24 bits, so 1e-6 relative to
the largest entry a step; over 20 control steps (4 s, 1,000 physics steps) the two float32 engines part by less than 5e-5.
"""

import platform
import re
import sys
import threading
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

numba = pytest.importorskip("numba", reason='the compiled engine needs pip install "fishmj[fast]"')

from fishmj import engines
from fishmj.base.compile_cache import cache_folder
from fishmj.base.errors import ConfigError, MissingExtra
from fishmj.engines import FishParams, compiled, numba_build, planar
from fishmj.mjcf.reading import load_robot
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import draw, table_of

ROBOT = load_robot("fish")
RAMPED = replace(ROBOT, timing=replace(ROBOT.timing, command_path="move_time"))


@pytest.fixture(scope="module")
def engine():
    """float32, two threads."""
    return compiled.CompiledEngine(ROBOT, threads=2)


@pytest.fixture(scope="module")
def double():
    """float64 with the servo's timed moves."""
    return compiled.CompiledEngine(RAMPED, threads=2, dtype="float64")


def varied(batch, turbulence="default", seed=0, dtype=np.float64):
    """State, parameters and flow of `batch` different fish, some with latencies of several ticks."""
    rng = np.random.default_rng(seed)
    pose = np.stack([rng.uniform(-1.5, 1.5, batch), rng.uniform(-1.5, 1.5, batch), rng.uniform(-4, 4, batch)], -1)
    state = engines.at_rest(ROBOT, pose)
    state = state._replace(v=0.2 * rng.normal(size=state.v.shape), buffer=rng.uniform(-0.5, 0.5, state.buffer.shape))
    params = engines.nominal_params(ROBOT, batch)
    vary = lambda a, share: a * rng.uniform(1 - share, 1 + share, a.shape)
    params = FishParams(
        *(vary(a, 0.2) for a in params[:4]),
        rng.uniform(-0.09, 0.09, (batch, 3)),
        vary(params.water, 0.2),
        None,
        params.effects,
        params.net,
    )
    params = params._replace(delay=rng.integers(0, 40, batch).astype(np.int32))
    table, cell = table_of(turbulence)
    speed, direction, uniforms = rng.uniform(0.1, 0.3, batch), rng.uniform(-3, 3, batch), rng.random((batch, 4))
    current = draw(np, turbulence, table, cell, speed, direction, 0.1, uniforms)
    cast = lambda tree: type(tree)(*(np.asarray(a, dtype) if np.asarray(a).dtype == float else a for a in tree))
    return cast(state), cast(params), cast(current)


def commands_of(batch, seed, ticks=10):
    """Bus commands, some beyond the servo's range."""
    return np.random.default_rng(seed).uniform(-1.2, 1.2, (batch, ticks, 3)).astype(np.float32)


def worst(a, b):
    """Largest difference over all leaves of two (state, trace)."""
    pairs = zip(jax.tree_util.tree_leaves(a), jax.tree_util.tree_leaves(b), strict=True)
    return max(float(np.abs(np.asarray(x, float) - np.asarray(y, float)).max(initial=0.0)) for x, y in pairs)


def swum_apart(fast, reference, turbulence, chunks, dtype):
    """Largest difference between two engines over `chunks` control steps, both from the same start."""
    state, params, current = varied(37, turbulence, dtype=dtype)
    if dtype == np.float64:  # JAX divides int32, and subtracts rows of a float32 table, in float32
        params = params._replace(delay=params.delay.astype(np.int64))
        current = current._replace(table=current.table.astype(float))
    one = two = state
    apart = 0.0
    for k in range(chunks):
        tick, commands = np.arange(37, dtype=np.int32) + 10 * k, commands_of(37, k).astype(dtype)
        one, trace_one = fast.advance(one, commands, params, current, tick)
        two, trace_two = reference.advance(two, commands, params, current, tick)
        apart = max(apart, worst((one, trace_one), (two, trace_two)))
    return apart


@pytest.mark.parametrize("turbulence", ["default", "gust"])
def test_twenty_control_steps_equal_the_jax_engine(engine, turbulence):
    assert swum_apart(engine, planar.PlanarEngine(ROBOT), turbulence, 20, np.float32) < 5e-5


def test_in_double_precision_the_difference_is_round_off(double):
    with jax.enable_x64(True):
        assert swum_apart(double, planar.PlanarEngine(RAMPED), "default", 5, np.float64) < 1e-10


def test_applied_force_attachment_and_power_are_those_of_chain_step(engine):
    rng = np.random.default_rng(11)
    batch = 300
    state, params, _ = varied(batch)
    q, target = state.q + 0.3 * rng.normal(size=state.q.shape), rng.normal(size=(batch, 3))
    flow, ambient = 0.3 * rng.normal(size=(batch, 4, 2)), rng.normal(size=(batch, 2))
    got = engine.forces(q, state.v, state.attached, params, target, flow, ambient)
    columns = lambda a: list(np.moveaxis(a, -1, 0))
    links = [(flow[:, i, 0], flow[:, i, 1]) for i in range(4)]
    swimmer = engines.swimmer(params)
    fish = (columns(q), columns(state.v), state.attached, columns(target), links, columns(ambient))
    want = planar_chain.step(np, planar_chain.chain_of(ROBOT), swimmer, *fish)
    for mine, theirs in ((got.force, np.stack(want.applied, -1)), (got.attached, want.attached), (got.power, want.power)):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-12 * max(1.0, np.abs(theirs).max()))


def test_a_fish_swims_the_same_in_any_batch_and_with_any_threads(engine):
    state, params, current = varied(600, dtype=np.float32)
    commands, tick = commands_of(600, 1), np.arange(600)
    whole = engine.advance(state, commands, params, current, tick)
    single = compiled.CompiledEngine(ROBOT, threads=1)
    single.__dict__["_advance"] = engine._advance
    assert worst(whole, single.advance(state, commands, params, current, tick)) == 0.0
    pick = lambda tree: jax.tree_util.tree_map(lambda a: a[401:404] if np.ndim(a) and len(a) == 600 else a, tree)
    assert worst(pick(whole), engine.advance(*(pick(part) for part in (state, commands, params, current, tick)))) == 0.0


def test_inputs_stay_as_they_were(engine):
    state, params, current = varied(20, dtype=np.float32)
    before = jax.tree_util.tree_map(np.array, (state, params, current))
    engine.advance(state, commands_of(20, 1), params, current, np.zeros(20, int))
    assert worst(before, (state, params, current)) == 0.0


def test_inside_jit_and_scan_it_gives_the_same_bits(engine):
    state, params, current = varied(40, dtype=np.float32)
    chunks, start = np.stack([commands_of(40, k) for k in range(5)]), np.zeros(40, np.int32)

    @jax.jit
    def swim(state, chunks, params, current):
        def one(carry, commands):
            state, trace = engine.advance(carry[0], commands, params, current, carry[1])
            return (state, carry[1] + 10), trace

        return jax.lax.scan(one, (state, start), chunks)

    (state_jax, _), traces = swim(state, chunks, params, current)
    for k in range(5):
        state, trace = engine.advance(state, chunks[k], params, current, start + 10 * k)
        assert worst(trace, jax.tree_util.tree_map(lambda a, k=k: a[k], traces)) == 0.0
    assert worst(state, state_jax) == 0.0


def test_under_vmap_every_entry_swims(engine):
    state, params, current = varied(8, dtype=np.float32)
    chunks, tick = jnp.stack([commands_of(8, k) for k in range(3)]), np.zeros(8, np.int32)
    many = jax.jit(jax.vmap(lambda c: engine.advance(state, c, params, current, tick)[0].q))(chunks)
    for k in range(3):
        assert worst(many[k], engine.advance(state, chunks[k], params, current, tick)[0].q) == 0.0


def test_many_programs_in_flight_do_not_deadlock(engine):
    state, params, current = jax.tree_util.tree_map(jnp.asarray, varied(512, dtype=np.float32))
    tick, commands = jnp.zeros(512, int), jnp.asarray(commands_of(512, 0))
    swim = jax.jit(lambda s: engine.advance(s, commands, params, current, tick)[0])
    again = lambda: [jax.block_until_ready(swim(state)) for _ in range(10)]
    workers = [threading.Thread(target=again, daemon=True) for _ in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(600)
    assert not any(worker.is_alive() for worker in workers)


def test_a_lost_fish_harms_no_other(engine):
    state, params, current = varied(20, dtype=np.float32)
    commands, tick = commands_of(20, 1), np.zeros(20, int)
    sound = engine.advance(state, commands, params, current, tick)[0].q
    state.q[3] = [np.nan, np.inf, np.nan, 0, 0, 0]
    lost = engine.advance(state, commands, params, current, tick)[0].q
    assert np.isnan(lost[3]).any() and worst(np.delete(lost, 3, 0), np.delete(sound, 3, 0)) == 0.0


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="reads x86 assembly")
def test_the_physics_runs_in_vector_registers(monkeypatch):
    """Compiled here: machine code that comes from the cache has no assembly to read, and a folder that is a file holds none."""
    monkeypatch.setenv("FISHMJ_CACHE", __file__)
    for name in [n for n in sys.modules if n.startswith("fishmj_")]:
        monkeypatch.delitem(sys.modules, name)
    text = next(iter(compiled.CompiledEngine(ROBOT)._advance.inspect_asm().values()))
    physics = re.search(r"^(\w*7physics\w*):(.*?)\.size\s+\1", text, re.S | re.M)[2]
    vector, scalar = (len(re.findall(rf"\sv?(?:mul|f[n]?m(?:add|sub)\d+){kind}\s", physics)) for kind in ("ps", "ss"))
    assert vector > 400 and scalar == 0 and "sqrtps" in physics


BAD = {
    "params.kp: got shape .*expected \\(8, 3\\)": dict(params=dict(kp=np.ones((8, 2)))),
    "params.delay: got -1 physics steps": dict(params=dict(delay=np.full(8, -1))),
    "state.buffer: got shape": dict(state=dict(buffer=np.zeros((8, 4, 3)))),
    "current.row: got 0 to 64, expected slices 0 to 63": dict(current=dict(row=np.arange(8) // 7 * 64)),
    "current.table: got shape \\(2, 3\\)": dict(current=dict(table=np.zeros((2, 3)))),
}


@pytest.mark.parametrize("message", BAD)
def test_wrong_arrays_are_one_clear_error(engine, message):
    given = dict(zip(("state", "params", "current"), varied(8), strict=True))
    for name, fields in BAD[message].items():
        given[name] = given[name]._replace(**fields)
    with pytest.raises(ConfigError, match=message):
        engine.advance(given["state"], commands_of(8, 0), given["params"], given["current"], np.zeros(8, int))


def test_without_numba_the_error_has_the_install_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    with pytest.raises(MissingExtra, match=r'pip install "fishmj\[fast\]"'):
        engines.make("compiled")


def test_what_was_compiled_is_kept(double):
    name = double._advance.py_func.__module__
    assert (cache_folder() / f"{name}.py").is_file() and list(cache_folder().rglob(f"{name}.advance*.nbc"))


def test_the_first_process_loads_its_code_as_later_ones_do(tmp_path, monkeypatch):
    """Code that numba has just compiled rounds otherwise than the same code from its cache."""
    monkeypatch.setenv("FISHMJ_CACHE", str(tmp_path))
    text = "from numba import int64, njit\n\n\n@njit(int64(int64), cache=CACHE)\ndef next_to(x):\n    return x + 1\n"
    module = numba_build.compiled(text, typed=True)
    assert module.next_to(2) == 3
    assert (module.next_to.stats.cache_hits.total(), module.next_to.stats.cache_misses.total()) == (1, 0)


def test_a_torn_module_is_rewritten(tmp_path, monkeypatch):
    monkeypatch.setenv("FISHMJ_CACHE", str(tmp_path))
    path = Path(numba_build.compiled("from numba import njit\n\n\n@njit(cache=CACHE)\ndef one():\n    return 1\n").__file__)
    whole = path.read_text()
    path.write_text(whole[:20])
    assert numba_build.keep(path, whole) == path and path.read_text() == whole


def test_what_fails_on_the_host_is_one_error_of_the_program():
    """In a program, too, a flow row outside the table is refused with the engine's words; nothing is computed from it."""
    import jax

    given = dict(zip(("state", "params", "current"), varied(8), strict=True))
    current = given["current"]._replace(row=np.full(8, 10**6))
    program = jax.jit(compiled.CompiledEngine(ROBOT).advance)
    with pytest.raises(Exception, match="ConfigError: current.row: got .* expected slices 0 to"):
        jax.block_until_ready(program(given["state"], commands_of(8, 0), given["params"], current, np.zeros(8, int)))
