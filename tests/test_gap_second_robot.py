"""Null runs of a model whose water was calibrated: the second robot swims as that model does, by its own equations."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

from fishmj.base.calib import read_toml, resolve
from fishmj.gap.laboratory.virtual_robot.robot_constants import AS_IT_IS, WaterScales, nominal
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null import second_robot
from fishmj.gap.records.records import mean_speed_and_yaw_rate
from fishmj.mjcf.reading import load_robot

FISH = load_robot("fish")


def calibrated(**water):
    """The shipped fish as `calibrate water` writes it."""
    return replace(FISH, water=FISH.water | water | {"model": "structured"})


def speeds(model, scales) -> tuple[np.ndarray, np.ndarray]:
    """Of the second robot and of the model, m/s."""
    records = second_robot.swim_second_robot(model.robot, scales, model.dt)
    shown = model.predict(records, model.nothing)
    paces = [
        (mean_speed_and_yaw_rate(r.pose.t, r.pose.values)[0], mean_speed_and_yaw_rate(r.pose.t, p["pose"][0])[0])
        for r, p in zip(records, shown, strict=True)
    ]
    return np.array(paces).T


def test_a_description_of_literature_values_is_left_alone():
    assert second_robot.scales_for(SwimmingFish(FISH, [])) is AS_IT_IS
    assert nominal(FISH, scales=WaterScales()).water == nominal(FISH).water


def test_scales_are_factors_on_the_second_robots_own_water():
    table, made = read_toml(resolve("virtual_robot"))["water"], nominal(FISH, scales=WaterScales(2.0, 3.0, 0.5, 1.5))
    plain = nominal(FISH)
    np.testing.assert_allclose(made.sections["sections"], 2.0 * np.array(table["sections"]))
    assert made.sections["drag_flat"] == 3.0 * table["drag_flat"] and made.water.friction == 0.5 * table["friction"]
    assert made.water.edge_mass == pytest.approx(1.5 * plain.water.edge_mass)
    assert made.water.stall_slope == plain.water.stall_slope


@pytest.mark.slow
def test_the_second_robot_swims_as_a_calibrated_model_does():
    model = SwimmingFish(calibrated(k=[0.6, 0.6, 0.6, 0.5], cn=[2.0, 2.0, 2.0, 3.0], ke=0.9, suction=0.3))
    scales = second_robot.scales_for(model)
    before, after = (np.abs(mine / theirs - 1.0)[:4] for mine, theirs in (speeds(model, AS_IT_IS), speeds(model, scales)))
    assert before.mean() > 0.15 and after.mean() < 0.05
    assert second_robot.scales_for(model) is scales
