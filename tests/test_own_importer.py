"""An importer of the user's own makes a data set; a wrong one is one line."""

from pathlib import Path

import numpy as np
import pytest
from typed import EXAMPLE, refused, write

from fishmj.base import console, plugins
from fishmj.log import importers, read_dataset
from fishmj.log.__main__ import main as log


def recording(folder: Path) -> Path:
    """A synthetic camera's CSV."""
    t = np.arange(50) * 20.0
    rows = np.stack([t, 10 * t / 1e3, 5 + 0 * t, 90 + 0 * t], 1)
    np.savetxt(folder / "swim 1.csv", rows, delimiter=",", header="time,x,y,heading", comments="")
    return folder / "swim 1.csv"


def test_an_own_importer_makes_a_data_set(tmp_path, capsys):
    source = recording(tmp_path)
    assert console.run(log, ["import", str(source), "--out", str(tmp_path / "data"), "--format", f"{EXAMPLE}:read"]) == console.OK
    data = read_dataset(tmp_path / "data")
    assert data.names == ("swim_1",) or list(data.names) == ["swim_1"]
    pose = data["swim_1"].table("pose")
    np.testing.assert_allclose([pose["t"][-1], pose["x"][-1], pose["yaw"][0]], [0.98, 0.0098, np.pi / 2])
    assert importers.read(source, plugins.load("importer", f"{EXAMPLE}:read")).keys() == {"swim_1"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("def read(path): return 3", "gave int for"),
        ("def read(path): return {}", "gave dict for"),
        ("def read(path): return {'../x': 1}", "gave '../x': int"),
        ("def read(path): return open(path).no", "mine.py:1: AttributeError"),
        ("def read(): return 3", "expected read(path)"),
        ("import numpy as np\nfrom fishmj.log import Trial\ndef read(path):\n    t = np.arange(9.0)\n"
         "    return Trial({'origin': 'measured'}, {'pose': {'t': t, 'x': 1e4 * t, 'y': t, 'yaw': t}})", "millimetres"),
    ],
)  # fmt: skip
def test_a_wrong_importer_is_one_line(tmp_path, capsys, text, said):
    argv = ["import", str(recording(tmp_path)), "--out", str(tmp_path / "data"), "--format", f"{write(tmp_path, text)}:read"]
    assert said in refused(log, argv, capsys)
