"""MuJoCo's own fluid as a competitor of the strips, and the table that says what each part of the model is worth.

Records are synthetic: the hidden water of `hidden_water.py`.
"""

import json
from dataclasses import replace

import hidden_water as hidden
import mujoco
import numpy as np
import pytest

from fishmj import mjcf
from fishmj.base import console, interrupt
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.hydro_fit import __main__ as verb
from fishmj.hydro_fit import free_swims
from fishmj.hydro_fit.fit import rollout
from fishmj.hydro_fit.fit.fit_pipeline import FitSettings
from fishmj.hydro_fit.fit.regression_rows import rows_of
from fishmj.water.dynamics import planar_chain
from fishmj.water.planar_water import world_matrix
from studies.water_ablation import ablation, ablation_table, ellipsoid_fit, force
from studies.water_ablation.ablation import Variant
from studies.water_ablation.ellipsoid_swim import Hooks

ROBOT, CHAIN, N = hidden.ROBOT, hidden.CHAIN, hidden.N
E = force.ellipsoids_of(ROBOT)
SMALL = {"size": 0.34, "seconds": 5.0}  # as in test_hydro_fit.py: what makes it is compiled once
QUICK = FitSettings(steps=20, swim=40.0, swims=0)


@pytest.fixture(scope="module")
def records():
    """Training, validation and test parts of one small campaign."""
    return {s: hidden.campaign(seed=seed, split=s, **SMALL) for seed, s in enumerate(("train", "val", "test"))}


def model_of(flat):
    """MuJoCo's fish with these coefficients in its fluid."""
    model = mjcf.build(ROBOT, bare=True, ellipsoid=True)
    for i in range(N):
        own = force.coefficients_of(flat, i == N - 1)
        model.geom_fluid[i, force.COLUMNS[0]] = [own[term] for term in force.TERMS]
    return model, mujoco.MjData(model)


def drawn(seed):
    """Coefficients, most of them far from MuJoCo's own."""
    flat = np.random.default_rng(seed).uniform(0, 4, 12)
    flat[[5, 11]] = 1.0  # MuJoCo's added mass is what it is
    return flat


def stirred(rng):
    """A posture and rates, (6,) each."""
    return rng.normal(0, 0.6, 6), rng.normal(0, 1, 6) * [0.5, 0.5, 2, 4, 4, 4]


def test_the_force_of_every_ellipsoid_is_mujocos():
    rng = np.random.default_rng(1)
    for seed in range(20):
        flat = drawn(seed)
        model, data = model_of(flat)
        for _ in range(10):
            data.qpos[:], data.qvel[:] = stirred(rng)
            wind = model.opt.wind[:2] = rng.normal(0, 0.3, 2)
            mujoco.mj_forward(model, data)
            k = planar_chain.kinematics(np, CHAIN, data.qpos, data.qvel, [wind] * N)
            on_links = Hooks(np, E, flat, False).water(CHAIN, None, None, k, None)
            got = planar_chain.generalised(np, CHAIN, data.qpos[2], planar_chain.gather(CHAIN, k, on_links))
            np.testing.assert_allclose(got, data.qfrc_fluid, rtol=1e-9, atol=1e-9)


def test_each_coefficient_has_a_force_of_its_own():
    """No term is lost in the sum: without it the force is another."""
    motion = (0.3, -0.2, 1.5)
    for i in range(N):
        whole = force.link_force(np, E, i, *motion, force.default(E))
        for j, name in enumerate(force.names_of()):
            less = force.default(E)
            less[j] = 0.0
            differs = not np.allclose(force.link_force(np, E, i, *motion, less), whole, rtol=0, atol=1e-12)
            assert differs == name.startswith(force.GROUPS[i == N - 1]), (i, name)


def test_a_fish_in_ellipsoids_swims_as_in_mujoco():
    flat, rng = drawn(3), np.random.default_rng(4)
    model, data = model_of(flat)
    data.qpos[:], data.qvel[:] = stirred(rng)
    q, v, sw, hooks = list(data.qpos), list(data.qvel), planar_chain.nominal(ROBOT), Hooks(np, E, flat, False)
    for k in range(200):
        target = 0.5 * np.sin(2 * np.pi * k * CHAIN.dt - np.arange(3))
        data.ctrl[:] = target
        mujoco.mj_step(model, data)
        s = planar_chain.step(np, CHAIN, sw, q, v, 0.5, target, [(0.0, 0.0)] * N, (0.0, 0.0), hooks)
        q, v = s.q, s.v
    np.testing.assert_allclose([*q, *v], [*data.qpos, *data.qvel], rtol=0, atol=1e-9)
    assert np.hypot(*q[:2]) > 0.05  # and it went somewhere


def test_inertia_omitted_by_mujoco_is_lambs_added_mass_of_each_ellipsoid():
    flat, rng = drawn(5), np.random.default_rng(6)
    flat[[5, 11]] = 0.7, 1.3
    model, data = model_of(flat)
    data.qpos[:], data.qvel[:] = stirred(rng)
    mujoco.mj_forward(model, data)
    expected = np.zeros((6, 6))
    for i in range(N):
        turn, move, spin = data.geom_xmat[i].reshape(3, 3), np.zeros((3, 6)), np.zeros((3, 6))
        mujoco.mj_jacGeom(model, data, move, spin, i)
        rows = np.stack([*(turn.T @ move)[:2], spin[2]])
        expected += rows.T @ np.diag(np.array(E.added[i]) * force.coefficients_of(flat, i == N - 1)["added"]) @ rows
    q, k, m = (
        data.qpos,
        planar_chain.kinematics(np, CHAIN, data.qpos, data.qvel, [(0.0, 0.0)] * N),
        [[0.0] * (r + 1) for r in range(6)],
    )
    Hooks(np, E, flat, True).body(CHAIN, None, q, k, [0.0] * 6, m)
    np.testing.assert_allclose(world_matrix(CHAIN, q[2], m), expected, rtol=0, atol=1e-12)


def energy_left(inertia):
    """Kinetic energy of fish and water after 2 ms without drag, lift and servos, over that at the start."""
    ideal, flat = E._replace(viscosity=0.0), np.zeros(12)
    flat[[5, 11]] = 0.8, 1.2
    loose = planar_chain.nominal(ROBOT)._replace(kp=[0.0] * 3, kv=[0.0] * 3, kb=[1e-30] * 3)
    fine, still = CHAIN._replace(dt=1e-5), [(0.0, 0.0)] * N

    def energy(q, v):
        k = planar_chain.kinematics(np, fine, q, v, still)
        m = planar_chain.mass_matrix(fine, loose, k, water=False)
        Hooks(np, ideal, flat, True).body(fine, None, q, k, [0.0] * 6, m)
        c, s = np.cos(q[2]), np.sin(q[2])
        rates = [c * v[0] + s * v[1], c * v[1] - s * v[0], *np.cumsum(v[2:])]
        return 0.5 * sum(m[max(i, j)][min(i, j)] * rates[i] * rates[j] for i in range(6) for j in range(6))

    q, v = (list(a) for a in stirred(np.random.default_rng(7)))
    before = energy(q, v)
    for _ in range(200):
        s = planar_chain.step(np, fine, loose, q, v, 0.5, [0.0] * 3, still, (0.0, 0.0), Hooks(np, ideal, flat, inertia))
        q, v = s.q, s.v
    return energy(q, v) / before


def test_with_its_inertia_the_added_mass_only_moves_energy_about():
    assert energy_left(True) == pytest.approx(1.0, abs=5e-6)
    assert abs(energy_left(False) - 1.0) > 1e-3  # what MuJoCo applies alone does not


@pytest.mark.parametrize("inertia", [False, True])
def test_forces_of_ellipsoids_give_their_coefficients_back(records, inertia):
    one = ellipsoid_fit.Fit(ROBOT, records["train"], records["val"], dataset={}, settings=QUICK, inertia=inertia)
    true = np.random.default_rng(8).uniform(0.3, 3.0, 12) * one.unit
    if not inertia:
        true[[5, 11]] = 1.0
    rows = rows_of(CHAIN, records["train"])
    rows = rows._replace(force=ellipsoid_fit.forces(E, rows, true, inertia, hidden.TICK))
    np.testing.assert_allclose(one.by_forces(rows)[one.free], true[one.free], rtol=0.02)


@pytest.fixture(scope="module")
def fitted(records):
    """(the fit, MuJoCo's fluid fitted to the hidden water) from few draws."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ellipsoid_fit, "DRAWN", 6)
        patch.setattr(ellipsoid_fit, "FEW", 8)
        patch.setattr(ellipsoid_fit, "BEST", 1)
        one = ellipsoid_fit.Fit(ROBOT, records["train"], records["val"], dataset={}, settings=QUICK, inertia=False)
        return one, one.solve()


def test_swims_bring_ellipsoids_closer_within_their_bounds(fitted):
    one, water = fitted
    assert (water.flat >= one.low).all() and (water.flat <= one.high).all()
    assert water.flat[5] == water.flat[11] == 1.0  # a user of MuJoCo cannot set its added mass
    match = one._match(one.train, None)
    by_forces = one.by_forces(rows_of(CHAIN, one.train))
    costs = [float(r @ r) for r in match.residuals(np.stack([one.unit, by_forces, water.flat]))]
    assert costs[2] < 0.9 * min(costs[:2])


def test_ellipsoids_are_judged_by_the_swims_of_the_check(fitted, records):
    """All free swims, whole; free runs of the gaits to the end, as for any records of 5 s; a perfect water has no error."""
    water, test = fitted[1], records["test"]
    swum = ellipsoid_fit.EllipsoidFreeSwims(water, ROBOT, test)
    whole = rollout.fish_batch_of(CHAIN, ROBOT, test, seconds=1e6)
    for a, b in zip(swum.fleet[:-1], whole[:-1], strict=True):
        np.testing.assert_array_equal(a, b)
    gaits = [r.meta["block"] == "gait" for r in swum.records]
    began = round(free_swims.SHORTEST / records["test"][0].tick)
    assert swum.began == free_swims.SHORTEST and swum.cruise.q.shape == (sum(gaits), 251 - began, 6)
    np.testing.assert_array_equal(swum.cruise.q, whole.q[gaits, began:251])
    np.testing.assert_array_equal(swum.track.q, water.swim(ROBOT).run(whole, water.flat).q)  # by its own coefficients
    perfect, _ = free_swims.errors(swum, swum.seen)
    assert perfect["speed_error_max"] == perfect["power_error_mean"] == 0.0
    found = ellipsoid_fit.judge(water, ROBOT, test)
    assert set(ablation_table.SHOWN) <= set(found["figures"]) and found["n"]["thrust_error"] > 0
    assert 0.0 < found["figures"]["speed_error_mean"] < 1.0 and found["freerun_s"] == pytest.approx(5.0 - free_swims.SHORTEST)


@pytest.mark.slow
def test_the_verb_makes_the_table_and_goes_on_where_it_was(records, tmp_path, capsys, monkeypatch):
    data = hidden.write_dataset(tmp_path / "set", [r for part in records.values() for r in part])
    line = ["ablation", "--data", str(data), "--out", str(tmp_path / "out"), "--rows", "ellipsoid-default,forces", "--json"]
    assert console.run(verb.main, line) == 0
    said = capsys.readouterr().out
    found = json.loads(said.splitlines()[-1])
    assert [row["row"] for row in found["rows"]] == ["ellipsoid-default", "forces"] and "strips: forces" in said
    assert found["rows"][1]["stages"]["linear"] > 0 and found["rows"][1]["figures"]["guard_rate"] == 0.0
    assert found["rows"][0]["coefficients"]["tail_blunt"] == 0.5  # MuJoCo's own
    for name in ("ablation.csv", "ablation.md", "ablation.json"):
        assert (tmp_path / "out" / name).stat().st_size > 100
    assert (tmp_path / "out" / "ablation.png").read_bytes().startswith(b"\x89PNG")

    done = []
    monkeypatch.setattr(ablation, "_one", lambda robot, parts, row, *_: done.append(row.title) or dict(found["rows"][0]))
    assert console.run(verb.main, line) == 0 and done == []
    (tmp_path / "out" / "rows" / "forces-0.json").write_text("{")  # cut short
    assert console.run(verb.main, line) == 0 and done == ["strips: forces"]
    about = {"settings": FitSettings(), "dataset": {"sha256": "another"}, "folder": tmp_path / "out"}
    ablation.table(ROBOT, *records.values(), names=["prior"], **about)
    assert done[1:] == ["strips: prior"]  # other data: done again
    with pytest.raises(UnknownName, match="row of the ablation 'wholes'. Did you mean 'whole'"):
        ablation.table(ROBOT, *records.values(), names=["wholes"], **about)
    with pytest.raises(ConfigError, match="no seed"):
        ablation.table(ROBOT, *records.values(), seeds=[], **about)


@pytest.mark.slow
def test_an_interrupted_table_says_what_it_holds_and_uses_it(records, tmp_path, monkeypatch):
    """Broken off in the second row's fit, behind its first stage: the first row and that stage are not done again."""
    given = {"settings": replace(QUICK, swims=0), "dataset": {"sha256": "x"}, "folder": tmp_path, "names": ["prior", "forces"]}
    said, done = [], []
    score, linear = Variant.score, Variant._linear

    def breaks(self, *args):
        said.append(interrupt._kept[-1][0]())
        raise KeyboardInterrupt

    monkeypatch.setattr(Variant, "_rollout", breaks)
    monkeypatch.setattr(Variant, "_linear", lambda self, state: done.append("linear") or linear(self, state))
    monkeypatch.setattr(Variant, "score", lambda self, *a: done.append("score") or score(self, *a))
    with pytest.raises(KeyboardInterrupt):
        ablation.table(ROBOT, *records.values(), **given)
    assert said == [f"{tmp_path} holds 1 of 2 rows; go on with the same command"]
    assert done == ["score", "linear"] and list((tmp_path / "stages").glob("linear-*"))
    monkeypatch.setattr(Variant, "_rollout", lambda self, state: self._unmoved(state))
    rows = ablation.table(ROBOT, *records.values(), **given)
    assert [row["row"] for row in rows] == ["prior", "forces"] and done.count("linear") == 1


def test_learnt_rows_are_drawn_once_a_seed_and_shown_with_their_range(monkeypatch, tmp_path):
    def one(robot, parts, row, settings, *_):
        error = 0.02 + 0.01 * settings.seed
        figures = dict.fromkeys(ablation_table.SHOWN, error) | {"thrust_error": float("nan")}
        return {"figures": figures, "n": dict.fromkeys(figures, 4), "freerun_s": 10.0, "seconds": 3.0, "notes": "",
                "validation": {"judged": 0.5}}  # fmt: skip

    monkeypatch.setattr(ablation, "_one", one)
    about = {"settings": FitSettings(), "dataset": {}, "folder": tmp_path}
    rows = ablation.table(ROBOT, [], [], [], names=["base", "whole"], seeds=[0, 1, 2], **about)
    assert [(row["row"], row["seed"]) for row in rows] == [("base", 0), ("whole", 0), ("whole", 1), ("whole", 2)]
    base, wake, asked, count = ablation_table.cells(rows)
    assert base["speed"] == "2.0 %" and wake["speed"] == "3.0 % (2.0 to 4.0)" and wake["water"].endswith("(3 seeds)")
    assert asked["speed"] == "3.0 %" and base["thrust / tow drag"] == "-" and count["speed"] == "4"
    assert len(list((tmp_path / "rows").glob("*.json"))) == 4


def test_fits_that_differ_later_share_their_first_stages(records, tmp_path):
    kept = {"settings": QUICK, "dataset": {}, "folder": tmp_path, "code": "1"}
    make = lambda **changes: ablation.Variant(ROBOT, records["train"], records["val"], **kept | changes)
    whole, plain, other = make(), make(retune=False), make(settings=replace(QUICK, steps=30))
    names = lambda one: [one._path(stage).name for stage in ("linear", "rollout", "residual", "retune")]
    assert names(whole)[:3] == names(plain)[:3] and names(whole)[3] != names(plain)[3]
    assert names(whole)[:2] == names(other)[:2] and names(whole)[2] != names(other)[2]
    assert not set(names(whole)) & set(names(make(code="2")))
