"""Every constant that decides an answer of the search: as shipped, and from a file of one's own."""

from dataclasses import fields

import pytest

from fishmj.base.calib import calib_folder, read_toml
from fishmj.base.errors import ConfigError
from fishmj.gap.thresholds import frozen, thresholds


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


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[gate]\ngain = 1.0", "[gate] is not a table of thresholds"),
        ("[gates]\ngane = 1.0", "'gane' is not a threshold"),
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
