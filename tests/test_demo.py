"""The demo in short: every part runs and leaves its files."""

import json

import pytest

pytest.importorskip("numba", reason='the demo trains on the compiled engine: pip install "fishmj[fast]"')

from fishmj import console, demo  # noqa: E402


@pytest.mark.part("training")
def test_the_demo_trains_judges_reports_and_replays(tmp_path, capsys):
    assert console.run(demo.main, ["--smoke", "--out", str(tmp_path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert found["trials"] == 2 and 0 <= found["arrivals"] <= 2 and found["rmse_last20"] >= 0
    assert found["training"]["steps"] >= demo.SMOKE["steps"]
    for name, least in (("replay.html", 1_000_000), ("report/report.html", 100_000), ("report/distance.png", 10_000)):
        assert (tmp_path / name).stat().st_size > least, name
    assert (tmp_path / "trial" / "meta.toml").is_file() and (tmp_path / "training" / "best.safetensors").is_file()
