"""The second fish went the whole way of docs/simulate/your_own_fish.md: data set, fitted water, what the page says of them."""

import re
from pathlib import Path

import pytest

from fishmj import engines
from fishmj.base.errors import ConfigError
from fishmj.hydro_fit import free_swims
from fishmj.hydro_fit.__main__ import records_of
from fishmj.hydro_fit.segment_dataset import open_dataset
from fishmj.mjcf.reading import load_robot
from fishmj.train.build import robot_for
from fishmj.train.settings import change, preset
from fishmj.water.hydro_model import HydroModel

ROOT = Path(__file__).parent.parent
FISH = load_robot("tendon_fish")
PAGE = (ROOT / "docs" / "simulate" / "your_own_fish.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def data():
    """Opening checks the sha256 of every file and that no episode left its split."""
    return open_dataset(ROOT / "data" / "hydro" / "tendon_fish", test=True)


def test_the_second_data_set_is_whole_and_of_the_second_fish(data):
    assert data.robot["name"] == FISH.name and data.robot["joints"] == FISH.n_joints == 2
    assert len(data.about) == 132 and not data.lost() and data.meta["missing"] == 0
    assert sum(meta["seconds"] for meta in data.about.values()) == pytest.approx(1330.0, abs=0.5)
    assert {meta["grid"]["domain"] for meta in data.about.values()} == {"window_coarse"}


@pytest.mark.slow
def test_the_second_water_swims_as_the_page_says(data):
    """The figures in bold of the page's table of the check, to the digits that it gives."""
    water = HydroModel.load("tendon_fish")
    assert water.dataset["sha256"] == data.sha256
    found = free_swims.judge(water, FISH, records_of(data, FISH, "test", 1.0))
    for title, key, scale in ROWS:
        said, count = row(title)
        decimals = len(said.partition(".")[2])
        assert f"{scale * found['figures'][key]:.{decimals}f}" == said, title
        assert found["n"][key] == count, title


ROWS = (
    ("speed, mean", "speed_error_mean", 100),
    ("speed, worst", "speed_error_max", 100),
    ("yaw rate where it turns", "yaw_rate_error_mean", 100),
    ("place after 10 s of free run", "freerun_position_error", 1),
)


def row(title: str) -> tuple[str, int]:
    """The shipped fit's figure, in bold, and n of one row of the page's table of the check."""
    cells = [cell.strip() for cell in re.search(rf"^\| {title} \|(.*)\|$", PAGE, re.M)[1].split("|")]
    return re.search(r"\*\*([\d.]+)", " ".join(cells))[1], int(cells[-1])


def test_a_policy_for_the_second_fish_is_trained_in_its_own_fitted_water():
    robot = robot_for(change(preset("quick"), robot="tendon_fish", water="fitted"))
    assert robot.water["ke"] == pytest.approx(HydroModel.load("tendon_fish").base.ke)
    assert engines.in_water(load_robot("fish"), "fitted").water["ke"] == pytest.approx(HydroModel.load("swift").base.ke)


def test_a_mujoco_model_is_not_a_description():
    with pytest.raises(ConfigError, match=r"my_fish\.xml.*\.toml"):
        load_robot("my_fish.xml")
