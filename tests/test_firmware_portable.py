"""The firmware's C is as portable as its README says."""

import re
import shutil
import subprocess

import pytest
from firmware_library import COMPILER, FIRMWARE, SOURCES, STRICT, needs_compiler

pytestmark = needs_compiler
ALLOWED = {"memcpy", "memset", "memmove", "memcmp", "tanhf"}  # of the standard library
HEADERS = sorted(FIRMWARE.glob("*.h"))
BOARD = """
#include <math.h>
#include "ina226.h"
#include "lx_bus.h"
#include "policy.h"
#include "robot.h"
void read_servos(float *joint);
void move_servos(const float *target);
void unload_servos(void);
fj_telemetry measured(const float *joint);
size_t udp_receive(uint8_t *data, size_t room);
void udp_send(const uint8_t *data, size_t size);
void tick(uint64_t now_us);
"""


def test_it_asks_nothing_of_a_system_but_a_few_functions(tmp_path):
    """No allocation, no files, no clock: what the object files leave open."""
    if (nm := shutil.which("nm")) is None:
        pytest.skip("no nm here: install binutils")
    objects = []
    for source in SOURCES:
        objects.append(tmp_path / f"{source.stem}.o")
        subprocess.run([COMPILER, *STRICT, "-c", source, "-o", objects[-1]], check=True)
    listed = lambda option: set(
        re.findall(r"(?m)^\s*(?:[0-9a-f]+ )?[A-Za-z] (\w+)$", subprocess.check_output([nm, option, *objects], text=True))
    )
    assert len(listed("--defined-only")) > 30
    assert listed("--undefined-only") - listed("--defined-only") - {"_GLOBAL_OFFSET_TABLE_", "__stack_chk_fail"} <= ALLOWED


def test_each_header_stands_alone(tmp_path):
    for header in HEADERS:
        (tmp_path / "alone.c").write_text(f'#include "{header.name}"\n#include "{header.name}"\nint x;\n')
        subprocess.run([COMPILER, *STRICT, "-I", FIRMWARE, "-fsyntax-only", tmp_path / "alone.c"], check=True)


def test_a_sketch_in_cpp_can_use_it(tmp_path):
    if (cpp := next((found for name in ("c++", "g++", "clang++") if (found := shutil.which(name))), None)) is None:
        pytest.skip("no C++ compiler here: install g++ or clang++")
    (tmp_path / "sketch.cpp").write_text(
        "".join(f'#include "{header.name}"\n' for header in HEADERS) + "int main() { return 0; }\n"
    )
    subprocess.run([cpp, "-Wall", "-Wextra", "-Werror", "-I", FIRMWARE, "-fsyntax-only", tmp_path / "sketch.cpp"], check=True)
    assert all('extern "C"' in header.read_text() for header in HEADERS)


def test_the_loop_of_the_readme_compiles(tmp_path):
    (loop,) = re.findall(r"```c\n(.*?)```", (FIRMWARE / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "board.c").write_text(BOARD + loop)
    subprocess.run([COMPILER, *STRICT, "-I", FIRMWARE, "-c", tmp_path / "board.c", "-o", tmp_path / "board.o"], check=True)


def test_the_readme_lists_each_source():
    text = (FIRMWARE / "README.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `(\w+\.c)` \|", text, re.MULTILINE)) == {source.name for source in SOURCES}
