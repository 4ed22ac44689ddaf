"""Every constant that decides an answer of the search: as shipped, and from a file of one's own."""

from dataclasses import fields

import pytest

from fishmj.base.calib import calib_folder, read_toml
from fishmj.base.errors import ConfigError
from fishmj.gap.thresholds import RENAMED, Gates, frozen, thresholds


def written(folder, text):
    path = folder / "own.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_each_threshold_has_a_value_a_unit_and_a_source_and_is_read():
    file = read_toml(calib_folder() / "gap.toml")
    assert set(file) == set(thresholds()._fields)
    for name, table in file.items():
        read = getattr(thresholds(), name)
        names = [field.name for field in fields(read)] if name == "gates" else list(read._fields)
        assert list(table) == names
        for key, entry in table.items():
            assert set(entry) == {"value", "unit", "source"} and entry["unit"], key
            assert entry["source"].partition(": ")[0] in ("tuned", "default", "derived"), key
            value = tuple(entry["value"]) if isinstance(entry["value"], list) else entry["value"]
            assert getattr(read, key) == value and type(getattr(read, key)) is type(value)


def test_a_file_of_ones_own_changes_what_it_states_alone(tmp_path):
    own = thresholds(written(tmp_path, "[gates]\ngain = 200\n[fit]\nprobe_sizes = [0.5, 1]\n"))
    assert own.gates.gain == 200.0 and own.fit.probe_sizes == (0.5, 1.0)
    assert own.gates.closure == frozen().closure and own.terms == thresholds().terms


def test_old_names_of_gates_are_read_with_one_line_that_says_so(tmp_path, capsys):
    old = {
        "rest": 1.2,
        "again": 0.05,
        "clear": 0.3,
        "beside": 0.01,
        "enough": 900.0,
        "min_gain_cap": 900.0,
        "joint": 500.0,
        "ahead": 200.0,
        "most": 3,
    }
    assert set(old) == set(RENAMED) and set(RENAMED.values()) <= {field.name for field in fields(Gates)}
    gates = thresholds(written(tmp_path, "[gates]\n" + "".join(f"{k} = {v}\n" for k, v in old.items()))).gates
    assert {key: getattr(gates, RENAMED[key]) for key in old} == old
    (line,) = capsys.readouterr().err.splitlines()
    assert "deprecated" in line and "rest is now residual" in line and "most is now max_effects" in line


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[gate]\ngain = 1.0", "[gate] is no table of thresholds"),
        ("[gates]\ngane = 1.0", "'gane' is no threshold"),
        ("[gates]\ngain = true", "[gates]: gain: got True, expected a number"),
        ("[gates]\nmax_effects = 2.5", "max_effects: got 2.5, expected a whole number"),
        ("[fit]\nprobe_sizes = 0.5", "probe_sizes: got 0.5, expected a list of numbers"),
        ("gates = 3", "[gates]: got 3, expected a table"),
    ],
)
def test_what_is_no_threshold_is_refused_in_one_line(tmp_path, text, said):
    with pytest.raises(ConfigError) as error:
        thresholds(written(tmp_path, text))
    assert said in str(error.value) and "\n" not in str(error.value)
