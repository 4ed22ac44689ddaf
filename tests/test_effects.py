"""The catalogue of effects: the identity at its null bit for bit, one definition for every engine, and what is kept of it."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fishmj import effects
from fishmj.base import console
from fishmj.base.calib import calib_folder
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.effects import EffectStack, ambiguity, effect_calibration
from fishmj.effects import __main__ as verb
from fishmj.effects.effect import Effect, Parameter
from fishmj.effects.effect_calibration import FittedEffect, Interval
from fishmj.effects.randomise import draw
from fishmj.effects.robot_scales import QUANTITIES
from fishmj.effects.sites import BodyMotion, FlowAt, Gear, LocalWater, SensorReadings, ServoDrive
from fishmj.effects.stack import delivered
from fishmj.log import excitation
from fishmj.mjcf.reading import load_robot
from fishmj.water.dynamics import planar_chain
from fishmj.water.dynamics.hooks import Effects

CATALOGUE = effects.catalogue()
EVERY = list(CATALOGUE.values())
LASTING = [e for e in EVERY if not e.stochastic]
DOCS = calib_folder().parent.parent / "docs" / "simulate" / "effects.md"


def states(robot, size: int, seed: int):
    """Chain, swimmer and the arguments of a step for `size` random fish."""
    ch, sw, rng = planar_chain.chain_of(robot), planar_chain.nominal(robot), np.random.default_rng(seed)
    q, v = rng.normal(size=(ch.n + 2, size)), 3 * rng.normal(size=(ch.n + 2, size))
    flow, ambient = 0.3 * rng.normal(size=(ch.n, 2, size)), 0.1 * rng.normal(size=(2, size))
    return ch, sw, (list(q), list(v), rng.uniform(size=size), list(rng.normal(size=(ch.n - 1, size))), list(flow), ambient)


def probe_row(active: EffectStack, times: float = 1.0) -> np.ndarray:
    """Every parameter `times` as far from its null as its larger typical value."""
    each = [p for e in active.effects for p in e.parameters]
    return np.array([p.probe if p.shape else np.clip(p.null + times * (p.probe - p.null), p.low, p.high) for p in each])


@pytest.mark.parametrize("name", [*CATALOGUE, "all together"])
@pytest.mark.parametrize("robot", ["fish", "tendon_fish"])
def test_an_effect_at_its_null_changes_no_bit_of_a_step(robot, name):
    ch, sw, given = states(load_robot(robot), 100, seed=1)
    active = EffectStack(EVERY if name == "all together" else [CATALOGUE[name]], ch.n - 1)
    plain = planar_chain.step(np, ch, sw, *given)
    for wet in (1.0, 0.0):
        same = planar_chain.step(np, ch, sw, *given, Effects(np, active, active.null, active.memory, wet))
        for field in ("q", "v", "attached", "power", "accel"):
            np.testing.assert_array_equal(np.array(getattr(same, field)), np.array(getattr(plain, field)), err_msg=field)


def test_memory_of_effects_at_their_null_changes_no_bit_of_the_next_steps():
    ch, sw, given = states(load_robot("fish"), 50, seed=2)
    active = EffectStack(EVERY, ch.n - 1)
    memory, plain = active.memory, given
    for _ in range(20):
        step = planar_chain.step(np, ch, sw, *plain)
        same = planar_chain.step(np, ch, sw, *plain, Effects(np, active, active.null, memory))
        np.testing.assert_array_equal(np.array([*same.q, *same.v, same.power]), np.array([*step.q, *step.v, step.power]))
        plain, memory = (step.q, step.v, step.attached, *given[3:]), same.memory


def test_commands_delays_and_sensors_are_untouched_at_the_null():
    rng, active = np.random.default_rng(3), EffectStack(EVERY, 3)
    sent = rng.normal(size=(40, 3))
    np.testing.assert_array_equal(delivered(np, active, active.null, sent, 0.004), sent)
    seen = SensorReadings(np.arange(40) * 0.02, *rng.normal(size=(3, 40)), rng.normal(size=(40, 3)), rng.normal(size=40))
    for a, b in zip(active.measure(np, active.null, seen), seen, strict=True):
        np.testing.assert_array_equal(a, b)
    assert all(np.all(active.delay(np, active.null, clock, seen.t) == 0.0) for clock in effects.effect.CLOCKS)


@pytest.mark.parametrize(
    "effect", [e for e in LASTING if e.sites and set(e.sites) - {"command", "measure"}], ids=lambda e: e.name
)
def test_an_effect_of_typical_size_changes_a_step_and_keeps_it_finite(effect):
    ch, sw, given = states(load_robot("fish"), 100, seed=4)
    active = EffectStack([effect], ch.n - 1)
    row, memory = probe_row(active), list(active.memory)
    memory[:2] = 3.0, 600.0  # A that the servos draw; s, ten minutes into a session, for what takes its time
    plain = planar_chain.step(np, ch, sw, *given)
    other = planar_chain.step(np, ch, sw, *given, Effects(np, active, row, memory))
    assert np.isfinite([*other.q, *other.v, other.attached, other.power]).all()
    assert np.abs(np.array(other.v) - np.array(plain.v)).max() > 1e-5


def test_the_code_generator_writes_a_step_with_the_whole_catalogue():
    pytest.importorskip("jax")
    import jax.numpy as jnp

    from fishmj.engines import codegen

    ch, sw, given = states(load_robot("fish"), 30, seed=6)
    active = EffectStack(LASTING, ch.n - 1)
    row = probe_row(active)

    def take(xp, values):
        q, v, attached, target, parameters, memory = values
        hooks = Effects(xp, active, parameters, memory)
        target = [hooks.session.command(j, value, ch.dt) for j, value in enumerate(target)]
        s = planar_chain.step(xp, ch, sw, q, v, attached, target, [(0.1, 0.0)] * ch.n, (0.0, 0.0), hooks)
        return [*s.q, *s.v, s.attached, s.power, *s.memory]

    several = lambda letter, n: [f"{letter}{i}" for i in range(n)]
    names = [
        several("q", 6),
        several("rate", 6),
        "attached",
        several("c", 3),
        several("p", len(row)),
        several("m", len(active.memory)),
    ]
    program = codegen.trace(lambda values: take(jnp, values), names)
    scope = {key: getattr(np, key) for key in ("sqrt", "sin", "cos", "exp", "absolute", "maximum", "minimum", "where", "floor")}
    scope |= {"atan2": np.arctan2, "real": np.float64}
    values = [*given[:4], list(row), [0.1] * len(active.memory)]
    for name, value in zip(names, values, strict=True):
        scope |= dict(zip(name, value, strict=True)) if isinstance(name, list) else {name: value}
    exec(program.numbers() + program.assignments(), scope)  # noqa: S102  the text under test
    for name, expected in zip(program.outputs, take(np, values), strict=True):
        np.testing.assert_allclose(scope[name], expected, rtol=1e-9, atol=1e-9)


FIELDS = {"servo": ServoDrive, "gear": Gear, "body": BodyMotion, "water": LocalWater, "flow": FlowAt, "measure": SensorReadings}


def at_site(xp, effect: Effect, site: str, parameters, given: dict):
    """What an effect makes of a site, as a flat list. given: field -> value; missing ones are 0."""
    p = SimpleNamespace(
        **dict(zip((p.name for p in effect.parameters), parameters, strict=True)), joint=0, robot=effects.RobotScales()
    )
    function = getattr(effect, site)
    if site == "command":
        out = function(xp, p, given["value"], effect.memory, 0.004)
    elif site in ("flow", "measure"):
        out = function(xp, p, FIELDS[site](**given))
    else:
        out = function(xp, p, FIELDS[site](**given), effect.memory, 0.004)
    return [leaf for part in out for leaf in leaves(part)]


def leaves(value) -> list:
    return [leaf for part in value for leaf in leaves(part)] if isinstance(value, list | tuple) else [value]


def fields_of(site: str, make) -> dict:
    """One value a field from make(shape); water has two links."""
    if site == "command":
        return {"value": make(())}
    given = {name: make((3,) if name == "joint" else ()) for name in FIELDS[site]._fields}
    if site == "water":
        given |= {name: [(make(()), make(()), make(())) for _ in range(2)] for name in ("forces", "instant")}
    return given


SITES = [(e, site) for e in LASTING for site in e.sites if site != "fish"]


@pytest.mark.parametrize("effect,site", SITES, ids=lambda x: getattr(x, "name", x))
def test_jax_and_numpy_agree_at_every_site(effect, site):
    jax = pytest.importorskip("jax")
    rng = np.random.default_rng(5)
    given = fields_of(site, lambda shape: np.abs(rng.normal(size=(40, *shape))) * rng.choice((1.0, -1.0)))
    row = probe_row(EffectStack([effect], 3))
    with jax.enable_x64(True):
        theirs = at_site(jax.numpy, effect, site, list(row), jax.tree_util.tree_map(jax.numpy.asarray, given))
        for a, b in zip(theirs, at_site(np, effect, site, list(row), given), strict=True):
            np.testing.assert_allclose(np.asarray(a), b, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("effect,site", [(e, s) for e in LASTING for s in e.remembering], ids=lambda x: getattr(x, "name", x))
def test_gradients_are_finite_at_the_null_at_rest(effect, site):
    jax = pytest.importorskip("jax")
    given = fields_of(site, lambda shape: 0.0) | ({"kb": 0.3} if site == "gear" else {})
    with jax.enable_x64(True):
        total = lambda row, given: sum(at_site(jax.numpy, effect, site, row, given))
        slopes = jax.grad(total, (0, 1))(list(effect.null), given)
        assert np.isfinite(jax.tree_util.tree_leaves(slopes)).all()


def test_what_an_effect_says_of_itself_is_checked():
    known = {"low": 0.0, "high": 1.0, "typical": (0.1, 0.2), "unit": "1"}
    with pytest.raises(ConfigError, match="the joint's number"):
        Parameter(name="joint", **known)
    with pytest.raises(ConfigError, match=r"delays or handed name \['sise'\]"):
        replace(CATALOGUE["swirl"], handed=("sise",))


def test_catalogue_is_whole_and_names_what_exists():
    root = calib_folder().parent.parent
    said: dict[str, int] = {}
    for page in (root / "README.md", *(root / "docs").rglob("*.md")):
        for match in re.finditer(
            r"(?:which of|one of|from) (\d+) effects|[Cc]atalogue (?:of|holds) (\d+)", page.read_text(encoding="utf-8")
        ):
            said[f"{page.name}: {match[0]}"] = int(match[1] or match[2])
    assert len(said) > 1 and set(said.values()) == {len(EVERY)}, said  # how many there are, wherever a page says it
    runs = set(excitation.names())
    for e in EVERY:
        assert e.confusions and e.about and e.formula and e.source, e.name
        for c in e.confusions:
            assert c.other in CATALOGUE and c.other != e.name and c.separates, (e.name, c.other)
            assert c.excitations and set(c.excitations) <= runs, (e.name, set(c.excitations) - runs)
    for c in ambiguity.CLASSES:
        assert set(c.effects) <= set(CATALOGUE) and set(c.excitations) <= runs and len(c.effects) + len(c.besides) > 1
    assert ambiguity.together("camera_latency", "clock_offset").name == "pose_clock"
    assert ambiguity.together("camera_latency", "tether") is None


def test_typical_values_lie_inside_the_bounds_and_away_from_the_null():
    for e in EVERY:
        for p in e.parameters:
            assert p.low <= p.typical[0] < p.typical[1] <= p.high, (e.name, p.name)
            assert p.shape or not p.typical[0] <= p.null <= p.typical[1], (e.name, p.name)
        assert not e.parameters[0].shape, e.name


def test_sizes_of_effects_are_those_of_the_described_robot():
    """To the bit those of the catalogue for the default fish; in proportion to its own constants for any other."""
    fish, other = (
        effects.RobotScales.of(load_robot("fish")),
        effects.RobotScales(torque=0.52, speed_no_load=10.472, length=0.2675),
    )
    assert fish == effects.RobotScales() and all(e.on_robot(fish) is e for e in EVERY)
    assert all(q in {p.of for e in EVERY for p in e.parameters} for q in QUANTITIES)
    own = lambda name: CATALOGUE[name].on_robot(other).parameters[0]
    assert (own("torque_saturation").null, own("torque_saturation").high) == (0.52, 0.52)
    assert own("torque_saturation").typical == pytest.approx((0.8 * 0.52 / 1.667, 1.2 * 0.52 / 1.667))
    assert own("speed_limit").typical == pytest.approx((0.105, 0.25)) and own("yaw_drag").high == pytest.approx(1 / 32)
    assert own("com_offset").low == pytest.approx(-0.05) and own("linear_surge_drag").high == pytest.approx(1.25)
    assert own("command_latency") is CATALOGUE["command_latency"].parameters[0]
    assert EffectStack(EVERY, 3, other).null[EffectStack(EVERY, 3).index("torque_saturation", "limit")] == 0.52
    for e in EVERY:
        for p in e.on_robot(other).parameters:
            assert p.low <= p.typical[0] < p.typical[1] <= p.high, (e.name, p.name)
    with pytest.raises(ConfigError, match="choose one of torque, damping"):
        Parameter(name="x", unit="1", low=0.0, high=1.0, typical=(0.1, 0.2), of="colour")


def test_a_description_may_hold_a_torque_limit_of_its_own_servo(tmp_path):
    """5 N m lie beyond the default fish's servo; 2 N m do not limit a servo of 1.667 N m, so that is refused."""
    text = (calib_folder() / "fish.toml").read_text() + '[[effect]]\nname = "torque_saturation"\nparameters.limit = 5.0\n'
    strong = text.replace("torque = 1.667 ", "torque = 6.0 ").replace("kd = 0.32", "kd = 1.3")
    (tmp_path / "strong.toml").write_text(strong)
    robot = load_robot(tmp_path / "strong.toml")
    active, row = effect_calibration.activate(robot.effects, 3, effects.RobotScales.of(robot))
    assert active.null == [6.0] and list(row) == [5.0]
    (tmp_path / "usual.toml").write_text(text)
    with pytest.raises(ConfigError, match="outside the bounds 0.02 to 1.667"):
        load_robot(tmp_path / "usual.toml")


def test_an_impossible_effect_is_refused():
    good = {"unit": "1", "low": 0.0, "high": 1.0, "typical": (0.1, 0.2)}
    with pytest.raises(ConfigError, match="low <= null <= high"):
        Parameter(name="x", **good | {"null": 2.0})
    entry = {"name": "x", "stage": "timing", "about": "", "formula": "", "source": "", "shows": (), "parameters": ()}
    for wrong, message in (
        ({"stage": "magic"}, "choose one of actuator"),
        ({}, "acts at no site"),
        ({"delays": {"command": "d"}}, "no parameters of it"),
        ({"stream": "magic"}, "choose one of command, flow"),
        ({"delays": {"sundial": "d"}}, "unknown channels or clocks"),
    ):
        with pytest.raises(ConfigError, match=message):
            Effect(**entry | wrong)


def test_draws_are_typical_signed_and_inside_the_bounds():
    active, rng = EffectStack(EVERY, 3), np.random.default_rng(7)
    rows = draw(active, 400, rng)
    parameters = [p for e in EVERY for p in e.parameters]
    for column, p in zip(rows.T, parameters, strict=True):
        assert ((column >= p.low) & (column <= p.high)).all() and np.ptp(column) > 0
        if p.signed:
            assert 100 < (column > p.null).sum() < 300, p.name
        elif not p.shape:
            assert ((column >= p.typical[0]) & (column <= p.typical[1])).all(), p.name
    shapes = np.array([p.shape for p in parameters])
    np.testing.assert_array_equal(draw(active, 5, rng, scale=0.0)[:, ~shapes], np.tile(np.array(active.null)[~shapes], (5, 1)))


def test_calibration_blocks_survive_a_round_trip_and_leave_the_rest_alone(tmp_path):
    path = tmp_path / "mine.toml"
    text = (calib_folder() / "fish.toml").read_text(encoding="utf-8")
    path.write_text(text, encoding="utf-8")
    assert effect_calibration.read(path) == ()
    listed = (
        FittedEffect("coulomb_friction", {"torque": Interval(0.081, 0.074, 0.089)}, 'the "blue" pool', "ab12"),
        FittedEffect("command_latency", {"delay": Interval(0.038, 0.035, 0.041)}),
    )
    effect_calibration.write(path, listed)
    assert effect_calibration.read(path) == listed
    assert path.read_text(encoding="utf-8").startswith(text.rstrip("\n"))
    assert replace(load_robot(path), effects=()) == load_robot("fish")
    active, row = effect_calibration.activate(listed, 3)
    assert active.names == [("coulomb_friction", "torque"), ("command_latency", "delay")] and list(row) == [0.081, 0.038]
    assert effect_calibration.fitted(active, row, [0.074, 0.035], [0.089, 0.041])[1] == listed[1]
    effect_calibration.write(path, [])
    assert path.read_text(encoding="utf-8") == text


@pytest.mark.parametrize(
    "block,message",
    [
        ('name = "coulom_friction"', "Did you mean 'coulomb_friction'"),
        ('name = "coulomb_friction"\nparameters.torqe = { value = 0.1 }', "Did you mean 'torque'"),
        ('name = "coulomb_friction"\nparameters.torque = { value = 9.0 }', "outside the bounds 0 to 0.8"),
        ('name = "coulomb_friction"\nparameters.torque = { value = 0.1, low = 0.2 }', "must lie in its interval"),
        ('name = "coulomb_friction"\nparameters.torque = { value = "much" }', "finite numbers"),
        ('name = "coulomb_friction"\nparameter.torque = 1', "Did you mean 'parameters'"),
        ('name = "tether"\n[[effect]]\nname = "tether"', "listed 2 times"),
    ],
)
def test_a_wrong_calibration_block_is_refused_with_the_nearest_name(tmp_path, block, message):
    path = tmp_path / "mine.toml"
    path.write_text(f'schema = "fishmj.fish/1"\n[[effect]]\n{block}\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=message):
        effect_calibration.read(path)


@pytest.mark.parametrize("columns", [("effect", "formula", "shows in"), ("effect", "parameters", "typical", "null")])
def test_the_documented_tables_are_the_catalogue(columns):
    table = console.table(verb.rows(EVERY), columns)
    assert table in DOCS.read_text(encoding="utf-8"), f"write this there:\n{table}"


def test_the_command_shows_the_sizes_of_a_described_robot(tmp_path, capsys):
    text = (
        (calib_folder() / "fish.toml").read_text().replace("torque = 1.667 ", "torque = 1.7 ").replace("kd = 0.32 ", "kd = 0.35 ")
    )
    (tmp_path / "mine.toml").write_text(text)
    assert verb.main(["torque_saturation", "--robot", str(tmp_path / "mine.toml")]) == console.OK
    assert "null 1.7, bounds 0.0203959 to 1.7" in capsys.readouterr().out
    assert verb.main(["--robot", str(tmp_path / "mine.toml")]) == console.OK and "0.815837 to 1.22376" in capsys.readouterr().out
    assert verb.main(["--mjcf"]) == console.OK and "at each" in capsys.readouterr().out
    assert console.run(verb.main, ["--robot", "arm.xml"]) == console.BAD_INPUT and "--mjcf" in capsys.readouterr().err


def test_the_command_prints_one_entry_in_full_and_knows_the_nearest_name():
    run = lambda *args: subprocess.run(
        [sys.executable, "-m", "fishmj.effects", *args], capture_output=True, text=True, check=False
    )
    entry = json.loads(run("gear_backlash", "--json").stdout)
    assert entry["parameters"][0]["unit"] == "rad" and entry["sites"] == ["gear"] and entry["confusions"]
    sized = run("torque_saturation", "--robot", "fish")
    assert (
        "null 1.667, bounds 0.02 to 1.667, typical 0.8 to 1.2" in sized.stdout and sized.stdout == run("torque_saturation").stdout
    )
    wrong = run("gear_backlsh")
    assert wrong.returncode == console.BAD_INPUT and "gear_backlash" in wrong.stderr
    assert all(e.name in verb.text(e) and e.formula in verb.text(e) for e in EVERY)
    with pytest.raises(UnknownName, match="tether"):
        effects.get("teather")
