"""A policy as an ONNX graph (extra `onnx`).

    observation (N, n_obs), unscaled  ->  action (N, n_act) in [-1, 1]

A policy with memory m > 1 has two more inputs and one more output, so that the graph holds no state:

    window   (N, (m - 1) (n_act + n_obs))  the last `next_window`; its values do not count where restart is true
    restart  (N, 1) bool                   true in the first decision of an episode

Inputs and outputs are float32, sums are in double precision, as in NumPy and in the firmware. The header of the policy is the
graph's metadata `fishmj_policy`, with the hash of its file in `policy_sha256`.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.base.store import sha256, write_bytes
from fishmj.control.policy import Policy, file_of

OPSET, IR_VERSION = 17, 8  # of 2022, so that older runtimes read them too
CLOSE = 1e-6  # tolerance of actions against NumPy
STEPS, FISH, SEED = 40, 8, 0  # of the check against NumPy
_ACTIVATIONS = {"relu": "Relu", "tanh": "Tanh"}


def onnx_model(policy: Policy, digest: str, name: str = "policy") -> Any:
    """Returns the `onnx.ModelProto` of a policy.

    Args:
        digest: sha256 of the policy's file.
    Raises:
        ConfigError: the policy's parts do not fit together. MissingExtra: `onnx` is not installed.
    """
    from onnx import TensorProto, helper, numpy_helper

    policy.check(name)
    n_obs, n_act, others = policy.n_obs, policy.n_act, policy.memory - 1
    nodes: list = []
    constants = [numpy_helper.from_array(np.asarray(policy.meta["scale"], np.float32), "scale")]
    add = lambda kind, given, made, **options: nodes.append(helper.make_node(kind, given, [made], **options))
    value = lambda label, width, kind=TensorProto.FLOAT: helper.make_tensor_value_info(label, kind, ["N", width])
    add("Div", ["observation", "scale"], "sight")
    seen, inputs, outputs = "sight", [value("observation", n_obs)], [value("action", n_act)]
    if others:
        width = others * (n_act + n_obs)
        constants.append(numpy_helper.from_array(np.array([0, n_act, 0, 0]), "pads"))
        add("Pad", ["sight", "pads"], "rest")  # zero action and the present observation
        add("Concat", ["rest"] * others, "rested", axis=1)
        add("Where", ["restart", "rested", "window"], "past")
        add("Concat", ["sight", "past"], "seen", axis=1)
        seen = "seen"
        inputs += [value("window", width), value("restart", 1, TensorProto.BOOL)]
        outputs.append(value("next_window", width))
    add("Cast", [seen], "x0", to=TensorProto.DOUBLE)
    last = len(policy.weights) - 1
    for i, (w, b) in enumerate(policy.weights):
        for label, array in (("w", w), ("b", b)):
            constants.append(numpy_helper.from_array(np.asarray(array, np.float32), f"{label}{i}"))
            add("Cast", [f"{label}{i}"], f"{label}{i}_double", to=TensorProto.DOUBLE)
        add("Gemm", [f"x{i}", f"w{i}_double", f"b{i}_double"], f"y{i}", transB=1)
        add("Tanh" if i == last else _ACTIVATIONS[policy.meta["activation"]], [f"y{i}"], f"x{i + 1}")
    add("Cast", [f"x{last + 1}"], "action", to=TensorProto.FLOAT)
    if others:
        constants += [numpy_helper.from_array(np.array([k]), f"slice{k}") for k in sorted({0, 1, width})]
        add("Concat", ["action", seen], "longer", axis=1)
        add("Slice", ["longer", "slice0", f"slice{width}", "slice1"], "next_window")
    graph = helper.make_graph(nodes, name, inputs, outputs, constants)
    opset = [helper.make_opsetid("", OPSET)]
    said = {"opset_imports": opset, "ir_version": IR_VERSION, "producer_name": "fishmj", "doc_string": interface(policy)}
    model = helper.make_model(graph, **said)
    helper.set_model_props(model, {"policy_sha256": digest, "fishmj_policy": json.dumps(policy.meta, sort_keys=True)})
    return model


def interface(policy: Policy) -> str:
    """Inputs and outputs of the graph, for its `doc_string`."""
    meta = policy.meta
    said = f"observation (N, {policy.n_obs}) float32 in SI units, unscaled -> action (N, {policy.n_act}) in [-1, 1]."
    order = ", ".join(f"{one['name']} [{one['unit']}]" for one in meta.get("observation", ()))
    said += f" Observations in order: {order}." if order else ""
    said += f" Action: {meta['action']}, every {meta['control_dt']:g} s." if {"action", "control_dt"} <= set(meta) else ""
    if policy.memory > 1:
        width = (policy.memory - 1) * (policy.n_act + policy.n_obs)
        said += f" window (N, {width}) float32 is the last next_window; restart (N, 1) bool is true in an episode's first call,"
        said += " in which the window does not count."
    return said


def largest_difference(policy: Policy, answer) -> float:
    """Largest difference between a policy and a graph over several episodes of several fish, observations of order one.

    Args:
        answer: function of {input name: array} that returns the graph's outputs in order.
    """
    rng = np.random.default_rng(SEED)
    scale = np.asarray(policy.meta["scale"])
    window = np.full((FISH, (policy.memory - 1) * (policy.n_act + policy.n_obs)), np.nan, np.float32)
    worst = 0.0
    for k in range(STEPS):
        obs = (rng.normal(size=(FISH, policy.n_obs)) * rng.choice([1.0, 3.0], (FISH, 1)) * scale).astype(np.float32)
        first = k % (STEPS // 2) == 0
        if first:
            policy.reset()
        given = {"observation": obs}
        if policy.memory > 1:
            given |= {"window": window, "restart": np.full((FISH, 1), first)}
        action, *after = answer(given)
        window = after[0] if after else window
        worst = max(worst, float(np.abs(action - policy(obs)).max()))
    policy.reset()
    return worst


def write_onnx(source: str | Path, out: str | Path) -> float:
    """Writes the graph of a policy, atomically, after its check against NumPy; returns the largest difference.

    Args:
        source: shipped name, path, or folder of a training.
    Raises:
        UnknownName, StoreError, ConfigError: no such policy, a damaged one, or a graph that differs by more than CLOSE.
        MissingExtra: `onnx` is not installed.
    """
    from onnx import checker
    from onnx.reference import ReferenceEvaluator

    path = file_of(source)
    policy = Policy.load(path)
    model = onnx_model(policy, sha256(path), path.stem)
    checker.check_model(model, full_check=True)
    evaluator = ReferenceEvaluator(model)
    off = largest_difference(policy, lambda given: evaluator.run(None, given))
    if not off <= CLOSE:
        raise ConfigError(f"{path}: its ONNX graph differs from NumPy by {off:.2g}, expected at most {CLOSE:g}; nothing written")
    write_bytes(out, model.SerializeToString())
    return off
