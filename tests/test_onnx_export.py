"""The ONNX graph of a policy answers what NumPy and the firmware answer."""

import json
import sys

import numpy as np
import pytest
from test_policy import policy

from fishmj.base.errors import ConfigError, MissingExtra, UnknownName
from fishmj.base.store import sha256
from fishmj.control import onnx_export
from fishmj.control.onnx_export import CLOSE, largest_difference, onnx_model, write_onnx
from fishmj.control.policy import Policy, file_of, shipped

onnx = pytest.importorskip("onnx", reason="needs the extra onnx")


def evaluated(model):
    """Answer of the graph by onnx's own evaluator, or by onnxruntime where it is installed."""
    try:
        from onnxruntime import InferenceSession

        session = InferenceSession(model.SerializeToString())
    except ModuleNotFoundError:
        from onnx.reference import ReferenceEvaluator

        session = ReferenceEvaluator(model)
    return lambda given: session.run(None, given)


@pytest.mark.parametrize("name", shipped())
def test_shipped_policies_as_onnx_answer_the_same(name, tmp_path):
    assert write_onnx(name, tmp_path / "p.onnx") <= CLOSE
    model = onnx.load(tmp_path / "p.onnx")
    assert largest_difference(Policy.load(name), evaluated(model)) <= CLOSE
    props = {row.key: row.value for row in model.metadata_props}
    assert props["policy_sha256"] == sha256(file_of(name))
    assert json.loads(props["fishmj_policy"])["robot"] == "swift"


@pytest.mark.parametrize("activation", ["relu", "tanh"])
@pytest.mark.parametrize("memory", [1, 2, 8])
def test_onnx_graph_keeps_the_window_of_a_policy(activation, memory):
    made = policy(activation, memory)
    model = onnx_model(made, "ab" * 32)
    onnx.checker.check_model(model, full_check=True)
    assert [one.name for one in model.graph.input] == ["observation", "window", "restart"][: 1 if memory == 1 else 3]
    assert largest_difference(made, evaluated(model)) <= CLOSE


@pytest.mark.parametrize(("name", "said"), [("station", "observation (N, 11)"), ("station-family", "window (N, 98) float32")])
def test_onnx_file_describes_its_inputs(name, said):
    made = onnx_model(Policy.load(name), "")
    assert "target_x [m], target_y [m], " in made.doc_string and "joint angle over 1.047198 rad, every 0.2 s" in made.doc_string
    assert said in made.doc_string and all(one.name in made.doc_string for one in (*made.graph.input, *made.graph.output))


def test_onnx_check_sees_a_wrong_weight():
    made = policy("relu", 8)
    model = onnx_model(made, "ab" * 32)
    made.weights[1][0][2, 3] += 0.01
    assert largest_difference(made, evaluated(model)) > CLOSE


def test_onnx_check_sees_a_window_in_the_wrong_order():
    made = policy("tanh", 3)
    answer = evaluated(onnx_model(made, "ab" * 32))

    def swapped(given):
        action, window = answer(given)
        return action, np.concatenate([window[:, 14:], window[:, :14]], 1)

    assert largest_difference(made, swapped) > CLOSE


def test_graph_that_differs_is_not_written(tmp_path, monkeypatch):
    monkeypatch.setattr(onnx_export, "largest_difference", lambda policy, answer: 2e-6)
    with pytest.raises(ConfigError, match="differs from NumPy by 2e-06"):
        write_onnx("station", tmp_path / "p.onnx")
    assert not (tmp_path / "p.onnx").exists()


def test_onnx_of_no_policy_is_refused(tmp_path):
    with pytest.raises(UnknownName):
        write_onnx("no-such-policy", tmp_path / "p.onnx")


def test_missing_onnx_names_its_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises((MissingExtra, ModuleNotFoundError)):
        write_onnx("station", tmp_path / "p.onnx")
