"""Files that are not what their names say: pointers of Git LFS, and models of other programs."""

import lab_files
import pytest

from fishmj import log
from fishmj.base.calib import resolve
from fishmj.base.errors import ConfigError, FishmjError
from fishmj.base.store import read_npz
from fishmj.control.policy import Policy
from fishmj.mjcf.reading import load_robot

POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12345678\n"


@pytest.fixture
def bring(tmp_path, capsys, monkeypatch):
    """Run `log import`: (exit code, stdout, stderr); the data set is tmp_path/set."""
    return lab_files.importer(tmp_path, capsys, monkeypatch)


@pytest.mark.parametrize("name", ["swim.csv", "swim.mcap", "swim.db3", "swim.npz", "swim.parquet", "swim.db3.zstd"])
def test_git_lfs_pointer_of_a_log_is_named(tmp_path, bring, name):
    (tmp_path / name).write_bytes(POINTER)
    code, _, err = bring(tmp_path / name, "--yes")
    assert code == 2 and "Git LFS pointer" in err and "git lfs pull" in err and "\n" not in err


@pytest.mark.parametrize(
    ("name", "load"),
    [
        ("p.safetensors", Policy.load),
        ("fish.toml", load_robot),
        ("segment.npz", read_npz),
        ("swim", lambda path: log.read_trial(path.parent)),
    ],
)
def test_git_lfs_pointer_of_other_data_is_named(tmp_path, name, load):
    (tmp_path / "meta.toml").write_text('schema = "fishmj.log/1"\norigin = "measured"\n')
    (tmp_path / "cmd.csv").write_bytes(POINTER)
    (tmp_path / name).write_bytes(POINTER)
    with pytest.raises(FishmjError, match="Git LFS pointer"):
        load(tmp_path / name)


@pytest.mark.parametrize("name", ["fish.urdf", "fish.sdf", "fish.xml"])
def test_model_of_another_program_is_no_description(tmp_path, name):
    (tmp_path / name).write_text("<robot/>")
    with pytest.raises(ConfigError, match="does not say what the water needs; describe the fish in a .toml"):
        resolve(tmp_path / name)
