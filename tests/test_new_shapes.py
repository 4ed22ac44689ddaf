"""The study of unfitted shapes: who swims, what is kept, and what is judged."""

import json

import pytest

from fishmj.base import console
from fishmj.base.errors import ConfigError
from studies import new_shapes
from studies.new_shapes import REAL, SHAPES, judged, read, robot_named, swims


@pytest.mark.parametrize("name", [*SHAPES, REAL])
def test_every_fish_swims_gaits_of_its_own_joints(name):
    robot = robot_named(name)
    assert all(swim.gait(0.3).shape == (robot.n_joints,) for swim in swims(name))
    assert all((swim.measured is not None) == (name == REAL) for swim in swims(name))


def test_only_what_is_missing_is_swum_and_a_ratio_beyond_the_band_fails(tmp_path, monkeypatch, capsys):
    swum = []

    def swim(one, slip, domain, device):
        swum.append(one.fish)
        solver = 0.2 if one.fish == "perch" else 0.32
        row = {"fish": one.fish, "gait": one.name, "slip": slip, "measured_m_s": one.measured, "strips_m_s": 0.2}
        return row | {"solver_m_s": solver, "ratio": solver / 0.2, "status": "ok"}

    monkeypatch.setattr(new_shapes, "swim_row", swim)
    call = lambda *fish: console.run(new_shapes.main, ["--fish", *fish, "--device", "cpu", "--out", str(tmp_path), "--json"])
    assert call("perch") == console.OK and swum == ["perch"] * 3
    assert call("perch", "tuna", REAL) == console.FAILED_CHECK and swum[3:] == ["tuna"] * 3 + [REAL] * 4
    told = json.loads(capsys.readouterr().out.splitlines()[-1])["judged"][0]
    assert (told["within"], told["of"]) == (3, 6) and told["strips / measured"].startswith("0.99")
    assert (tmp_path / "new_shapes_laptop.png").is_file()


def test_a_swim_that_the_solver_did_not_finish_is_not_within():
    row = {"fish": "eel", "slip": 0.99, "measured_m_s": None, "strips_m_s": 0.1, "solver_m_s": None, "ratio": None}
    assert judged([row])[0] == {
        "slip": 0.99,
        "within": 0,
        "of": 1,
        "solver / strips": "-",
        "solver / measured": "-",
        "strips / measured": "-",
    }


def test_another_table_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("fish,speed\neel,1\n")
    with pytest.raises(ConfigError, match="columns"):
        read(tmp_path / "a.csv")
