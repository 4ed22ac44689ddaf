"""The table of power: which cases are dealt, how an effect is scaled to a strength, what counts as found, and the score."""

import json
from collections import Counter
from functools import partial
from itertools import islice
from pathlib import Path

import pytest

from fishmj.base import console
from fishmj.base.errors import SimDiverged
from fishmj.gap.bench import bench_command, families, family_command, family_rows, power
from fishmj.gap.bench.cases import BenchCase
from fishmj.gap.bench.drawn_robots import every, number_of
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.thresholds import frozen
from fishmj.gap.workflow import investigate
from fishmj.mjcf.reading import load_robot

DRAG = BenchCase("x", "single", {"quadratic_drag": {"coefficient": 0.5}}, 1.0, ("gait",), 7, 20.0)


# ------------------------------------------------------------ what is dealt
def test_every_effect_is_dealt_at_all_strengths_before_one_comes_twice():
    dealt = power.robots(2000, 3, ("foil",), None, 6)
    assert sum(len(robot.cases) for robot in dealt) == 2000
    singles = [case for robot in dealt for case in robot.cases if case.times]
    first = [next(iter(case.effects)) for case in singles if case.times == power.TIMES[0]]
    many = len(families.pool("foil").catalogued)
    assert len(set(first[:many])) == many
    assert [case.times for case in singles[:4]] == list(power.TIMES)
    assert all(robot.cases[0].kind == "none" and not robot.cases[0].times for robot in dealt)
    assert len({case.id for robot in dealt for case in robot.cases}) == 2000
    assert [number_of(case) for case in dealt[0].cases] == list(range(len(dealt[0].cases)))
    assert power.robots(400, 3, ("foil",), None, 6) == power.robots(2000, 3, ("foil",), None, 6)[:30] + [
        dealt[30]._replace(cases=dealt[30].cases[:10])
    ]


def test_only_the_effects_that_were_asked_for_are_dealt():
    dealt = power.robots(30, 3, ("foil", "morison"), ("quadratic_drag", "yaw_drag"), 4)
    assert {name for robot in dealt for case in robot.cases for name in case.effects} == {"quadratic_drag", "yaw_drag"}
    assert [len(robot.cases) for robot in dealt] == [9, 9, 9, 3] and {len(case.logs) for case in dealt[0].cases} == {4}


# ------------------------------------------------------------ how large it is made
def strengths(monkeypatch, law):
    """Have an effect's strength follow a law of its size; every size that was asked."""
    asked = []

    def detectable(family, effects, logs, seed, robot):
        (values,) = effects.values()
        asked.append(next(iter(values.values())))
        return {"all": law(asked[-1])}

    monkeypatch.setattr(families, "detectable", detectable)
    return asked


@pytest.mark.parametrize("law", [lambda c: 4.0 * c**2, lambda c: 12.0 * c**1.2, lambda c: 60.0 * c**2 / (1.0 + c)])
def test_an_effect_is_scaled_until_its_strength_is_there(monkeypatch, law):
    asked = strengths(monkeypatch, law)
    values, there = power.effect_at_strength("foil", DRAG, load_robot("fish"))
    assert there == pytest.approx(20.0, rel=power.NEAR - 1.0) and power.reaches(there, 20.0)
    assert law(values["quadratic_drag"]["coefficient"]) == there and len(asked) <= power.TRIES


def test_a_strength_beyond_the_bounds_of_an_effect_is_not_reached(monkeypatch):
    asked = strengths(monkeypatch, lambda c: 0.02 * c**2)
    values, there = power.effect_at_strength("foil", DRAG, load_robot("fish"))
    assert values == {"quadratic_drag": {"coefficient": 10.0}} and there == pytest.approx(2.0)  # its upper bound
    assert not power.reaches(there, 20.0) and len(asked) < power.TRIES


def test_a_size_at_which_the_robot_does_not_swim_is_too_large(monkeypatch):
    def law(c):
        if c > 3.0:
            raise SimDiverged("it left the finite numbers")
        return 4.0 * c**2

    strengths(monkeypatch, law)
    assert power.effect_at_strength("foil", DRAG, load_robot("fish"))[1] == pytest.approx(20.0, rel=power.NEAR - 1.0)
    strengths(monkeypatch, lambda c: law(9.0))
    with pytest.raises(SimDiverged):
        power.effect_at_strength("foil", DRAG, load_robot("fish"))


# ------------------------------------------------------------ the score
def row(answer, times=20.0, said=("quadratic_drag",), rivals=(), family="foil", **more):
    out = {"id": "a", "kind": "single" if times else "none", "family": family, "answer": answer, "rivals": list(rivals)}
    out |= {"truth": {"quadratic_drag": {"coefficient": 2.0}} if times else {}, "said": [{"name": name} for name in said]}
    return out | ({"times": times} if times else {}) | more


@pytest.mark.parametrize(
    ("made", "expected"),
    [
        (row("NAMED"), "named"),
        (row("NAMED", said=("tether",)), "other"),
        (row("CLASS", said=("tether",), rivals=("quadratic_drag",)), "class"),
        (row("CLASS", said=("tether",)), "other"),
        (row("UNEXPLAINED"), "other"),
        (row("AGREES", said=()), "agrees"),
    ],
)
def test_named_and_in_its_class_count_as_found(made, expected):
    assert power.found(made) == expected


def test_the_table_has_counts_for_each_effect_generator_and_strength():
    rows = [row("NAMED"), row("AGREES"), row("CLASS", 40.0), row("NAMED", 5.0, family="morison"), row("NOT_REACHED", 40.0)]
    rows += [row("AGREES", 0.0)] * 9 + [row("UNEXPLAINED", 0.0)] + [row("DIVERGED", 10.0)]
    result = power.score(rows)
    cells = {(c["family"], c["times"]): (c["named"], c["class"], c["agrees"], c["n"]) for c in result["table"]}
    assert cells == {("foil", 20.0): (1, 0, 1, 2), ("foil", 40.0): (0, 1, 0, 1), ("morison", 5.0): (1, 0, 0, 1)}
    assert (result["missed"]["hits"], result["missed"]["n"]) == (1, 3) and result["met"] == {"missed": False, "healthy": True}
    assert result["healthy"]["value"] == 0.9 and (result["not_reached"], result["diverged"]) == (1, 1)
    text = "\n".join(power.report_lines(result))
    assert "1 + 0 + 1 of 2" in text and "20 times or more, AGREES: 33% (1 of 3; 95 %: 1% to 91%); aim <= 5%: MISSED" in text


def test_rows_of_power_are_kept_resumed_and_scored(tmp_path, monkeypatch, capsys):
    made = []

    def rows(one):
        made.extend(case.id for case in one.robot.cases)
        mine = [family_rows.case_facts(case, one) | row("NAMED", case.times, said=tuple(case.effects)) | {"id": case.id}
                for case in one.robot.cases]  # fmt: skip
        return family_rows.write_rows(one, [r | {"truth": r.get("drawn", {})} for r in mine])

    monkeypatch.setattr(family_command.family_rows, "rows", rows)
    monkeypatch.setattr(family_command, "precompile", lambda names: None)
    argv = ["--generator", "foil", "--power", "--effects", "quadratic_drag", "--cases", "10", "--strict", "--json"]
    argv += ["--out", str(tmp_path)]
    assert bench_command.main(argv) == console.FAILED_CHECK  # a robot with nothing hidden is named here
    assert len(made) == 10 and bench_command.main(argv) == console.FAILED_CHECK and len(made) == 10
    told = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert told["times"]["20"]["named"]["hits"] == 2 and told["healthy"]["hits"] == 0
    assert bench_command.main(["--score", str(tmp_path)]) == console.FAILED_CHECK
    assert "in its class" in "".join(capsys.readouterr())


# ------------------------------------------------------------ one case whole
@pytest.mark.slow
def test_added_drag_is_named_where_healthy_swims_are_given():
    robot = next(islice(every(77, ("morison",), 6), 1, None))
    known, model, healthy, _ = family_rows.questioned_model(family_rows.RobotQuery(robot))
    drag = {"quadratic_drag": {"coefficient": 8.0}}  # N s2/m2, 44 times what noise and healthy robots differ by
    case = robot.cases[0]._replace(effects=drag)
    trials = families.trials(robot.family, drag, case.logs, robot.seed, known, first=family_rows.APART, noise=case.noise)
    null = SimulatedNull(noise=case.noise, without=robot.family)
    asked = partial(investigate, model, trials, gates=frozen(), null=null, seed=robot.seed, mass_known=False)
    given, alone = (asked(healthy=one).verdict for one in (healthy, healthy._replace(swims=None)))
    assert given.answer == "NAMED" and [effect.name for effect in given.effects] == ["quadratic_drag"]
    assert alone.answer == "AGREES"  # by the widths of other waters: what this case was missed for


def test_published_rows_give_the_table_of_the_page():
    root = Path(__file__).resolve().parent.parent
    kept = root / "studies" / "gap_benchmark" / "rows" / "power_741.jsonl"
    rows = [json.loads(line) for line in kept.read_text().splitlines()]
    found = power.score(rows)
    assert found["missed"]["hits"] == 0 and found["missed"]["n"] == 75 and found["met"] == {"missed": True, "healthy": True}
    page = (root / "docs" / "search" / "results.md").read_text(encoding="utf-8")
    for times in power.TIMES:
        mine = [row for row in rows if row.get("times") == times]
        ends = Counter(row["answer"] if row["answer"] == power.NOT_REACHED else power.found(row) for row in mine)
        counts = [
            len(mine) - ends[power.NOT_REACHED],
            *(ends[end] for end in ("named", "class", "agrees", "other", power.NOT_REACHED)),
        ]
        assert f"| {times:g} times | {' | '.join(map(str, counts))} |" in page
