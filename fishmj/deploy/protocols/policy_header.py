"""A policy as a C header: constants that `firmware/policy.c` computes with, in the robot itself.

    fishmj deploy firmware-policy NAME --out FILE

Weights are written with nine significant digits, which restore every float32 exactly. The header carries the hash of the
policy's file, which the firmware reports in INFO (`policy_sha256`) and the host compares before it arms.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.base.store import sha256, write_text
from fishmj.control.policy import Policy, file_of

_A_LINE = 8  # numbers
_ACTIVATIONS = {"relu": "FJ_RELU", "tanh": "FJ_TANH"}
MOST_WIDTH = 65_535  # inputs of a layer: the firmware counts them in 16 bits


def header(policy: Policy, digest: str, name: str = "") -> str:
    """The C header of a policy.

    Args:
        digest: sha256 of the policy's file, 64 hex digits. name: for the comment at the top.
    Raises:
        ConfigError: the policy's parts do not fit together, or a layer is too wide for the firmware.
    """
    policy.check("policy header")
    widths = [policy.weights[0][0].shape[1], *(w.shape[0] for w, _ in policy.weights)]
    if max(widths) > MOST_WIDTH:
        raise ConfigError(f"policy with a layer of {max(widths)}; expected at most {MOST_WIDTH} for the firmware")
    layers, told = range(len(policy.weights)), lambda key: _label(str(policy.meta.get(key, "unknown")))
    window = (policy.memory - 1) * (policy.n_act + policy.n_obs)
    arrays = [_floats("fj_policy_scale", np.asarray(policy.meta["scale"], np.float32))]
    for i, (w, b) in enumerate(policy.weights):
        arrays += [_floats(f"fj_policy_w{i}", np.asarray(w, np.float32)), _floats(f"fj_policy_b{i}", np.asarray(b, np.float32))]
    return "\n".join(
        [
            f"/* Policy {_label(name)}, sha256 {digest}. Include it in one file only. */",
            f"/* For robot {told('robot')}; decides every {told('control_dt')} s, on command path {told('command_path')}. */",
            "#ifndef FJ_POLICY_CONSTANTS_H",
            "#define FJ_POLICY_CONSTANTS_H",
            "",
            '#include "policy.h"',
            "",
            f"#define FJ_POLICY_OBSERVATIONS {policy.n_obs}u",
            f"#define FJ_POLICY_ACTIONS {policy.n_act}u",
            f"#define FJ_POLICY_WINDOW {max(1, window)}u /* floats; the policy uses {window} of them */",
            f"#define FJ_POLICY_WIDEST {max(widths)}u",
            "",
            *arrays,
            f"static const uint16_t fj_policy_width[{len(widths)}] = {{{', '.join(str(n) for n in widths)}}};",
            f"static const float *const fj_policy_weight[{len(layers)}] = {{{', '.join(f'fj_policy_w{i}' for i in layers)}}};",
            f"static const float *const fj_policy_bias[{len(layers)}] = {{{', '.join(f'fj_policy_b{i}' for i in layers)}}};",
            f"static const uint8_t fj_policy_sha256[32] = {{{', '.join(str(byte) for byte in bytes.fromhex(digest))}}};",
            "",
            "static const fj_policy fj_policy_constants = {",
            f"    {len(layers)}, FJ_POLICY_OBSERVATIONS, FJ_POLICY_ACTIONS, {policy.memory}, "
            f"{_ACTIVATIONS[policy.meta['activation']]}, {_number(policy.meta.get('control_dt') or 0.0)},",
            "    fj_policy_width, fj_policy_scale, fj_policy_weight, fj_policy_bias, fj_policy_sha256,",
            "};",
            "",
            "#endif",
            "",
        ]
    )


def write_header(source: str | Path, out: str | Path) -> Path:
    """Writes the C header of a policy, atomically. source: shipped name, path, or folder of a training. Returns `out`.

    Raises:
        UnknownName: no such policy. StoreError: damaged file, or `out` cannot be written. ConfigError: not a policy, or too wide.
    """
    path = file_of(source)
    return write_text(out, header(Policy.load(path), sha256(path), path.stem))


def _label(name: str) -> str:
    return "".join(c if c.isalnum() or c in " _.-" else "?" for c in name)[:64]  # a comment must not end here


def _number(value: float) -> str:
    text = f"{float(value):.9g}"
    return (text if any(c in text for c in ".e") else f"{text}.0") + "f"


def _floats(name: str, values: np.ndarray) -> str:
    numbers = [_number(value) for value in values.reshape(-1)]
    return f"static const float {name}[{len(numbers)}] = {{\n{_lines(numbers)}}};\n"


def _lines(numbers: list[str]) -> str:
    rows: Iterable[list[str]] = (numbers[i : i + _A_LINE] for i in range(0, len(numbers), _A_LINE))
    return "".join(f"    {', '.join(row)},\n" for row in rows)
