"""Compares fitted constants with the sealed ones. No fit imports this; `calibrate score` calls it."""

import shlex
from pathlib import Path

from fishmj.base import console
from fishmj.base.calib import calib_folder, read_toml, resolve
from fishmj.base.errors import ConfigError, StoreError
from fishmj.base.store import Manifest, read_json, sha256
from fishmj.gap.laboratory.hidden_lbm import calibration_trials


def main(argv: list[str]) -> int:
    """Compares the [calibration.*] blocks of a fish file with the seal. Returns the exit code."""
    parser = console.parser("calibrate score", "Compares fitted constants with the sealed ones of synthetic trials.")
    shipped = calibration_trials.OUT if calibration_trials.OUT.is_dir() else calib_folder() / "trials"
    parser.add_argument("--data", type=console.path, default=shipped, help="data set of synthetic trials with its seal")
    parser.add_argument("--model", type=console.text, default="fish.calibrated.toml", help="fish file with [calibration] blocks")
    args = parser.parse_args(argv)
    rows = score(args.data, args.model)
    console.say(console.table(rows))
    if args.json:
        console.emit_json({"score": rows})
    return console.OK


def score(folder: Path, model: str) -> list[dict]:
    """Fitted against sealed values, one row per constant.

    Raises StoreError: the seal is missing or broken; ConfigError: nothing was fitted.
    """
    values = opened(folder)
    fitted = {name: e for block in read_toml(resolve(model)).get("calibration", {}).values() for name, e in block.items()}
    rows = [_row(name, fitted[name], true) for name, true in values.items() if isinstance(fitted.get(name), dict)]
    if not rows:
        raise ConfigError(
            f"{model}: no [calibration]; run calibrate servo, latency, slip, mass with --out {shlex.quote(model)} first"
        )
    return rows


def opened(folder: Path) -> dict[str, float]:
    """Checks the hash of the sealed file; returns its values. Raises StoreError: missing or changed."""
    path, stated = folder / calibration_trials.SEALED, Manifest.read(folder).meta.get("sealed", {}).get("sha256")
    if not path.is_file() or sha256(path) != stated:
        raise StoreError(f"{path}: the seal is missing or was changed; make the trials again")
    return read_json(path)["values"]


def _row(name: str, fitted: dict, true: float) -> dict:
    value, low, high = (float(fitted[key]) for key in ("value", "low", "high"))
    share = 100 * (value - true) / true if true else float("nan")
    inside = "yes" if low <= true <= high else "no"
    return {"number": name, "sealed": true, "fitted": value, "low": low, "high": high, "error %": share, "inside": inside}
