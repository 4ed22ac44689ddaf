"""Fuzzing of what fishmj reads: JSON and TOML with anything in the place of anything raise our errors and no other.

FISHMJ_FUZZ_SECONDS makes each test try for that long; FISHMJ_FUZZ_FIRST is the first seed (default 0).
"""

import json
import random
import shutil
import time
import tomllib
from pathlib import Path

import lab_files
import numpy as np
import pytest
from mutations import first_seed, fuzz, seconds, tell
from test_descriptions import whole

from fishmj import mjcf
from fishmj.base.errors import FishmjError
from fishmj.base.store import write_json, write_text
from fishmj.base.store.manifest import Manifest
from fishmj.hydro_fit.segment_dataset import open_dataset
from fishmj.log import measurements, toml
from fishmj.water.hydro_model import FOLDERS, HydroModel

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def water(tmp_path):
    folder = next(f for f in FOLDERS if f.is_dir())
    for suffix in (".toml", ".safetensors"):
        shutil.copy(folder / f"swift{suffix}", tmp_path)
    return tmp_path / "swift.toml"


def finite(document):
    """Without what TOML cannot say."""
    if isinstance(document, dict):
        return {k: finite(v) for k, v in document.items() if v is not None}
    return [finite(v) for v in document if v is not None] if isinstance(document, list) else document


@pytest.mark.slow
def test_a_description_with_anything_in_it(tmp_path):
    path = tmp_path / "fish.toml"

    def read(document):
        path.write_text(toml.dumps(finite(document)), encoding="utf-8")
        mjcf.build(mjcf.load_robot(path))

    fuzz(read, whole(), FishmjError, 200)


@pytest.mark.slow
def test_a_description_of_damaged_bytes(tmp_path):
    path, raw = tmp_path / "fish.toml", toml.dumps(whole()).encode()
    number, until = first_seed(), time.monotonic() + seconds(0.0)
    while number < first_seed() + 50 or time.monotonic() < until:
        path.write_bytes(lab_files.mutated(raw, random.Random(number)))
        try:
            mjcf.build(mjcf.load_robot(path))
        except FishmjError:
            pass
        except Exception as error:
            raise AssertionError(f"seed {number}: {type(error).__name__}: {error}") from error
        number += 1
    tell("description_bytes", number - first_seed())


@pytest.mark.slow
def test_a_fitted_water_with_anything_in_it(water):
    def read(document):
        write_text(water, toml.dumps(finite(document)))
        HydroModel.load(water)

    fuzz(read, tomllib.loads(water.read_text(encoding="utf-8")), FishmjError, 200)


@pytest.mark.slow
def test_a_manifest_with_anything_in_it(tmp_path):
    write_text(tmp_path / "a.txt", "a")
    Manifest.of(tmp_path, {"licence": "x"}).write(tmp_path)
    document = json.loads((tmp_path / "manifest.json").read_text())

    def read(document):
        write_text(tmp_path / "manifest.json", json.dumps(document))
        Manifest.read(tmp_path).verify(tmp_path)

    fuzz(read, document, FishmjError, 150)


@pytest.mark.slow
def test_a_page_of_weighings_with_anything_in_it(tmp_path):
    text = """
    [scales]
    head = [0.765, 0.766, 0.765]
    body1 = [0.168]
    [balance]
    at = [0.1838, 0.1851]
    error = 0.001
    [pendulum]
    thread = 1.2
    apart = 0.3
    period = [1.7005, 1.7049]
    """

    def read(document):
        write_text(tmp_path / "measurements.toml", toml.dumps(finite(document)))
        measurements.read(tmp_path)

    fuzz(read, tomllib.loads(text), FishmjError, 150)


@pytest.mark.slow
def test_a_segment_of_a_campaign_with_anything_in_it(tmp_path):
    source = ROOT / "data" / "hydro" / "tendon_fish"
    some = sorted((source / "segments").glob("*.json"))[:2]
    (tmp_path / "segments").mkdir()
    for path in some:
        shutil.copy(path, tmp_path / "segments")
        shutil.copy(path.with_suffix(".npz"), tmp_path / "segments")
    about = [json.loads(p.read_text()) for p in some]
    from fishmj.hydro_fit.segment_dataset import split_hashes

    episodes = {a["episode"]: a["split"] for a in about}
    write_json(tmp_path / "split.json", {"episodes": episodes, "sha256": split_hashes(episodes)})

    def read(document):
        write_text(tmp_path / "segments" / some[0].name, json.dumps(document))
        Manifest.of(tmp_path).write(tmp_path)
        data = open_dataset(tmp_path, test=True)
        for split in ("train", "val", "test"):
            for record in data.records(split):
                assert np.isfinite(record.t).all()

    fuzz(read, about[0], FishmjError, 200)
