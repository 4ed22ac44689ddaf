"""Hidden effects on disk, and that the second robot owes nothing to the model that will be fitted to it."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba")

from fishmj.base import console
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.gap.commands.plant import main
from fishmj.gap.laboratory.virtual_robot.hidden_dataset import parse
from fishmj.log import read_dataset

ROOT = Path(__file__).resolve().parent.parent
STRANGERS = (
    *("hydro_fit", "effects", "engines", "gap.search", "gap.models", "gap.calibrate", "lbm_oracle", "sim", "water"),
    *("tasks.env", "control"),
)


def test_running_it_loads_none_of_the_fitters_rooms():
    code = "import sys; from fishmj.gap.laboratory.virtual_robot import generate; generate({}, ['idle'], 0); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    loaded = set(done.stdout.split())
    assert "fishmj.gap.laboratory.virtual_robot.loop" in loaded
    assert not {f"fishmj.{room}" for room in STRANGERS} & loaded
    assert not {"mujoco", "jax"} & loaded


def hide(tmp_path, name, *words, seed="7"):
    """Run the command; exit code, data set, truth."""
    truth = tmp_path / f"{name}.json"
    code = main(["--out", str(tmp_path / name), "--truth", str(truth), "--seed", seed, *words])
    assert code == console.OK
    return read_dataset(tmp_path / name), json.loads(truth.read_text())


def test_the_command_writes_a_data_set_and_keeps_the_truth_apart(tmp_path, capsys):
    words = ("tether:stiffness=0.3,x=1", "command_latency=0.038", "--excitations", "impulse,idle")
    data, truth = hide(tmp_path, "one", *words, "--logs", "3", "--json")
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert said["trials"] == 3
    assert data.names == ("01_impulse", "02_idle", "03_impulse")
    assert truth["effects"] == {"tether": {"stiffness": 0.3, "x": 1.0}, "command_latency": {"delay": 0.038}}
    assert truth["origin"] == "synthetic" and truth["seed"] == 7
    trial = data["03_impulse"]
    assert trial.meta["origin"] == "synthetic" and trial.meta["replicate_of"] == "01_impulse"
    assert trial.meta["excitation"] == "impulse" and trial.value("sigma.x") > 0 and trial.value("medium") == "water"
    text = "".join(p.read_text() for p in (tmp_path / "one").rglob("*") if p.suffix in (".toml", ".json")).lower()
    assert not any(word in text for word in ("tether", "latency", "0.038", "seed"))


def test_the_same_command_makes_the_same_data_and_random_keeps_its_secret(tmp_path, capsys):
    first, truth = hide(tmp_path, "a", "random", "random", "--excitations", "impulse", "--logs", "1")
    second, again = hide(tmp_path, "b", "random", "random", "--excitations", "impulse", "--logs", "1")
    assert truth["effects"] == again["effects"] and len(truth["effects"]) == 2
    one, two = first["01_impulse"].tables, second["01_impulse"].tables
    assert all(np.array_equal(one[t][c], two[t][c]) for t in one for c in one[t])
    assert not any(name in capsys.readouterr().out for name in truth["effects"])


def test_truth_inside_the_data_set_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="inside the data set"):
        main(["none", "--excitations", "idle", "--out", str(tmp_path / "d"), "--truth", str(tmp_path / "d" / "truth.json")])
    assert not (tmp_path / "d").exists()


def test_a_fish_on_a_thread_in_air_has_no_camera_and_a_stream_is_in_the_trial(tmp_path):
    air, truth = hide(tmp_path, "air", "none", "--medium", "air", "--excitations", "steps", "--logs", "1")
    wet, _ = hide(tmp_path, "wet", "none", "--flow", "0.1,0", "--excitations", "idle", "--logs", "1")
    assert "pose" not in air["01_steps"].tables and air["01_steps"].value("medium") == "air" and truth["medium"] == "air"
    pose = wet["01_idle"].table("pose")
    assert pose["x"][-1] - pose["x"][0] > 0.05  # carried along


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["backlash"], "gear_backlash"),
        (["tether=strong"], "no finite number"),
        (["tether:length=1"], "parameter of tether"),
        (["none", "--excitations", "chrip"], "chirp"),
        (["none", "--logs", "0"], "expected a whole number from 1"),
        (["none", "--flow", "fast"], "SPEED,DIRECTION"),
        (["none", "--noise", "-1"], "expected a number from 0 to 100"),
    ],
)
def test_bad_input_exits_2_with_one_line(words, says, tmp_path, capsys):
    code = console.run(main, ["--out", str(tmp_path / "d"), "--truth", str(tmp_path / "t.json"), *words])
    said = capsys.readouterr().err
    assert code == console.BAD_INPUT and says in said and said.count("\n") == 1


def test_without_a_place_it_says_so(capsys):
    assert console.run(main, ["tether"]) == console.BAD_INPUT
    assert "--out" in capsys.readouterr().err


def test_the_list_names_effects_and_experiments(capsys):
    assert main(["--list", "--json"]) == console.OK
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert {"servo_deadband", "bouc_wen_skin"} <= {row["effect"] for row in said["effects"]}
    assert "chirp" in {row["excitation"] for row in said["excitations"]}


def test_parse_draws_what_is_not_said_from_the_seed():
    assert parse(["tether"], 1) == parse(["tether"], 1) != parse(["tether"], 2)
    assert set(parse(["random", "random", "random_odd"], 3)) == set(parse(["random", "random", "random_odd"], 3))
    with pytest.raises(UnknownName):
        parse(["nothing"], 0)
