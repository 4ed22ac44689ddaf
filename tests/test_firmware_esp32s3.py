"""The program for the ESP32-S3, compiled on the host against declarations of ESP-IDF; no target build is made here."""

import configparser
import re
import subprocess

import pytest
from firmware_library import COMPILER, FIRMWARE, SOURCES, STRICT, compiled, needs_compiler

from fishmj.deploy.protocols import fishmj1, lx_bus, servo_counts
from fishmj.deploy.protocols.messages import RobotInfo, RobotState
from fishmj.mjcf.identity import structure_of
from fishmj.mjcf.reading import load_robot

pytestmark = needs_compiler
MAIN, STUBS = FIRMWARE / "esp32s3" / "main.c", FIRMWARE / "host" / "esp_idf"
FAKE = FIRMWARE / "host" / "fake_esp32s3.c"


def flags() -> dict[str, str]:
    """Build flags of platformio.ini, by name."""
    found = configparser.ConfigParser()
    found.read(FIRMWARE / "platformio.ini")
    return dict(re.findall(r"-D (\w+)=(\S+)", found["env:esp32s3"]["build_flags"]))


def defined(**changed: str) -> list[str]:
    words = {**flags(), **changed, "FJ_WIFI_SSID": '"tank"', "FJ_WIFI_PASSWORD": '"password"'}
    return [f"-D{name}={value}" for name, value in words.items()]


def test_main_compiles_strictly_against_declarations_of_esp_idf():
    words = [COMPILER, *STRICT, *defined(), "-I", FIRMWARE, "-I", STUBS, "-fsyntax-only", MAIN]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-4000:]


@pytest.mark.parametrize("changed", [{"FJ_SERVO_SIGNS": "1.0f,1.0f"}, {"FJ_SERVO_IDS": "1,2"}, {"FJ_SERVO_ZEROS": "0.0f"}])
def test_main_does_not_compile_without_a_sign_and_a_zero_for_each_servo(changed):
    words = [COMPILER, *STRICT, *defined(**changed), "-I", FIRMWARE, "-I", STUBS, "-fsyntax-only", MAIN]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode != 0 and "each_servo_has_a" in done.stderr


def test_low_battery_of_the_firmware_is_that_of_the_shipped_fish():
    assert float(flags()["FJ_LOW_BATTERY"].rstrip("f")) == load_robot("fish").low_voltage


def test_firmware_main_uses_every_build_flag_and_cmake_lists_all_sources():
    text = MAIN.read_text(encoding="utf-8")
    assert set(re.findall(r"FJ_(?:PIN|SERVO|WIFI)_\w+|FJ_SHUNT_OHM|FJ_MOST_AMPERE|FJ_LOW_BATTERY", text)) == set(flags())
    listed = set(re.findall(r"\.\./(\w+\.c)", (MAIN.parent / "CMakeLists.txt").read_text(encoding="utf-8")))
    assert listed == {source.name for source in SOURCES} - {"policy.c"}
    assert "CONFIG_FREERTOS_HZ=1000\n" in (FIRMWARE / "sdkconfig.defaults").read_text(encoding="utf-8")


def test_the_pins_are_free_on_the_module_and_none_is_taken_twice():
    pins = [int(value) for name, value in flags().items() if name.startswith("FJ_PIN_")]
    taken = {0, 3, 19, 20, 45, 46, *range(26, 38)}  # strapping pins, USB, flash and PSRAM: ESP32-S3 data sheet, section 2
    assert len(set(pins)) == len(pins) == 5 and not taken & set(pins) and max(pins) <= 48


def test_the_program_arms_for_its_host_alone_and_reads_its_meter(tmp_path):
    """Two datagrams: ARM of one computer, then DISARM of another, which is dropped while the robot is armed."""
    words = [*defined(), "-I", str(STUBS)]
    board = compiled(tmp_path / "board", [MAIN, FAKE, *[s for s in SOURCES if s.name != "policy.c"]], *words)
    sent = [(b"A", fishmj1.encode_arm(1, 0.0, 0.1, 0.3)), (b"B", fishmj1.encode_disarm(2, 0.0))]
    stdin = b"".join(who + bytes([len(data)]) + data for who, data in sent)
    done = subprocess.run([board], input=stdin, capture_output=True, check=True, timeout=600)
    lines = [line.split() for line in done.stdout.decode().splitlines()]
    told = [(who, fishmj1.decode(bytes.fromhex(data)).value) for kind, who, data in lines if kind == "u"]
    info = next(value for _, value in told if isinstance(value, RobotInfo))
    assert list(info.joints) == structure_of(load_robot("fish"))["joints"] and info.firmware == "fishmj-esp32s3-0.1.0"
    assert {who for who, _ in told} == {"A"}
    last = told[-1][1]
    assert last.state is RobotState.ARMED and abs(last.voltage - 7.4) < 1e-3
    assert all(abs(angle - servo_counts.angle(524)) < 1e-6 for angle in last.joint)
    frames = [lx_bus.decode(bytes.fromhex(data)) for kind, _, data in lines if kind == "s"]
    assert [f.servo for f in frames if f.code is lx_bus.Code.LOAD_OR_UNLOAD_WRITE and f.values == (1,)] == [1, 2, 3]
