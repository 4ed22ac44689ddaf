"""The constants: every one has unit and source, both files agree, and the manifest states what is there."""

import math
import tomllib

import pytest

from fishmj.base import calib
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.store import Manifest

ENTRIES = [(s, k, e) for s, table in calib.paper().items() if isinstance(table, dict) for k, e in table.items()]
UNITS = {
    "1",
    "name",
    "frames",
    "px",
    "of 72",
    "nat",
    "s/s",
    "m",
    "m2",
    "kg",
    "s",
    "h",
    "1/s",
    "deg",
    "rad",
    "rad/s",
    "m/s",
    "1/m",
    "V",
    "A h",
    "W h",
}
UNITS |= {"W", "A", "ohm", "N m", "N m/rad", "N m s/rad", "V s/rad", "s2/rad2", "rad/(s deg)", "1/s, deg", "s, deg"}


def fish() -> dict:
    return tomllib.loads((calib.calib_folder() / "fish.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("section", "key", "entry"), ENTRIES, ids=[f"{s}.{k}" for s, k, _ in ENTRIES])
def test_a_constant_has_value_unit_and_source(section, key, entry):
    assert set(entry) == {"value", "unit", "source"}
    kind, _, where = entry["source"].partition(": ")
    assert kind in ("paper", "derived", "default") and len(where) > 5
    assert entry["unit"] in UNITS


@pytest.mark.parametrize("section", ["servo", "timing"])
def test_the_fish_states_the_same_servo_and_timing_as_the_paper_file(section):
    for key, value in fish()[section].items():
        assert calib.constant(section, key) == value, f"{section}.{key}"


def test_the_fish_states_the_same_robot_as_the_paper_file():
    assert [link["length"] for link in fish()["link"]] == calib.constant("robot", "link_lengths")
    assert sum(link["mass"] for link in fish()["link"]) == pytest.approx(calib.constant("robot", "mass"))
    assert fish()["body"]["mass_total"] == calib.constant("robot", "mass")


def test_derived_constants_follow_from_their_sources():
    c = calib.constant
    assert sum(c("robot", "link_lengths")) == pytest.approx(c("robot", "length"))
    assert sum(c("robot", "mass_split")) == pytest.approx(c("robot", "mass"))
    assert c("servo", "torque") / c("servo", "speed_no_load") == pytest.approx(c("servo", "kd"), rel=0.01)
    assert c("servo", "voltage") / c("servo", "speed_no_load") == pytest.approx(c("servo", "constant"), rel=1e-3)
    assert c("servo", "voltage") * c("servo", "constant") / c("servo", "torque") == pytest.approx(
        c("servo", "resistance"), rel=1e-3
    )
    assert c("servo", "voltage") / c("servo", "resistance") == pytest.approx(c("servo", "stall_current"), rel=1e-2)
    assert math.radians(60) / 0.2 == pytest.approx(c("servo", "speed_no_load"), rel=1e-4)
    assert c("robot", "battery_voltage") * c("robot", "battery_capacity") == pytest.approx(c("robot", "battery_energy"))
    assert [a / b for a, b in zip(c("oracle", "domain"), c("oracle", "cells"), strict=True)] == pytest.approx(
        [c("oracle", "dx")] * 3
    )
    assert c("task", "episode_steps") * c("task", "control_dt") == pytest.approx(c("task", "episode_time"))
    assert sum(c("timing", "camera_latency") for _ in range(2)) == pytest.approx(sum(c("randomisation", "camera_latency")))
    box = math.prod(c("robot", k) for k in ("length_overall", "width_overall", "height_overall"))
    assert 1000 * math.pi / 6 * box == pytest.approx(c("robot", "box_displacement"), rel=1e-3)


def test_lattice_figures_follow_from_the_papers_grid():
    c = calib.constant
    nu, dx, dt = 1e-6, c("oracle", "dx"), c("oracle", "dt")
    assert 0.5 + 3 * nu * dt / dx**2 == pytest.approx(c("oracle", "tau"), abs=1e-6)
    assert [u * c("robot", "length") / nu for u in (0.1, 0.3)] == pytest.approx(c("oracle", "reynolds"), rel=0.01)


def test_the_figure_eight_is_as_long_as_stated():
    n = 20000
    t = [2 * math.pi * i / n for i in range(n + 1)]
    points = [(math.sin(s) * math.cos(s), math.sin(s)) for s in t]
    length = sum(math.dist(a, b) for a, b in zip(points, points[1:], strict=False))
    assert length == pytest.approx(calib.constant("experiments", "figure8_length"), abs=5e-4)


def test_reported_arrivals_are_whole_trials():
    c = calib.constant
    arrivals = [c("results", "arrival_ours"), *c("results", "arrival_adrc")]
    arrivals += [c("results", f"arrival_{k}") for k in ("rl", "koopman", "mpc")]
    assert [round(100 * n / 72, 1) for n in arrivals] == [100.0, 98.6, 97.2, 95.8, 70.8, 8.3, 2.8]
    assert len(c("protocol", "speeds")) * len(c("protocol", "bearings_deg")) * c("protocol", "repeats") == 72


def test_flow_presets_use_the_stated_lengths():
    from fishmj.water import flow

    c = calib.constant
    stated = {name: c("turbulence", f"length{suffix}") for name, suffix in flow_names().items()}
    assert stated == flow.LENGTH
    assert c("turbulence", "gust_time") == flow.GUST_TAU
    assert c("turbulence", "intensity") == flow.Flow().intensity
    assert flow.Flow(turbulence="default", speed=0.0).rms == pytest.approx(
        c("turbulence", "intensity") * c("turbulence", "speed_floor")
    )


def flow_names() -> dict[str, str]:
    return {"default": "", "fine": "_fine", "vortex_street": "_street", "shear": "_shear"}


def test_the_manifest_states_every_file_that_is_shipped():
    folder = calib.calib_folder()
    assert Manifest.read(folder).files == Manifest.of(folder).files, "run: make manifest"


def test_an_unknown_constant_names_its_neighbour():
    with pytest.raises(UnknownName, match="Did you mean 'reward'"):
        calib.constant("rewards", "wD")
    with pytest.raises(UnknownName, match="wG"):
        calib.constant("reward", "wGG")


def test_a_missing_or_broken_file_is_one_clear_error(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        calib.resolve(tmp_path / "other.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("a = = 1\n")
    with pytest.raises(ConfigError, match="not valid TOML.*line 1"):
        calib.read_toml(broken)
    with pytest.raises(UnknownName, match="fish"):
        calib.resolve("fsh")
