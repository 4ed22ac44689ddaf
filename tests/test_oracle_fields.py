"""Fields of the flow solver: what a slice holds, what is on disk at any moment, what ParaView gets, and the shipped state."""

import json
import os
import re
import signal
import zlib

import numpy as np
import pytest

wp = pytest.importorskip("warp")

from fishmj.base import console
from fishmj.base.calib import calib_folder
from fishmj.base.errors import ConfigError, StoreError, UsageError
from fishmj.base.store import Manifest, write_npz
from fishmj.lbm_oracle.cases import same_physics
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.fluid.storage import UNIT
from fishmj.lbm_oracle.output.record_fields import FieldRecorder, plane_of, slice_of
from fishmj.lbm_oracle.output.slices import Slice, read_slice, slices_in, write_slice
from fishmj.lbm_oracle.output.vtk import turning, write_box
from fishmj.lbm_oracle.run import swim
from fishmj.lbm_oracle.run.domain import Domain
from fishmj.lbm_oracle.run.run import Run
from fishmj.lbm_oracle.run.setup import SwimSetup
from fishmj.log import read_trial

pytestmark = pytest.mark.oracle
wp.config.quiet = True
TINY = Domain(name="tiny", shape=(48, 30, 16), dx=0.02, dt=0.004, sponge=4)
CPU = ["--device", "cpu", "--latency", "0"]
ROUND_OFF = 5e-5  # five times what rounding every population anew at every step does in 200 steps


# slices -------------------------------------------------------------------------------------------------------------
def test_rigid_rotation_has_twice_its_rate_as_vorticity_after_a_shift_too():
    lattice = Lattice(dx=0.02, dt=0.004, corner=(-0.2, -0.1, -0.07))
    water, rate = Fluid(lattice, (20, 12, 8), subgrid="wale"), 0.7
    place = lattice.to_si(np.stack(np.meshgrid(*map(np.arange, water.shape), indexing="ij"), -1))
    rising = place[..., 2]
    water.impose(np.stack([-rate * place[..., 1] + rising, rate * place[..., 0], 0 * rising], -1))
    for z in (None, -0.07, 0.0123):
        plane = plane_of(water, z)
        height = 0.0 if z is None else z
        np.testing.assert_allclose(plane[..., 2], 2 * rate, rtol=2e-5)
        np.testing.assert_allclose(plane[..., 0], -rate * place[:, :, 0, 1] + height, atol=1e-6)
    before = plane_of(water, 0.01)
    water.shift((3, -2, 0))
    np.testing.assert_allclose(plane_of(water, 0.01)[1:16, 3:], before[4:19, 1:10], atol=2e-5)
    with pytest.raises(ConfigError, match="outside the water; expected -0.070 to 0.070 m, or mid"):
        plane_of(water, 0.2)


def test_a_slice_comes_back_from_its_file_and_what_is_none_is_refused(tmp_path):
    x, y = 0.02 * np.arange(6), 0.02 * np.arange(4)
    u, v, w = np.random.default_rng(0).normal(size=(3, 6, 4))
    rims = [np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1]]), np.array([[0.2, 0.0], [0.3, 0.1]])]
    one = Slice(1.25, 0.03, x, y, u, v, w, rims)
    back = read_slice(write_slice(tmp_path / "a.npz", one))
    assert (back.t, back.z) == (1.25, 0.03) and len(back.outline) == 2
    for name in ("u", "v", "omega_z", "x", "y"):
        np.testing.assert_allclose(getattr(back, name), getattr(one, name), rtol=1e-3)
    for got, sent in zip(back.outline, rims, strict=True):
        np.testing.assert_allclose(got, sent, rtol=1e-6)
    np.testing.assert_allclose(back.extent, (-0.01, 0.11, -0.01, 0.07), atol=1e-7)
    with pytest.raises(StoreError, match="lacks t, z"):
        read_slice(write_npz(tmp_path / "b.npz", {"x": x}))
    with pytest.raises(ConfigError, match="swim --fields"):
        slices_in(tmp_path)


def test_the_swimming_fish_sheds_what_its_slices_show(tmp_path):
    """The least that a picture of a wake must be: next to the hull, of both signs, and nothing far away."""
    run = SwimSetup(domain=TINY, device="cpu").run(latency=0.0)
    for n in range(8):
        run.tick(0.5 * np.sin(2 * np.pi * 0.02 * n - np.arange(3)))
    one = slice_of(run)
    rim = one.outline[0]
    x, y = np.meshgrid(one.x, one.y, indexing="ij")
    far = np.sqrt(((np.stack([x, y], -1)[:, :, None] - rim) ** 2).sum(-1)).min(-1)
    assert one.omega_z.max() > 2 and one.omega_z.min() < -2
    assert np.abs(one.omega_z[far > 0.12]).max() < 0.1 * np.abs(one.omega_z).max()
    assert np.ptp(rim[:, 0]) == pytest.approx(0.53, abs=0.03)  # the outline is the fish


# a run that records -------------------------------------------------------------------------------------------------
def tiny(monkeypatch):
    monkeypatch.setattr(swim, "preset", lambda name: TINY)


def test_a_swim_writes_slices_pictures_and_a_film_for_paraview(tmp_path, monkeypatch, capsys):
    tiny(monkeypatch)
    folder, options = tmp_path / "fields", ["--every", "0.1", "--slice", "0.01", "--volume"]
    assert swim.main([*CPU, "--seconds", "0.2", "--fields", str(folder), *options, "--json"]) == console.OK
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["frames"] == 3
    slices = [read_slice(path) for path in slices_in(folder)]
    np.testing.assert_allclose([one.t for one in slices], [0, 0.1, 0.2], atol=1e-9)
    assert not slices[0].omega_z.any() and np.abs(slices[2].omega_z).max() > 0.1 and slices[0].z == 0.01
    for n in range(3):
        assert (folder / "vorticity" / f"{n:05d}.png").read_bytes().startswith(b"\x89PNG")
    listed = re.findall(r'timestep="([\d.]+)" group="" part="(\d)" file="([^"]+)"', (folder / "volume.pvd").read_text())
    assert [(float(t), p) for t, p, _ in listed] == [(t, p) for t in (0, 0.1, 0.2) for p in "01"]
    assert all((folder / name).is_file() for *_, name in listed)
    with pytest.raises(StoreError, match="another run"):
        swim.main([*CPU, "--seconds", "0.1", "--fields", str(folder)])
    assert swim.main([*CPU, "--seconds", "0.1", "--fields", str(folder), "--overwrite"]) == console.OK
    assert len(slices_in(folder)) == 2 and not (folder / "volume.pvd").exists()
    with pytest.raises(ConfigError, match="every = 0.03 s is no multiple of the bus tick of 0.02 s; nearest: 0.0[24] s"):
        swim.main([*CPU, "--fields", str(tmp_path / "b"), "--every", "0.03"])
    with pytest.raises(UsageError, match="got 'top', expected a number from -10 to 10, or mid: a height in m"):
        swim.main([*CPU, "--fields", str(tmp_path / "b"), "--slice", "top"])
    assert not (tmp_path / "b").exists()


@pytest.mark.parametrize("during", ["a tick", "a picture"])
def test_ctrl_c_ends_the_run_between_two_ticks_and_keeps_everything(tmp_path, monkeypatch, capsys, during):
    tiny(monkeypatch)
    owner, name = {"a tick": (Run, "tick"), "a picture": (FieldRecorder, "record")}[during]
    plain, called = getattr(owner, name), []

    def interrupted(self, *args):
        called.append(1)
        if len(called) == 8:
            os.kill(os.getpid(), signal.SIGINT)
        return plain(self, *args)

    monkeypatch.setattr(owner, name, interrupted)
    out, folder = tmp_path / "trial", tmp_path / "fields"
    keep = ["--out", str(out), "--save", str(tmp_path / "end.safetensors"), "--fields", str(folder), "--every", "0.04"]
    assert swim.main([*CPU, "--seconds", "4", *keep]) == console.INTERRUPTED
    kept, state = f"the trial until then is in {out}", f"go on with --start {tmp_path / 'end.safetensors'}"
    assert re.search(rf"interrupted after [\d.]+ s; {kept}; {state}\n", capsys.readouterr().err)
    trial = read_trial(out)
    assert trial.value("oracle.stopped") == "interrupted" and len(trial.table("truth")["t"]) == 8  # the tick was finished
    assert [read_slice(path).t for path in slices_in(folder)] == pytest.approx([0, 0.04, 0.08, 0.12])
    assert not [path for path in tmp_path.rglob("*.tmp")]
    on = ["--start", str(tmp_path / "end.safetensors"), "--out", str(tmp_path / "more"), "--seconds", "0.1"]
    assert swim.main([*CPU, *on]) == console.OK
    sent = [read_trial(folder).table("cmd")["c3"] for folder in (out, tmp_path / "more")]
    assert sent[1][0] == pytest.approx(2 * sent[0][-1] - sent[0][-2], abs=0.01) and abs(sent[0][-1]) > 0.02  # in the gait's phase


def test_a_gait_that_the_commands_cannot_show_and_less_than_a_tick_are_refused(tmp_path):
    robot = tmp_path / "slow.toml"
    text = (calib_folder() / "fish.toml").read_text(encoding="utf-8")
    robot.write_text(text.replace("bus_dt = 0.02", "bus_dt = 0.1"), encoding="utf-8")
    with pytest.raises(ConfigError, match="--frequency 10 Hz, but commands of swift leave every 0.1 s, .* 5 Hz at most"):
        swim.main([*CPU, "--robot", str(robot), "--frequency", "10", "--seconds", "1"])
    with pytest.raises(ConfigError, match="0.005 s is shorter than a bus tick of swift, 0.02 s"):
        swim.main([*CPU, "--seconds", "0.005"])


def test_a_full_disk_stops_the_fields_with_the_reason_and_keeps_the_trial(tmp_path, monkeypatch):
    tiny(monkeypatch)
    (tmp_path / "fields").mkdir()
    plain = FieldRecorder.record

    def full(self, run):
        if run.ticks == 4:
            raise StoreError("disk full: needs 7 bytes")
        return plain(self, run)

    monkeypatch.setattr(FieldRecorder, "record", full)
    keep = ["--out", str(tmp_path / "trial"), "--fields", str(tmp_path / "fields"), "--every", "0.02"]
    assert swim.main([*CPU, "--seconds", "1", *keep]) == console.FAILED_CHECK
    trial = read_trial(tmp_path / "trial")
    assert "disk full" in trial.value("oracle.stopped") and len(trial.table("truth")["t"]) == 4
    assert len(slices_in(tmp_path / "fields")) == 4


# ParaView -----------------------------------------------------------------------------------------------------------
def unpacked(path, name: str, shape) -> np.ndarray:
    """One array of a VTK XML file with appended, compressed data, read by its specification."""
    raw = path.read_bytes()
    offset = int(re.search(rb'Name="' + name.encode() + rb'"[^>]*offset="(\d+)"', raw)[1])
    start = raw.index(b"<AppendedData") + raw[raw.index(b"<AppendedData") :].index(b"_") + 1 + offset
    count, size, last = np.frombuffer(raw, np.uint64, 3, start)
    sizes = np.frombuffer(raw, np.uint64, int(count), start + 24)
    at, parts = start + 24 + 8 * int(count), []
    for n in sizes:
        parts.append(zlib.decompress(raw[at : at + int(n)]))
        at += int(n)
    assert {len(part) for part in parts[:-1]} <= {int(size)} and len(parts[-1]) == (int(last) or int(size))
    return np.frombuffer(b"".join(parts), np.float32).reshape(shape)


def test_a_box_for_paraview_holds_the_field_in_vtks_order_to_eleven_bits(tmp_path):
    nx, ny, nz = 40, 60, 50  # more than one block
    velocity = np.random.default_rng(1).normal(size=(nx, ny, nz, 3)).astype(np.float32)
    path = write_box(tmp_path / "a.vti", velocity, 0.02, (1.0, -2.0, 0.5), 3.25)
    text = path.read_bytes()[:1500].decode(errors="replace")
    assert 'WholeExtent="0 39 0 59 0 49" Origin="1 -2 0.5" Spacing="0.02 0.02 0.02"' in text and ">3.25<" in text
    np.testing.assert_allclose(unpacked(path, "velocity", (nz, ny, nx, 3)), velocity.transpose(2, 1, 0, 3), rtol=2.0**-11)
    omega, q = turning(velocity, 0.02)
    np.testing.assert_allclose(unpacked(path, "vorticity_z", (nz, ny, nx)), omega.T, rtol=2.0**-11, atol=1e-30)
    np.testing.assert_allclose(unpacked(path, "q_criterion", (nz, ny, nx)), q.T, rtol=2.0**-11, atol=1e-30)


def test_q_is_positive_in_a_turning_core_and_negative_in_a_strained_one():
    x, y = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9), indexing="ij")
    flat = lambda u, v: np.repeat(np.stack([u, v, 0 * u], -1)[:, :, None], 3, 2)
    omega, q = turning(flat(-2 * y, 2 * x), 0.25)
    np.testing.assert_allclose(omega, 4, atol=1e-12)
    np.testing.assert_allclose(q, 4, atol=1e-12)  # |W|^2 / 2 = (2^2 + 2^2) / 2
    omega, q = turning(flat(2 * x, -2 * y), 0.25)
    np.testing.assert_allclose((omega.max(), q.min(), q.max()), (0, -4, -4), atol=1e-12)


# the shipped state --------------------------------------------------------------------------------------------------
def test_the_shipped_state_is_small_whole_and_what_this_build_computes():
    folder = same_physics.folder()
    Manifest.read(folder).verify(folder)
    assert sum(path.stat().st_size for path in folder.iterdir()) < 2e6
    off = same_physics.difference(same_physics.fields(same_physics.run("cpu")), same_physics.shipped())
    assert set(off) == {"velocity", "pressure", "qpos", "qvel", "wrench"}
    kept = UNIT * same_physics.DOMAIN.lattice.velocity / np.abs(same_physics.shipped()["velocity"]).max()
    assert off.pop("velocity") < ROUND_OFF + kept, same_physics.REMAKE  # in 16 bits beside the body
    assert max(off.values()) < ROUND_OFF, f"{off}: {same_physics.REMAKE}"


def test_shipped_state_tolerance_detects_a_tiny_change_of_the_slip_ratio():
    """A slip ratio that differs in its fourth digit: what the comparison between backends must not let pass."""
    off = same_physics.difference(same_physics.fields(same_physics.run("cpu", slip=0.9802)), same_physics.shipped())
    assert off["velocity"] > 4 * same_physics.TOLERANCE
    assert not all(check.ok for check in same_physics.checks(off))


def test_a_shipped_state_that_was_changed_is_refused(tmp_path, monkeypatch):
    path = tmp_path / same_physics.NAME
    path.write_bytes((same_physics.folder() / same_physics.NAME).read_bytes())
    Manifest.of(tmp_path).write(tmp_path)
    monkeypatch.setattr(same_physics, "folder", lambda: tmp_path)
    assert same_physics.shipped()["velocity"].dtype == np.float32
    with monkeypatch.context() as other:
        other.setattr(same_physics, "SLIP", 0.5)
        with pytest.raises(ConfigError, match="make it again: python -m"):
            same_physics.shipped()
    path.write_bytes(path.read_bytes()[:-1] + b"\0")
    with pytest.raises(StoreError, match="missing or changed"):
        same_physics.shipped()


@pytest.mark.gpu
def test_an_accelerator_computes_the_shipped_state():
    off = same_physics.difference(same_physics.fields(same_physics.run("cuda")), same_physics.shipped())
    assert max(off.values()) < same_physics.TOLERANCE, off
