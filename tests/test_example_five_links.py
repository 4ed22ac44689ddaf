"""The example of five links runs from the answers to the replay; in short, with a policy that learnt next to nothing."""

import importlib.util
from pathlib import Path

import pytest

from fishmj.control.policy import Policy

EXAMPLE = Path(__file__).parent.parent / "examples" / "five_links.py"


def load():
    spec = importlib.util.spec_from_file_location("five_links", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_every_part_of_the_example_runs_with_five_links(tmp_path):
    example = load()
    found = example.story(tmp_path, smoke=True)
    example.physics(tmp_path)
    assert [result["n"] for result in found["results"]] == [2, 2]
    policy = Policy.load(tmp_path / "run" / "best.safetensors")
    assert (policy.n_obs, policy.n_act) == (13, 4)
    for name in ("pike.toml", "pike.png", "pike.html", "pike_swims.png", "report/report.html"):
        assert (tmp_path / name).stat().st_size > 1000, name
