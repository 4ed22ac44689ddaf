"""Training on several devices: two virtual ones of the CPU, in a process that has them (sharded_training.py)."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from training import calm_run

from fishmj.base.errors import ConfigError
from fishmj.train.training_run import learner_of

HERE = Path(__file__).parent
TWO = {"XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu"}


def on_two_devices(check: str, *more) -> None:
    """Runs a check of sharded_training.py; its traceback is the message of a failure."""
    path = os.pathsep.join((str(HERE), str(HERE.parent)))
    words = [sys.executable, str(HERE / "sharded_training.py"), check, *map(str, more)]
    done = subprocess.run(words, env=os.environ | TWO | {"PYTHONPATH": path}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]


@pytest.mark.slow
def test_two_devices_take_the_gradient_of_one():
    on_two_devices("gradient")


@pytest.mark.slow
def test_no_empty_array_is_split():
    on_two_devices("empties")


@pytest.mark.slow
def test_each_device_draws_its_own_and_networks_stay_equal():
    on_two_devices("draws")


@pytest.mark.slow
def test_a_run_resumes_on_another_number_of_devices(tmp_path):
    on_two_devices("resume", tmp_path)


@pytest.mark.slow
def test_two_devices_learn_to_reach_the_target(tmp_path):
    on_two_devices("learning", tmp_path / "run")


def test_more_devices_than_there_are_is_an_error():
    with pytest.raises(ConfigError, match="--devices 1024: JAX sees 1 "):
        learner_of(calm_run(), 1024)


def test_fish_that_do_not_split_evenly_are_an_error(monkeypatch):
    monkeypatch.setattr("jax.local_devices", lambda: [type("Device", (), {"device_kind": "made-up"})] * 3)
    with pytest.raises(ConfigError, match="--devices 3: expected 3 equal shares of 256 fish"):
        learner_of(calm_run(), 3)
