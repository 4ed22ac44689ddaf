"""Null runs are kept under a key of all that decides them: the code of the simulator and of the model too."""

import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fishmj.gap.laboratory.virtual_robot import generate
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null import null_runs
from fishmj.gap.null.null_runs import FEWEST, RecordedNull, SimulatedNull, as_excitation
from fishmj.gap.records.records import record_of

MODEL = {
    *("water.dynamics.planar_chain", "water.hydro_model", "mjcf.geometry", "effects.stack"),
    *("gap.models.kernel", "gap.models.swimming_fish", "gap.records.records"),
}
SIMULATOR = {
    *(f"gap.laboratory.virtual_robot.{name}" for name in ("water", "servo", "loop_compiler")),
    *(f"gap.laboratory.{name}" for name in ("session", "instruments", "random_streams", "numba_entry")),
    *("log.excitation", "mjcf.description"),
}
NEITHER = {"lbm_oracle.run.domain", "tasks.episode", "gap.decide.decide", "gap.report.sections", "train.networks"}


@pytest.fixture
def code(tmp_path, monkeypatch):
    """A copy of the package's source, which keys are taken of."""
    there = tmp_path / "fishmj"
    shutil.copytree(null_runs.SOURCES, there, ignore=lambda _, names: [n for n in names if "." in n and not n.endswith(".py")])
    monkeypatch.setattr(null_runs, "SOURCES", there)
    null_runs.digest.cache_clear()
    yield there
    null_runs.digest.cache_clear()


@pytest.fixture(scope="module")
def record():
    return record_of(generate({}, ["idle"], 0)[0], 0.004)


CHANGES = [
    ("water/dynamics/planar_chain.py", True, True),
    ("gap/laboratory/virtual_robot/water.py", True, False),
    ("gap/laboratory/instruments.py", True, False),
    ("gap/decide/decide.py", False, False),
]


@pytest.mark.parametrize(("file", "made", "elsewhere"), CHANGES)
def test_a_changed_module_changes_the_key_of_the_runs_that_it_decides(file, made, elsewhere, code, record, tmp_path):
    for i in range(FEWEST):
        np.savez(tmp_path / f"{i}.npz", a=i)
    plant, nulls = SwimmingFish("fish"), (SimulatedNull(runs=8), RecordedNull(folder=tmp_path))
    keys = lambda: [null._key(plant, record, as_excitation(record)) for null in nulls]
    before = keys()
    assert keys() == before
    (code / file).write_text((code / file).read_text() + "\n# another formula\n")
    null_runs.digest.cache_clear()
    assert [a != b for a, b in zip(keys(), before, strict=True)] == [made, elsewhere]


def test_what_decides_the_runs_is_found_by_its_imports():
    swims, predicts = (
        null_runs.reached(*null_runs.SIMULATOR),
        null_runs.reached(SwimmingFish.__module__, "fishmj.gap.records.records"),
    )
    assert {f"fishmj.{name}" for name in SIMULATOR} <= set(swims)
    assert {f"fishmj.{name}" for name in MODEL} <= set(predicts)
    assert not {f"fishmj.{name}" for name in NEITHER} & {*swims, *predicts}


def test_the_key_also_hangs_on_the_robot_the_draws_and_the_experiment(record):
    plant, what = SwimmingFish("fish"), as_excitation(record)
    links = tuple(replace(link, mass=1.01 * link.mass) for link in plant.robot.links)
    other = SimpleNamespace(robot=replace(plant.robot, links=links), fingerprint=plant.fingerprint)
    keys = [
        SimulatedNull(runs=8)._key(plant, record, what),
        SimulatedNull(runs=9)._key(plant, record, what),
        SimulatedNull(runs=8, seed=1)._key(plant, record, what),
        SimulatedNull(runs=8, session=1)._key(plant, record, what),
        SimulatedNull(runs=8)._key(other, record, what),
        SimulatedNull(runs=8)._key(plant, record, replace(what, commands=what.commands + 0.1)),
    ]
    assert len(set(keys)) == len(keys)


def test_imports_are_followed_through_packages_and_into_functions(code):
    (code / "far").mkdir()
    (code / "far" / "__init__.py").write_text("from fishmj.far.inner import thing\n")
    (code / "far" / "inner.py").write_text("def thing():\n    import fishmj.near\n")
    (code / "near.py").write_text("import numpy\n")
    (code / "start.py").write_text("from fishmj import far\nimport fishmj_elsewhere.near\n")
    found = null_runs.reached("fishmj.start")
    assert {"fishmj", "fishmj.far", "fishmj.far.inner", "fishmj.near", "fishmj.start"} <= set(found)
    assert not [name for name in found if "numpy" in name or "elsewhere" in name]
    assert null_runs.reached("fishmj.far.inner.thing", "types", "os.path") == {}
