"""The C of `firmware/` as a shared library for ctypes, and its structures. Without a C compiler its tests are skipped."""

import ctypes
import shutil
import subprocess
from ctypes import (
    POINTER,
    c_bool,
    c_char,
    c_char_p,
    c_float,
    c_int,
    c_int8,
    c_int32,
    c_size_t,
    c_uint8,
    c_uint16,
    c_uint32,
    c_uint64,
)
from functools import cache
from pathlib import Path

import pytest

from fishmj.deploy.protocols.messages import RobotInfo, Telemetry

FIRMWARE = Path(__file__).resolve().parent.parent / "firmware"
SOURCES = sorted(FIRMWARE.glob("*.c"))
STRICT = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror", "-O2"]
COMPILER = next((found for name in ("cc", "gcc", "clang") if (found := shutil.which(name))), None)
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler here: install gcc or clang to test the firmware's C")
JOINTS = 8


def compiled(out: Path, sources: list[Path], *flags: str) -> Path:
    """Compile C; a warning is an error."""
    command = [str(COMPILER), *STRICT, *flags, "-I", str(FIRMWARE), "-o", str(out), *map(str, sources), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        pytest.fail(done.stderr[-4000:], pytrace=False)
    return out


class Struct(ctypes.Structure):
    """Compares and prints by value."""

    def values(self) -> dict:
        return {name: getattr(self, name) for name, *_ in self._fields_}


class Message(Struct):
    _fields_ = [
        ("kind", c_uint8), ("joints", c_uint8), ("has_speed", c_bool), ("seq", c_uint32), ("time_us", c_uint64),
        ("hold_us", c_uint32), ("neutral_us", c_uint32), ("joint", c_float * JOINTS), ("speed", c_float * JOINTS),
    ]  # fmt: skip


class CTelemetry(Struct):
    _fields_ = [
        ("seq", c_uint32), ("time_us", c_uint64), ("joints", c_uint8), ("state", c_uint8), ("has", c_uint8), ("echo", c_uint32),
        ("echo_time_us", c_uint64), ("voltage", c_float), ("current", c_float), ("joint", c_float * JOINTS),
        ("servo_mv", c_uint16 * JOINTS), ("temperature", c_int8 * JOINTS), ("fault", c_uint8 * JOINTS),
    ]  # fmt: skip


class Info(Struct):
    _fields_ = [
        ("joints", c_uint8), ("hold_us", c_uint32), ("neutral_us", c_uint32), ("servo_range", c_float), ("firmware", c_char * 33),
        ("firmware_sha256", c_uint8 * 32), ("policy_sha256", c_uint8 * 32), ("servo_id", c_uint8 * JOINTS),
        ("name", (c_char * 17) * JOINTS),
    ]  # fmt: skip


class CLimits(Struct):
    _fields_ = [
        ("servo_range", c_float), ("rate", c_float), ("neutral_rate", c_float), ("lead", c_float), ("near", c_float),
        ("rest_us", c_uint32),
    ]  # fmt: skip


class CWatchdog(Struct):
    _fields_ = [
        ("limits", CLimits), ("joints", c_uint8), ("state", c_uint8), ("hold_us", c_uint32), ("neutral_us", c_uint32),
        ("resting", c_bool), ("rested", c_bool), ("heard_us", c_uint64), ("stepped_us", c_uint64), ("rest_from_us", c_uint64),
        ("target", c_float * JOINTS), ("goal", c_float * JOINTS), ("speed", c_float * JOINTS),
    ]  # fmt: skip


class CBounds(Struct):
    _fields_ = [
        ("far_off", c_float), ("still", c_float), ("stuck_us", c_uint32), ("hot", c_float), ("low", c_float),
        ("sag_us", c_uint32),
    ]  # fmt: skip


class CGuard(Struct):
    _fields_ = [
        ("bounds", CBounds), ("joints", c_uint8), ("away", c_bool * JOINTS), ("away_us", c_uint64 * JOINTS),
        ("place", c_float * JOINTS), ("low", c_bool), ("low_us", c_uint64),
    ]  # fmt: skip


class Gate(Struct):
    _fields_ = [
        ("heard", c_bool), ("dropping", c_bool), ("last", c_uint32), ("dropped", c_uint32), ("last_us", c_uint64),
        ("dropped_us", c_uint64), ("row", c_uint32),
    ]  # fmt: skip


class CRobot(Struct):
    _fields_ = [
        ("info", Info), ("watchdog", CWatchdog), ("guard", CGuard), ("gate", Gate), ("torque", c_bool), ("sent", c_uint32),
        ("bad", c_uint32), ("commanded", c_bool), ("echo", c_uint32), ("echo_time_us", c_uint64), ("last", c_float * JOINTS),
    ]  # fmt: skip


class CFrame(Struct):
    _fields_ = [("servo", c_uint8), ("code", c_uint8), ("count", c_uint8), ("reply", c_bool), ("value", c_int32 * 3)]


class CReader(Struct):
    _fields_ = [
        ("waiting", c_uint8 * 10), ("count", c_uint8), ("skipped", c_uint32), ("damaged", c_uint32), ("echoes", c_uint32),
    ]  # fmt: skip


_FLOATS, _BYTES = POINTER(c_float), POINTER(c_uint8)
_SIGNATURES = {
    "fj_crc32": (c_uint32, [c_char_p, c_size_t]),
    "fj_decode": (c_int, [c_char_p, c_size_t, POINTER(Message)]),
    "fj_encode_telemetry": (c_size_t, [POINTER(CTelemetry), _BYTES, c_size_t]),
    "fj_encode_info": (c_size_t, [c_uint32, c_uint64, POINTER(Info), _BYTES, c_size_t]),
    "fj_default_limits": (CLimits, []),
    "fj_watchdog_init": (c_bool, [POINTER(CWatchdog), c_uint8, CLimits, c_uint32, c_uint32]),
    "fj_watchdog_arm": (c_bool, [POINTER(CWatchdog), c_uint64, c_uint32, c_uint32, _FLOATS]),
    "fj_watchdog_disarm": (None, [POINTER(CWatchdog)]),
    "fj_watchdog_fault": (None, [POINTER(CWatchdog)]),
    "fj_watchdog_command": (c_bool, [POINTER(CWatchdog), c_uint64, c_uint8, _FLOATS, _FLOATS]),
    "fj_watchdog_step": (c_bool, [POINTER(CWatchdog), c_uint64, _FLOATS]),
    "fj_default_bounds": (CBounds, []),
    "fj_guard_init": (c_bool, [POINTER(CGuard), c_uint8, CBounds]),
    "fj_guard_check": (None, [POINTER(CGuard), c_uint64, _FLOATS, _FLOATS, POINTER(c_int8), c_float, _BYTES]),
    "fj_gate_accept": (c_bool, [POINTER(Gate), c_uint32, c_uint64]),
    "fj_robot_init": (c_bool, [POINTER(CRobot), POINTER(Info), CLimits]),
    "fj_robot_hear": (c_size_t, [POINTER(CRobot), c_char_p, c_size_t, c_uint64, _FLOATS, _BYTES, c_size_t]),
    "fj_robot_act": (c_bool, [POINTER(CRobot), c_uint64, _FLOATS]),
    "fj_robot_report": (c_size_t, [POINTER(CRobot), c_uint64, POINTER(CTelemetry), _BYTES, c_size_t]),
    "lx_encode": (c_size_t, [POINTER(CFrame), _BYTES]),
    "lx_decode": (c_bool, [c_char_p, c_size_t, POINTER(CFrame)]),
    "lx_reader_push": (c_bool, [POINTER(CReader), c_uint8, POINTER(CFrame)]),
    "lx_reader_silence": (c_bool, [POINTER(CReader), POINTER(CFrame)]),
    "lx_counts": (c_int32, [c_float, c_float]),
    "lx_angle": (c_float, [c_int32, c_float]),
    "lx_move_time": (c_int32, [c_float, c_float]),
    "ina226_config": (c_uint16, [c_uint16, c_uint16, c_uint16]),
    "ina226_period_us": (c_uint32, [c_uint16]),
    "ina226_current_lsb": (c_float, [c_float]),
    "ina226_calibration": (c_uint16, [c_float, c_float]),
    "ina226_lsb_of": (c_float, [c_uint16, c_float]),
    "ina226_bus_volts": (c_float, [c_uint16]),
    "ina226_shunt_volts": (c_float, [c_uint16]),
    "ina226_amperes": (c_float, [c_uint16, c_float]),
    "ina226_watts": (c_float, [c_uint16, c_float]),
}


@pytest.fixture(scope="session")
def firmware(tmp_path_factory) -> ctypes.CDLL:
    """The firmware, compiled once."""
    return library(tmp_path_factory.getbasetemp())


@cache
def library(folder: Path) -> ctypes.CDLL:
    """The firmware, compiled into `folder`, with the types of its functions."""
    found = ctypes.CDLL(str(compiled(folder / "firmware.so", SOURCES, "-shared", "-fPIC")))
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(found, name)
        function.restype, function.argtypes = result, arguments
    return found


def floats(values) -> ctypes.Array:
    return (c_float * len(values))(*values)


def microseconds(seconds: float) -> int:
    return round(seconds * 1e6)


def c_telemetry(it: Telemetry) -> CTelemetry:
    """What the firmware holds before it sends the same packet."""
    has = (it.echo is not None) + 2 * (it.voltage is not None)
    has += 4 * (it.servo_voltage is not None) + 8 * (it.temperature is not None) + 16 * (it.fault is not None)
    row = lambda kind, values: (kind * JOINTS)(*(values or ()))
    return CTelemetry(
        it.seq, microseconds(it.time), len(it.joint), it.state, has, it.echo or 0, microseconds(it.echo_time or 0),
        0.0 if it.voltage is None else it.voltage, 0.0 if it.current is None else it.current, row(c_float, it.joint),
        row(c_uint16, [round(1000 * v) for v in it.servo_voltage or ()]), row(c_int8, [round(v) for v in it.temperature or ()]),
        row(c_uint8, it.fault),
    )  # fmt: skip


def c_info(it: RobotInfo) -> Info:
    digest = lambda text: (c_uint8 * 32)(*bytes.fromhex(text))
    names = ((c_char * 17) * JOINTS)()
    for k, name in enumerate(it.joints):
        names[k].value = name.encode()
    return Info(
        len(it.joints), microseconds(it.hold), microseconds(it.neutral), it.servo_range, it.firmware.encode(),
        digest(it.firmware_sha256), digest(it.policy_sha256), (c_uint8 * JOINTS)(*it.servo_ids), names,
    )  # fmt: skip
