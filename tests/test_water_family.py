"""A family of waters: what it draws, what it refuses, and that every front end draws it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fishmj import engines, suite
from fishmj.base import calib
from fishmj.base.errors import ConfigError, FishmjError, StoreError
from fishmj.engines import extensions, planar_kernel
from fishmj.mjcf.reading import load_robot
from fishmj.sim import Sim
from fishmj.tasks import station_hold as task
from fishmj.tasks.env import Options, StationHold
from fishmj.tasks.gym.fish_env import FishEnv
from fishmj.water import residual_step
from fishmj.water.choice import chosen, family_in, family_of
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import Flow, stack
from fishmj.water.hydro_model import HydroModel
from fishmj.water.prior import STEEPEST, flat, unflat
from fishmj.water.water_family import EDGE, MANY, RESERVE, RUN, WaterFamily
from fishmj.water.water_identity import water_identity

FISH = chosen(load_robot("fish"), "family").robot
FAMILY = family_of("swift-family")
DRAWS = np.random.default_rng(1).random((200, FAMILY.width))


def test_a_family_is_chosen_by_its_kind_or_name_and_said_with_its_slip_ratios():
    said = chosen(load_robot("fish"), "family").said
    assert "draws a water between the fits swift (slip 1), " in said
    assert "swift-slip098 (slip 0.98)" in said and "swift-reference-b (slip 0.99)" in said
    assert family_in(FISH).sha256 == FAMILY.sha256 and family_in(load_robot("fish")) is None and family_of("swift") is None
    assert water_identity(FISH) == {"name": "swift-family", "kind": "family", "sha256": FAMILY.sha256}
    with pytest.raises(ConfigError, match="another body|none is fitted|family"):
        chosen(load_robot("tendon_fish"), "swift-family")


def test_a_family_is_known_by_its_schema_whatever_its_name(tmp_path, monkeypatch):
    folder = next(one for one in calib.WATERS if (one / "swift-family.toml").is_file())
    text = (folder / "swift-family.toml").read_text(encoding="utf-8")
    (tmp_path / "pool.toml").write_text(text.replace('name = "swift-family"', 'name = "pool"'))
    for member in FAMILY.members:
        for end in ("toml", "safetensors"):
            (tmp_path / f"{member.name}.{end}").write_bytes((folder / f"{member.name}.{end}").read_bytes())
    monkeypatch.setattr(calib, "WATERS", (tmp_path,))
    family_of.cache_clear()
    assert family_of("pool").name == "pool" and family_of("swift") is None
    family_of.cache_clear()


def test_a_draw_without_strength_is_the_first_member():
    nominal = FAMILY.draw(np, DRAWS[:3], 0.0)
    assert np.allclose(nominal, flat(FAMILY.members[0].base), rtol=1e-12, atol=1e-12)


def test_draws_without_factors_lie_between_two_members():
    plain = WaterFamily("plain", MIXED.members, scatter=0.0, residual=(1.0, 1.0))
    plain.deviation[:] = 0.0
    drawn = plain._forces(plain.draw(np, DRAWS))[:, :-1]
    a, b = ((DRAWS[:, i] * len(plain.members)).astype(int) for i in (0, 1))
    ends = plain.base[a, :-1], plain.base[b, :-1]
    assert (drawn >= np.minimum(*ends) - 1e-9).all() and (drawn <= np.maximum(*ends) + 1e-9).all()
    assert np.allclose(drawn[a == b], ends[0][a == b]) and np.ptp(drawn, axis=0).max() > 0.1
    drag, rest = (plain.names.index(key) for key in ("cf", "k1"))
    between = lambda column: (drawn[:, column] - ends[0][:, column]) / (ends[1] - ends[0])[:, column]
    apart = (a != b) & (np.abs(ends[1] - ends[0])[:, [drag, rest]].min(-1) > 1e-3)
    way = np.where(plain.net[a] == plain.net[b], 1.0, 0.5)  # A, whose residual acts, stays the nearer
    assert set(way[apart]) == {0.5, 1.0}
    for column, weight in ((rest, 2), (drag, 5)):
        assert np.allclose(between(column)[apart], (way * DRAWS[:, weight])[apart])


def other(k: int, model: HydroModel) -> HydroModel:
    """The model with another residual, of the same size."""
    rng = np.random.default_rng(k)
    net = model.learnt.net
    return replace(
        model, learnt=model.learnt._replace(net=net._replace(outer=net.outer + 0.3 * rng.normal(size=net.outer.shape)))
    )


ALIKE = [replace(model, learnt=FAMILY.members[0].learnt) for model in FAMILY.members[:5]]  # one residual for all
MIXED = WaterFamily(
    "mixed", [model if k < 2 else other(k % 2, model) for k, model in enumerate(ALIKE)], scatter=0.1, residual=(0.5, 1.2)
)


def test_a_draw_has_the_residual_of_its_nearer_member():
    import jax.numpy as jnp

    assert len(MIXED.nets) == 3 and MIXED.net.tolist() == [0, 0, 1, 2, 1]
    a = (DRAWS[:, 0] * 5).astype(int)
    assert (MIXED.net_of(np, DRAWS) == MIXED.net[a]).all() and (MIXED.net_of(np, DRAWS, 0.0) == 0).all()
    assert not WaterFamily("alike", ALIKE, scatter=0.1, residual=(1.0, 1.0)).net_of(np, DRAWS).any()
    many = jnp.asarray(np.resize(DRAWS, (MANY, FAMILY.width)))
    net = np.asarray(MIXED.net_of(jnp, many)).reshape(-1, RUN)
    assert (net == net[:, :1]).all() and set(net[:, 0]) == {0, 1, 2}  # side by side, as a kernel wants them
    assert np.array_equal(MIXED.net_of(np, np.asarray(many)), net.ravel())
    assert (MANY, RUN) == (residual_step.FEWEST, planar_kernel.BLOCK)


@pytest.mark.parametrize("name", ["planar", "compiled"])
def test_an_engine_gives_each_fish_its_own_residual(name):
    """A mixed batch against batches of fish that have one residual."""
    net = np.array([2, 0, 1, 0, 2, 1], np.int32)
    robot, count = engines.in_water(load_robot("fish"), "swift"), len(net)
    params = engines.nominal_params(robot, count)
    commands = np.tile(0.6 * np.sin(1.3 * np.arange(10)[:, None] - np.arange(3)), (count, 1, 1)).astype(np.float32)

    def swum(nets, params):
        engine = engines.make(name, robot)
        engine.added = replace(engine.added, nets=nets)
        start = engines.at_rest(robot, np.zeros((count, 3)))
        return np.asarray(engine.advance(start, commands, params, stack([Flow()] * count), np.zeros(count, int))[1].pose)

    mixed, own = swum(MIXED.nets, params._replace(net=net)), [swum((one,), params) for one in MIXED.nets]
    assert np.ptp([poses[0, -1] for poses in own], axis=0).max() > 1e-4  # the residuals differ
    for fish, k in enumerate(net):
        np.testing.assert_allclose(mixed[fish], own[k][fish], atol=1e-6)


def test_a_sim_takes_the_residual_of_its_swimmer(monkeypatch):
    monkeypatch.setattr(extensions, "residuals_of", lambda robot: MIXED.nets)
    strips, robot = planar_chain.nominal(load_robot("fish")), chosen(load_robot("fish"), "swift").robot
    strips = strips._replace(water=unflat(flat(FAMILY.members[0].base).tolist()))

    def swum(**options):
        sim = Sim(robot, **options)
        for n in range(20):
            sim.step(0.5 * np.sin(0.13 * n - np.arange(3)))
        return np.array(sim.pose)

    ends = [swum(swimmer=strips._replace(net=k)) for k in range(3)]
    for k in range(3):
        monkeypatch.setattr(extensions, "residuals_of", lambda robot, k=k: MIXED.nets[k : k + 1])
        np.testing.assert_allclose(ends[k], swum(swimmer=strips), atol=1e-12)
    assert np.ptp(ends, axis=0).max() > 1e-5


def test_all_draws_are_passive_and_a_description_may_state_them():
    for row in FAMILY.draw(np, DRAWS):
        c = unflat(row.tolist())
        assert min(*c.k, *c.cn, c.cf, c.ke, c.lift_a, c.lift_b) >= 0 and c.lift_a + c.lift_b >= 0.5 - 1e-12
        assert 0.0 <= c.residual <= FAMILY.residual[1] * max(model.base.residual for model in FAMILY.members)
        assert max(getattr(c, key) for key in EDGE) <= STEEPEST + 1e-9  # so that a description may state it


def test_numpy_and_jax_draw_the_same_fish():
    import jax.numpy as jnp

    u = np.random.default_rng(2).random((4, task.n_fish(FISH)))
    ours, theirs = (task.draw_fish(xp, FISH, xp.asarray(u))[0] for xp in (np, jnp))
    assert np.allclose(ours.water, theirs.water, rtol=2e-5, atol=1e-6) and np.ptp(ours.water, axis=0).max() > 0.1


def test_members_of_other_bodies_residuals_or_bounds_are_refused(tmp_path):
    first, second = FAMILY.members[:2]
    with pytest.raises(ConfigError, match="got waters of two bodies, 'swift' for robot 'swift' .* leave one out, or fit it"):
        WaterFamily("x", [first, replace(second, body_sha256="0" * 64)], scatter=0.1, residual=(0.5, 1.0))
    for pair in ([first, replace(second, learnt=None)], [replace(second, learnt=None), first]):
        with pytest.raises(ConfigError, match="'swift-slip099' has no learnt residual, 'swift' has one.*NAME-base"):
            WaterFamily("x", pair, scatter=0.1, residual=(0.5, 1.0))
    with pytest.raises(ConfigError, match="the smaller number first"):
        WaterFamily("x", [first, second], scatter=0.1, residual=(1.0, 0.5))
    with pytest.raises(ConfigError, match=r"drag: got \[1.2, 0.5\], expected the smaller number first"):
        WaterFamily("x", [first, second], scatter=0.1, residual=(0.5, 1.0), drag=(1.2, 0.5))
    with pytest.raises(ConfigError, match="got one water 2 times, expected at least two waters"):
        WaterFamily("x", [first, first], scatter=0.1, residual=(0.5, 1.0))


def family_file(folder: Path, **changed: str | None) -> Path:
    """File of a family of two shipped waters, with other TOML values for some keys; None leaves a key out."""
    lines = {"schema": '"fishmj.water-family/1"', "name": f'"{folder.name}"', "members": '["swift", "swift-slip099"]'}
    lines |= {"scatter": "0.1", "residual": "[0.5, 1]"} | changed
    path = folder / "own.toml"
    path.write_text("".join(f"{key} = {value}\n" for key, value in lines.items() if value is not None))
    return path


@pytest.mark.parametrize(("changed", "said"), [
    ({"drag": "[0.5]"}, "own.toml drag: got [0.5], expected two numbers above 0, 2 at most, the smaller first"),
    ({"residual": "1"}, "own.toml residual: got 1, expected two numbers from 0 to 2"),
    ({"scatter": None}, "own.toml scatter: got nothing, expected a number from 0 to 0.5"),
    ({"members": '["swift"]'}, "own.toml members: got ['swift'], expected 2 to 32 names"),
    ({"colour": "1"}, "own.toml colour: got an unknown key, expected one of schema, name, members"),
    ({"members": '["swift", "pike-c"]'}, "own.toml members: 'pike-c': no such water beside the file"),
    ({"members": '["swift", "swift"]'}, "own.toml members: got one water 2 times"),
    ({"members": '["swift", "tendon_fish"]'}, "own.toml members: got waters of two bodies"),
    ({"fastest": "[0.1]"}, "own.toml fastest: got 1 speeds, expected one for each of 2 members"),
    ({"residual": "[1, 0.5]"}, "own.toml residual: got [1.0, 0.5], expected the smaller number first"),
    ({"schema": '"fishmj.water-family/2"'}, "own.toml schema: got 'fishmj.water-family/2', expected 'fishmj.water/1' (a fitted"),
    ({"schema": None}, "own.toml schema: got nothing, expected 'fishmj.water/1' (a fitted water) or 'fishmj.water-family/1'"),
])  # fmt: skip
def test_a_wrong_file_of_a_family_is_one_clear_error(tmp_path, changed, said):
    with pytest.raises(FishmjError) as caught:
        chosen(load_robot("fish"), str(family_file(tmp_path, **changed)))
    assert said in str(caught.value) and "pydantic" not in str(caught.value)


def test_a_family_takes_members_from_its_folder_then_shipped_ones(tmp_path):
    HydroModel.load("swift-slip095").save(tmp_path)
    path = family_file(tmp_path, members='["swift-base", "swift-slip095-base"]')
    assert [one.name for one in family_of(str(path)).members] == ["swift-base", "swift-slip095-base"]
    named = WaterFamily.load(family_file(tmp_path, members='["swift", "swift-slip095.toml"]'))
    assert [one.name for one in named.members] == ["swift", "swift-slip095"]
    replace(named.members[1], preview=True).save(tmp_path / "new")
    said = chosen(load_robot("fish"), family_file(tmp_path / "new", members='["swift", "swift-slip095"]')).said
    assert said.endswith("between the fits swift (slip 1), swift-slip095 (slip 0.95, a preview)")
    with pytest.raises(StoreError, match=r"'b': .* holds swift-slip095; fishmj comes with swift, "):
        WaterFamily.load(family_file(tmp_path, members='["swift", "b"]'))


def test_a_family_is_refused_where_one_water_is_needed(tmp_path):
    with pytest.raises(ConfigError, match=r"own.toml: a family of waters, expected one fitted water; .*'swift-slip099'"):
        HydroModel.load(family_file(tmp_path))
    with pytest.raises(
        ConfigError,
        match="water 'family': no family comes with fishmj for robot 'tendon_fish'; write one .* --randomise-effects cross",
    ):
        chosen(load_robot("tendon_fish"), "family")


def test_streams_beyond_every_member_of_a_family_are_noted_once(tmp_path, capsys):
    slow = str(family_file(tmp_path, fastest="[0.1, 0.12]"))
    StationHold("fish", water=slow, options=Options(flow_speed=(0.0, 0.3)))
    StationHold("fish", water="family")
    assert not capsys.readouterr().err
    StationHold("fish", water=slow)
    FishEnv(water=slow)
    said = capsys.readouterr().err
    assert said.count("in streams from 0.1 m/s every fish swims in the fastest member, 'swift-slip099', which reaches 0.12") == 1


def test_every_front_end_draws_a_water_of_its_own_an_episode():
    import jax

    rows = StationHold("fish", water="family").reset(jax.random.PRNGKey(0), 3).params.water
    assert len({float(row[0]) for row in rows}) == 3

    gym = FishEnv(water="family")
    waters = [gym.reset(seed=seed) and gym.unwrapped.episodes.scenario.params.water[0] for seed in (1, 2)]
    assert not np.array_equal(*waters)

    dm = suite.load("fish", "station_hold", task_kwargs={"random": 1, "water": "family"})
    waters = [dm.reset() and np.asarray(dm.task.scenario.params.water) for _ in range(2)]
    assert not np.array_equal(*waters)


def test_a_sim_swims_in_the_first_member_or_in_a_drawn_one():
    robot = chosen(load_robot("fish"), "family").robot
    plain, drawn = Sim(robot), Sim(robot, swimmer=FAMILY.swimmer(robot, 3))
    assert plain.water_name == drawn.water_name == "swift-family"
    wave = lambda t: 0.5 * np.sin(2 * np.pi * t - np.arange(3))
    ends = []
    for sim in (plain, Sim("fish", water="swift"), drawn):
        for n in range(30):
            sim.step(wave(0.02 * n))
        ends.append(np.array(sim.pose))
    assert np.allclose(ends[0], ends[1], atol=1e-12) and np.abs(ends[0] - ends[2]).max() > 1e-6


def test_a_stream_draws_waters_in_which_the_fish_can_hold():
    import jax.numpy as jnp

    slow, top = 0.2, 0.8
    bounded = WaterFamily("x", FAMILY.members[:3], scatter=0.0, residual=(1.0, 1.0), fastest=(top, 0.5, slow))
    bounded.deviation[:] = 0.0
    stream = np.linspace(0.0, 0.7, len(DRAWS))
    free, drawn = bounded.draw(np, DRAWS), bounded.draw(np, DRAWS, stream=stream)
    a, b = (DRAWS[:, 0] * 3).astype(int), (DRAWS[:, 1] * 3).astype(int)
    way = np.where(bounded.net[a] == bounded.net[b], 1.0, 0.5)
    swims = np.min([(1 - w) * bounded.fastest[a] + w * bounded.fastest[b] for w in (way * DRAWS[:, 2], way * DRAWS[:, 5])], 0)
    enough = swims >= RESERVE * stream
    assert 0.1 < enough.mean() < 0.9 and np.allclose(free[enough], drawn[enough]) and (free != drawn)[~enough].any(1).all()
    none = RESERVE * stream > top  # the fastest member's forces
    assert np.allclose(drawn[none], flat(FAMILY.members[0].base))
    theirs = bounded.draw(jnp, jnp.asarray(DRAWS), stream=jnp.asarray(stream))
    assert np.allclose(drawn, theirs, rtol=2e-5, atol=1e-5)
    with pytest.raises(ConfigError, match="fastest: got 2 speeds, expected one for each of 3"):
        WaterFamily("x", FAMILY.members[:3], scatter=0.0, residual=(1.0, 1.0), fastest=(1.0, 2.0))
