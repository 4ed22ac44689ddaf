"""Free swims over frequency, slip ratio and depth: what was swum is kept, and the fish swims forwards."""

import pytest

from fishmj import console
from fishmj.errors import ConfigError
from fishmj.studies.solver_grid import speeds

CALL = ["--preset", "laptop", "--frequencies", "2", "--beats", "0.6", "--device", "cpu", "--json"]


@pytest.mark.slow
def test_a_sweep_goes_on_where_it_stopped_and_refuses_another_set_up(tmp_path, monkeypatch, capsys):
    swum, real = [], speeds.swum
    monkeypatch.setattr(speeds, "swum", lambda box, *key: swum.append((box.shape[2], *key[:2])) or real(box, *key))
    call = [*CALL, "--out", str(tmp_path)]
    assert speeds.main([*call, "--slips", "1"]) == console.OK
    assert speeds.main([*call, "--slips", "0.98", "1"]) == console.OK
    assert swum == [(30, 2.0, 1.0), (30, 2.0, 0.98)]
    assert (tmp_path / "speeds.png").stat().st_size > 1000
    rows = speeds.ResultTable(tmp_path, {"domain": "laptop", "dx": 0.02, "dt": 0.004, "beats": 0.6}).rows
    assert all(row["status"] == "ok" and row["speed_m_s"] > 0 for row in rows.values())
    with pytest.raises(ConfigError, match="Take another --out"):
        speeds.main(["0.4" if word == "0.6" else word for word in call])


def test_what_cannot_be_swum_is_refused():
    with pytest.raises(ConfigError, match="slip ratios in 0..1"):
        speeds.asked([1.0], [1.2], [0.6])
