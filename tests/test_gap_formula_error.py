"""How far off the size is that a formula asks for in another water: told by families, widened in intervals."""

import json
import tomllib
from dataclasses import replace
from types import SimpleNamespace

import pytest

from fishmj.base.errors import ConfigError
from fishmj.gap.laboratory import generators
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null import structural_error
from fishmj.gap.null.structural_error import widths
from fishmj.gap.search.likelihood import Likelihood
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import STRUCTURED
from studies.structural_error import formula_error


def a_right_row(family, number, true, found, name="swirl", parameter="rate", half=0.004):
    """Of a benchmark: a detectable single with its name."""
    said = [{"name": name, "p_best": 1.0, "values": {parameter: [found, found - half, found + half]}}]
    about = {"id": f"{family}-{number}", "family": family, "kind": "single", "answer": "NAMED", "detectable": 9.0}
    return about | {"truth": {name: {parameter: true}}, "said": said}


def test_formula_error_limit_counts_families_and_not_their_effects():
    apart = [[0.2] * 9 + [0.21], [-0.2] * 9 + [-0.21], [0.2] * 9 + [0.19], [-0.2, -0.21]]
    alike = [[0.2, -0.2] * 5 for _ in range(4)]
    assert formula_error.limit(apart) > 1.3 * formula_error.limit(alike) > 1.3 * 0.19
    assert formula_error.limit([[0.0, 0.0]] * 3) == 0.0


def test_intervals_are_widened_by_the_errors_of_the_other_families(tmp_path, capsys):
    rows = [
        a_right_row(f, i, 0.05 * (1 + off + 0.01 * i), 0.05)
        for f, off in zip("abcd", (0.2, -0.2, 0.2, 0.0), strict=True)
        for i in (0, 1)
    ]
    rows += [a_right_row("a", 9, 0.3, 0.05) | {"answer": "CLASS"}, a_right_row("a", 8, 0.3, 0.05) | {"detectable": 2.0}]
    found = formula_error.errors_of(rows)
    assert {family: len(values) for family, values in found["environment"].items()} == dict.fromkeys("abcd", 2)
    table = formula_error.tables(found)
    assert table["d"]["environment"] > table["a"]["environment"] > 0.08 and set(table) == {"all", *"abcd"}
    assert formula_error.held(rows, {})["a"] == (0, 2) and formula_error.held(rows, table)["a"] == (2, 2)
    path, out = tmp_path / "rows.jsonl", tmp_path / "formula.toml"
    path.write_text("\n".join(map(json.dumps, rows)))
    assert formula_error.main([str(path), "--out", str(out)]) == 0
    assert "all: 90 % intervals hold 2 of 8 with one error" in capsys.readouterr().out
    assert tomllib.loads(out.read_text())["b"]["environment"] == pytest.approx(table["b"]["environment"], rel=1e-2)
    path.write_text("")
    with pytest.raises(ConfigError, match="no right name"):
        formula_error.main([str(path)])


def test_family_search_uses_formula_errors_of_the_other_families():
    for name in (*generators.NAMES, "second_robot", "solver"):
        assert widths(name).formula != widths().formula and widths(name).formula["environment"] > 0.08
    robot = load_robot("fish")
    plant, free = SwimmingFish(replace(robot, water=robot.water | {"model": STRUCTURED})), SwimmingFish(robot)
    asked_of = lambda model: Likelihood.formula_error(
        SimpleNamespace(widths=widths(), calibrated=structural_error.applies(model)), "environment"
    )
    assert (asked_of(plant), asked_of(free)) == (widths().formula["environment"], 0.08)
