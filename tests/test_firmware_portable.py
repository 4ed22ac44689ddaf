"""The firmware's C is as portable as its README says."""

import re
import shutil
import subprocess

import pytest
from firmware_library import COMPILER, FIRMWARE, SOURCES, STRICT, compiled, needs_compiler

from fishmj.deploy.protocols import fishmj1, lx_bus, servo_counts
from fishmj.deploy.protocols.messages import RobotInfo, RobotState
from fishmj.mjcf.identity import structure_of
from fishmj.mjcf.reading import load_robot

pytestmark = needs_compiler
ALLOWED = {"memcpy", "memset", "memmove", "memcmp", "tanhf"}  # of the standard library
HEADERS = sorted(FIRMWARE.glob("*.h"))
BOARD = """
#include <math.h>
#include <string.h>
#include "board.h"
#include "ina226.h"
uint64_t clock_us(void *at);
size_t udp_receive(void *at, uint8_t *data, size_t room);
void udp_send(void *at, const uint8_t *data, size_t size);
void uart_write(void *at, const uint8_t *data, size_t size);
size_t uart_read(void *at, uint8_t *data, size_t room, uint32_t wait_us);
bool ina226_write(void *at, uint8_t reg, uint16_t word);
bool ina226_read(void *at, uint8_t reg, uint16_t *word);
void show_error(void);
void setup(void);
void every_20_ms(void);
"""
MAIN = """
#include <stdio.h>
#include <stdlib.h>
static uint64_t now = 1000000;
uint64_t clock_us(void *at) { (void)at; return ++now; }
static int arrived = 0;
static uint8_t datagram[64];
static size_t bytes = 0;
size_t udp_receive(void *at, uint8_t *data, size_t room) {
    (void)at, (void)room;
    if (arrived++) return 0;
    memcpy(data, datagram, bytes);
    return bytes;
}
static void show(char what, const uint8_t *data, size_t size) {
    printf("%c ", what);
    for (size_t i = 0; i < size; i++) printf("%02x", data[i]);
    printf("\\n");
}
void udp_send(void *at, const uint8_t *data, size_t size) { (void)at; show('u', data, size); }
static lx_frame answer;
void uart_write(void *at, const uint8_t *data, size_t size) { /* servos at 524 counts; what is no question is shown */
    (void)at;
    if (lx_decode(data, size, &answer) && answer.count == 0) {
        answer.reply = true;
        answer.count = 1;
        answer.value[0] = answer.code == LX_POS_READ ? 524 : 30;
    } else {
        answer.count = 0;
        show('s', data, size);
    }
}
size_t uart_read(void *at, uint8_t *data, size_t room, uint32_t wait_us) {
    (void)at, (void)room;
    now += wait_us / 2;
    size_t size = answer.count > 0 ? lx_encode(&answer, data) : 0;
    answer.count = 0;
    return size;
}
bool ina226_write(void *at, uint8_t reg, uint16_t word) { (void)at, (void)reg, (void)word; return true; }
bool ina226_read(void *at, uint8_t reg, uint16_t *word) { (void)at, (void)reg; *word = 5920; return true; }
void show_error(void) { exit(1); }
int main(void) {
    setup();
    bytes = fread(datagram, 1, sizeof datagram, stdin);
    every_20_ms();
    return 0;
}
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
    loop, _ = re.findall(r"```c\n(.*?)```", (FIRMWARE / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "board.c").write_text(BOARD + loop)
    subprocess.run([COMPILER, *STRICT, "-I", FIRMWARE, "-c", tmp_path / "board.c", "-o", tmp_path / "board.o"], check=True)


def run_of_the_readme(folder, datagram: bytes) -> list[tuple[str, bytes]]:
    """What the README's board sends at its first tick, after this datagram: ("u", bytes) by UDP, ("s", bytes) to the servos."""
    loop, _ = re.findall(r"```c\n(.*?)```", (FIRMWARE / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    (folder / "board.c").write_text(BOARD + loop + MAIN)
    board = compiled(folder / "board", [folder / "board.c", *SOURCES])
    done = subprocess.run([board], input=datagram, capture_output=True, check=True, timeout=600)
    return [(line.split()[0], bytes.fromhex(line.split()[1])) for line in done.stdout.decode().splitlines()]


def test_the_board_of_the_readme_says_what_the_host_asks_for_and_arms(tmp_path):
    """The host refuses other joints and another range (`deploy.arming`)."""
    off, ((_, said), *moves, (_, told)) = (
        (lines := run_of_the_readme(tmp_path, fishmj1.encode_arm(1, 0.0, 0.1, 0.3)))[:3],
        lines[3:],
    )
    info, robot = fishmj1.decode(said).value, load_robot("fish")
    assert isinstance(info, RobotInfo) and list(info.joints) == structure_of(robot)["joints"]
    assert info.servo_range == pytest.approx(robot.servo.range, rel=1e-6) and 0 < info.hold < info.neutral
    assert fishmj1.decode(told).value.state is RobotState.ARMED
    frames = lambda lines: [(f.servo, f.code, f.values) for f in (lx_bus.decode(data) for _, data in lines)]
    assert frames(off) == [(k, lx_bus.Code.LOAD_OR_UNLOAD_WRITE, (0,)) for k in (1, 2, 3)]
    on = [((k, lx_bus.Code.LOAD_OR_UNLOAD_WRITE, (1,)), (k, lx_bus.Code.MOVE_TIME_WRITE, (524, 0))) for k in (1, 2, 3)]
    assert frames(moves) == [frame for pair in on for frame in pair]
    assert fishmj1.decode(told).value.joint == pytest.approx([servo_counts.angle(524)] * 3, abs=1e-6)


def test_the_readme_lists_each_source():
    text = (FIRMWARE / "README.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `(\w+\.c)` \|", text, re.MULTILINE)) == {source.name for source in SOURCES}
