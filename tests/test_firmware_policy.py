"""A policy in the robot answers what it answers on the host."""

import ctypes
import re
from pathlib import Path

import numpy as np
import pytest
from firmware_library import FIRMWARE, compiled, needs_compiler

from fishmj.base.errors import ConfigError, StoreError, UnknownName
from fishmj.base.store import sha256
from fishmj.control.policy import Policy, shipped
from fishmj.deploy.protocols.policy_header import header, write_header

pytestmark = needs_compiler
GLUE = """
#include <string.h>
#include "policy_constants.h"

static float window[FJ_POLICY_WINDOW];
static fj_real row[2][FJ_POLICY_WIDEST];
static fj_policy_memory memory = {window, {row[0], row[1]}, false};

void reset(void) { fj_policy_reset(&memory); }
int decide(const float *seen, float *action) { return fj_policy_decide(&fj_policy_constants, &memory, seen, action); }
void digest(unsigned char *out) { memcpy(out, fj_policy_constants.sha256, 32); }
"""


def built(folder: Path, *flags: str) -> ctypes.CDLL:
    """The firmware's policy with the header in `folder`."""
    (folder / "glue.c").write_text(GLUE)
    path = compiled(
        folder / "policy.so", [folder / "glue.c", FIRMWARE / "policy.c"], "-shared", "-fPIC", "-I", str(folder), *flags
    )
    return ctypes.CDLL(str(path))


def decided(built, observation: np.ndarray, actions: int) -> np.ndarray | None:
    """One decision of the firmware; None where it refuses."""
    out = (ctypes.c_float * actions)()
    seen = np.ascontiguousarray(observation, np.float32)
    fine = built.decide(seen.ctypes.data_as(ctypes.POINTER(ctypes.c_float)), out)
    return np.array(out) if fine else None


def plausible(policy: Policy, count: int, seed: int) -> np.ndarray:
    """Observations of the size that the policy knows, some of them three times as large. (count, n_obs)"""
    rng = np.random.default_rng(seed)
    size = np.where(rng.random((count, 1)) < 0.2, 3.0, 1.0)
    return (size * rng.normal(size=(count, policy.n_obs)) * np.asarray(policy.meta["scale"])).astype(np.float32)


def largest_difference(built, policy: Policy, count: int, seed: int) -> float:
    built.reset()
    policy.reset()
    worst = 0.0
    for observation in plausible(policy, count, seed):
        ours = policy(observation)[0]
        theirs = decided(built, observation, policy.n_act)
        assert theirs is not None
        worst = max(worst, float(np.abs(ours - theirs).max()))
    return worst


@pytest.mark.parametrize("name", shipped())
def test_shipped_policies_answer_the_same_to_1e_6(name, tmp_path):
    write_header(name, tmp_path / "policy_constants.h")
    made, policy = built(tmp_path), Policy.load(name)
    assert largest_difference(made, policy, 200, seed=1) <= 1e-6


def test_the_decision_of_the_readme_compiles(tmp_path):
    write_header("station-family", tmp_path / "policy_constants.h")
    _, readme = re.findall(r"```c\n(.*?)```", (FIRMWARE / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    *made, reset, decide = readme.splitlines()
    assert "/* For robot swift; decides every 0.2 s, on command path linear. */" in (tmp_path / "policy_constants.h").read_text()
    body = "\n".join(['#include "policy_constants.h"', *made, "bool step(void) {", reset, decide, "return finite; }", ""])
    (tmp_path / "readme.c").write_text(body)
    compiled(tmp_path / "readme.so", [tmp_path / "readme.c", FIRMWARE / "policy.c"], "-shared", "-fPIC", "-I", str(tmp_path))


def test_a_board_without_double_precision_is_off_by_its_rounding(tmp_path):
    write_header("station", tmp_path / "policy_constants.h")
    assert largest_difference(built(tmp_path, "-DFJ_REAL=float"), Policy.load("station"), 400, seed=1) <= 1e-5


def small(activation: str, memory: int, hidden: tuple[int, ...] = (12, 7), seed: int = 0, **meta) -> Policy:
    """A policy of random weights: 5 observations, 3 actions."""
    rng = np.random.default_rng(seed)
    widths = [5 * memory + 3 * (memory - 1), *hidden, 3]
    weights = [
        (rng.normal(size=(b, a)).astype(np.float32) / np.float32(a) ** 0.5, rng.normal(size=b).astype(np.float32))
        for a, b in zip(widths, widths[1:], strict=False)
    ]
    scale = [1.0, 0.5, 0.3, 2.0, 1.5]
    return Policy(weights, {"scale": scale, "activation": activation, "memory": memory, "control_dt": 0.2, **meta})


@pytest.mark.parametrize("activation", ["relu", "tanh"])
@pytest.mark.parametrize("memory", [1, 2, 8])
def test_policies_with_a_memory_keep_the_same_window(activation, memory, tmp_path):
    policy = small(activation, memory)
    (tmp_path / "policy_constants.h").write_text(header(policy, "ab" * 32))
    made = built(tmp_path)
    assert largest_difference(made, policy, 200, seed=2) <= 1e-6
    assert largest_difference(made, policy, 50, seed=3) <= 1e-6  # and forgets it when told to


def test_a_policy_of_one_layer_is_a_matrix(tmp_path):
    policy = small("relu", 1, hidden=())
    (tmp_path / "policy_constants.h").write_text(header(policy, "ab" * 32))
    assert largest_difference(built(tmp_path), policy, 100, seed=4) <= 1e-6


def test_an_answer_that_is_not_finite_is_refused_and_not_remembered(tmp_path):
    policy = small("relu", 3)
    (tmp_path / "policy_constants.h").write_text(header(policy, "ab" * 32))
    made = built(tmp_path)
    sane = plausible(policy, 6, seed=5)
    for observation in sane[:3]:
        assert decided(made, observation, 3) == pytest.approx(policy(observation)[0], abs=1e-6)
    for bad in (np.nan, -np.nan):
        broken = sane[3].copy()
        broken[2] = bad
        assert decided(made, broken, 3) is None
        with pytest.raises(ConfigError):
            policy(broken)
    for observation in sane[3:]:
        assert decided(made, observation, 3) == pytest.approx(policy(observation)[0], abs=1e-6)


def test_the_header_carries_the_hash_that_the_host_compares(tmp_path):
    path = small("relu", 1).save(tmp_path / "mine.safetensors")
    write_header(path, tmp_path / "policy_constants.h")
    out = (ctypes.c_ubyte * 32)()
    built(tmp_path).digest(out)
    assert bytes(out).hex() == sha256(path)


def test_each_weight_is_written_exactly():
    policy = small("relu", 1)
    text = header(policy, "ab" * 32)
    block = re.search(r"fj_policy_w0\[60\] = \{(.*?)\}", text, re.DOTALL)
    assert block is not None
    numbers = [np.float32(word.removesuffix("f")) for word in re.findall(r"[-\d.e+]+f", block.group(1))]
    assert np.array_equal(np.array(numbers, np.float32), policy.weights[0][0].reshape(-1))


def test_a_name_cannot_leave_the_comment():
    first = header(small("relu", 1), "ab" * 32, "x */ int main(void){} /*\n").splitlines()[0]
    assert first.count("*/") == 1 and first.endswith("*/")


def test_what_is_no_policy_is_refused(tmp_path):
    with pytest.raises(UnknownName):
        write_header("no-such-policy", tmp_path / "x.h")
    (tmp_path / "broken.safetensors").write_bytes(b"x" * 100)
    with pytest.raises(StoreError):
        write_header(tmp_path / "broken.safetensors", tmp_path / "x.h")
    assert not (tmp_path / "x.h").exists()
