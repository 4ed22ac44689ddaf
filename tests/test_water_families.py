"""The study of the water's calibration over generators: one robot of it, and the tables of made-up rows."""

import json

import pytest

from fishmj.base import console
from fishmj.gap.bench import water_families as study
from fishmj.gap.calibrate import __main__ as command
from fishmj.gap.calibrate import water_fit


def row(family: str, seed: int, speed: float, value: float, true: float | None) -> dict:
    """A studied robot of one quantity, whose interval is +-10 %."""
    swims = {kind: {"speed": speed, "yaw_rate": None} for kind in study.SWIMS}
    unseen = {name: {"speed": -speed, "yaw_rate": 0.1} for name in study.UNSEEN}
    felt = [value, 0.9 * value, 1.1 * value, true]
    made = {"family": family, "seed": seed, "cpu_s": 5.0, "described": 0.3, "swims": swims, "unseen": unseen}
    return made | {"physical": {"drag": felt}}


def test_tables_count_what_holds():
    rows = [
        row("a", 1, 0.02, 1.0, 1.05),
        row("a", 2, -0.04, 1.0, 1.15),
        row("b", 1, 0.01, 1.0, 1.0),
        row("second", 1, 0.1, 1.0, None),
    ]
    families, kinds, quantities = study.tables(rows)
    a, b, second = families
    assert a["left out"] == pytest.approx(3.0) and a["unseen"] == pytest.approx(3.0) and a["unseen yaw"] == pytest.approx(10.0)
    assert (a["intervals hold"], a["of"]) == (50.0, 2) and second["of"] == 0
    assert {k["kind"] for k in kinds} == {*study.SWIMS, *study.UNSEEN}
    of_a, of_b = quantities
    assert (of_a["held"], of_a["of"], of_b["held"], of_b["RMS error"]) == (1, 2, 1, 0.0)
    assert of_a["half width"] == pytest.approx(100 * (0.1 / 1.05 + 0.1 / 1.15) / 2)


def test_the_command_studies_a_robot_and_knows_its_truth(monkeypatch, capsys):
    monkeypatch.setattr(water_fit, "ROUNDS", 1)
    monkeypatch.setattr(water_fit, "AGAIN", 1)
    argv = ["families", "--families", "ellipsoid", "--robots", "1", "--seed", "4", "--json"]
    assert console.run(command.main, argv) == console.OK
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    (one,) = answer["robots"]
    assert (one["family"], one["seed"]) == ("ellipsoid", 4) and set(one["swims"]) == set(one["fitted"]) == set(study.SWIMS)
    assert 1.5 < one["physical"]["sway_mass"][3] < 3.0
    assert answer["families"][0]["described"] > 10.0


def test_a_family_that_is_none_is_refused_by_name(capsys):
    assert console.run(command.main, ["families", "--families", "elipsoid"]) == console.BAD_INPUT
    assert "ellipsoid" in capsys.readouterr().err
