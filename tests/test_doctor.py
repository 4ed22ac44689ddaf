"""The doctor names what is wrong and the line that mends it, and survives whatever is missing."""

import json
import os
import subprocess
import sys

import pytest

from fishmj.base import console, doctor
from fishmj.base.doctor import DoctorFinding, browser, requirements, verdicts, version

DECIDED = {"mujoco", "numpy", "scipy", "matplotlib", "safetensors", "pydantic", "jinja2", "packaging", "threadpoolctl"}


def one(findings: list[DoctorFinding], name: str) -> DoctorFinding:
    return next(f for f in findings if f.name == name)


def test_a_missing_core_package_is_bad_with_the_line_that_mends_it():
    found = one(doctor.packages(["numpy>=2.4", "no-such-package==1.2.3"]), "no-such-package")
    assert found.state == "bad" and "missing" in found.text and 'pip install "no-such-package==1.2.3"' in found.text


def test_a_wrong_version_of_a_core_package_is_bad_and_says_which():
    found = one(doctor.packages(["numpy>=99"]), "numpy")
    assert found.state == "bad" and version("numpy") in found.text and ">=99" in found.text


def test_the_packages_that_run_this_test_are_right():
    assert [f for f in doctor.packages() if f.section == "core" and f.state != "ok"] == []
    assert {f.name for f in doctor.packages() if f.section == "extras"} == {
        "cuda",
        "fast",
        "logs",
        "sb3",
        "ray",
        "onnx",
        "train",
        "suite",
        "solver",
        "search",
        "view",
        "tank",
        "ros",
        "sysid",
        "bench",
        "tensorboard",
        "menagerie",
        "docs",
        "dev",
    }


@pytest.mark.parametrize(("release", "state"), [((3, 10), "bad"), ((3, 11), "ok"), ((3, 14), "ok")])
def test_every_python_that_the_package_takes_is_right(release, state, monkeypatch):
    monkeypatch.setattr(sys, "version_info", (*release, 0, "final", 0))
    assert next(found.state for found in doctor.machine() if found.name == "python") == state


def test_a_missing_extra_is_no_fault_and_has_its_install_line():
    found = one(doctor.packages(['no-such-package>=1; extra == "thing"', 'numpy; extra == "thing"']), "thing")
    assert found.state == "no" and "no-such-package" in found.text and 'pip install "fishmj[thing]"' in found.text


def test_doctor_reports_a_missing_extra_although_its_package_is_installed():
    found = one(doctor.packages(['pytest[dev]; extra == "thing"']), "thing")
    assert found.state == ("no" if version("argcomplete") is None else "ok")


def test_the_core_is_what_the_house_decided():
    names = {line.partition(";")[0].split("=")[0].split(">")[0].strip() for line in requirements() if "extra" not in line}
    assert names == DECIDED


@pytest.mark.parametrize(
    ("code", "says"),
    [
        ("raise SystemExit(7)", "exit 7"),
        ("import os; os.kill(os.getpid(), 11)", "exit -11"),
        ("raise RuntimeError('driver lost')", "driver lost"),
        ("print('no json')", "no answer that can be read"),
    ],
)
def test_a_probe_that_dies_is_a_line_not_a_crash(code, says):
    assert says in doctor.probe(code, "json")


def test_a_probe_that_hangs_is_given_up(monkeypatch):
    monkeypatch.setattr(doctor, "PROBE_TIME", 0.5)
    assert "no answer within 0.5 s" in doctor.probe("import time; time.sleep(30)", "json")


def test_a_probe_of_a_package_that_is_absent_says_so():
    assert doctor.probe("print(1)", "no_such_module") == "no_such_module is not installed"


def test_a_broken_nvidia_smi_is_a_note(tmp_path, monkeypatch):
    tool = tmp_path / "nvidia-smi"
    tool.write_text("#!/bin/sh\necho 'Failed to talk to the driver'; exit 9\n")
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    state, text = doctor._nvidia()
    assert state == "note" and "Failed to talk to the driver" in text


def test_no_nvidia_smi_means_the_cpu(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert doctor._nvidia()[0] == "no"


def test_a_browser_can_be_named(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("FISHMJ_BROWSER", raising=False)
    assert browser() is None
    mine = tmp_path / "mine"
    mine.write_text("#!/bin/sh\n")
    mine.chmod(0o755)
    monkeypatch.setenv("FISHMJ_BROWSER", str(mine))
    assert browser() == str(mine)


def test_a_misspelt_renderer_is_found(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "elg")
    found = one(doctor.known_issues(), "MUJOCO_GL")
    assert found.state == "bad" and "'elg'" in found.text and "osmesa" in found.text
    monkeypatch.setenv("MUJOCO_GL", "disabled")
    assert "MUJOCO_GL" not in {f.name for f in doctor.known_issues()}


def test_a_later_mujoco_is_named_as_a_trap(monkeypatch):
    monkeypatch.setattr(doctor, "version", lambda name: "4.0.1" if name == "mujoco" else None)
    assert one(doctor.known_issues(), "mujoco 4").state == "bad"


def test_a_broken_core_means_that_nothing_works():
    findings = [DoctorFinding("core", "numpy", "bad", "missing")]
    assert {f.state for f in verdicts(findings)} == {"no"}


@pytest.mark.parametrize(("state", "code"), [("ok", 0), ("no", 0), ("note", 0), ("bad", 1)])
def test_only_what_must_be_mended_fails_the_check(state, code, monkeypatch, capsys):
    monkeypatch.setattr(doctor, "examine", lambda: [DoctorFinding("core", "thing", state, "text")])
    assert console.run(doctor.main, ["--json"]) == code
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert answer == {"healthy": code == 0, "findings": [{"section": "core", "name": "thing", "state": state, "text": "text"}]}


def test_the_whole_report_runs():
    done = subprocess.run([sys.executable, "-m", "fishmj.base.doctor", "--json"], capture_output=True, text=True, check=False)
    answer = json.loads(done.stdout.splitlines()[-1])
    assert done.returncode == (0 if answer["healthy"] else 1) and done.stderr == ""
    assert {f["section"] for f in answer["findings"]} == {"machine", "core", "extras", "devices", "files", "traps", "works"}
