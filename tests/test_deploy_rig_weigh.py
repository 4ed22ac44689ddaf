"""Weighing with a person: the page that calibration reads, doubted readings, a session that goes on."""

import io
import json

import pytest

from fishmj.base.errors import ConfigError
from fishmj.deploy.rig import rig_prompt, rig_weigh
from fishmj.gap.laboratory.virtual_robot.trials import masses, plant
from fishmj.log import measurements
from fishmj.mjcf.reading import load_robot

SCALES = ["0.744", "0.745", "0.744"] + ["0.168"] * 3 + ["0.102"] * 3 + ["0.086"] * 3
REST = ["", "0.1822", "0.1825", "0.1821", "", "1.2", "0.3", "15.9", "15.91", "15.89"]


def weigh(monkeypatch, out, lines, *more):
    monkeypatch.setattr(rig_prompt.sys, "stdin", io.StringIO("\n".join([*lines, ""])))
    return rig_weigh.main(["--out", str(out), *more])


def test_the_page_is_the_one_that_calibration_reads(tmp_path, monkeypatch, capsys):
    assert weigh(monkeypatch, tmp_path, [*SCALES, *REST], "--json") == 0
    page = measurements.read(tmp_path)
    names = [link.name for link in load_robot("fish").links]
    assert measurements.masses(page, names)[0].sum() == pytest.approx(1.1003, abs=1e-4)
    assert measurements.balance(page, 0.0)[0] == pytest.approx(0.18227, abs=1e-5)
    assert page["pendulum"]["period"] == [1.59, 1.591, 1.589]
    found = json.loads(capsys.readouterr().out.splitlines()[-1])["found"]
    assert found[2]["value"] == pytest.approx(measurements.inertia(page, 1.1003)[0], rel=1e-3)

    from fishmj.gap.calibrate.mass import calibrate

    assert calibrate(tmp_path, load_robot("fish")).estimates["mass"].value == pytest.approx(1.1003, abs=1e-3)


def test_what_the_description_expects_is_what_perfect_instruments_find():
    truth, robot = masses(plant({}, 0, nuisance=0.0)), load_robot("fish")
    assert rig_weigh.middle_of(robot) == pytest.approx(truth["com"], rel=1e-9)
    assert rig_weigh.inertia_of(robot) == pytest.approx(truth["inertia"], rel=1e-9)


def test_grams_are_doubted_and_an_odd_reading_is_taken_again(tmp_path, monkeypatch, capsys):
    lines = ["744", "0.744", "0.790", "0.744", "0.745", *SCALES[3:], *REST]
    assert weigh(monkeypatch, tmp_path, lines) == 0
    out = capsys.readouterr().out
    assert "is the unit right?" in out and "reading 2, 0.79, is far from the others" in out
    assert measurements.read(tmp_path)["scales"]["head"] == [0.744, 0.744, 0.745]


def test_a_session_that_is_broken_off_goes_on_where_it_was(tmp_path, monkeypatch):
    with pytest.raises(ConfigError, match="stopped by the person"):
        weigh(monkeypatch, tmp_path, [*SCALES[:6], "q"])
    assert set(measurements.read(tmp_path)["scales"]) == {"unit", "head", "body1"}
    assert weigh(monkeypatch, tmp_path, [*SCALES[6:], *REST]) == 0
    assert measurements.read(tmp_path)["scales"]["tail"] == [0.086] * 3
