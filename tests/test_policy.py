"""The NumPy policy: files that come back as they were, wrong ones refused in one line, and nothing heavy behind it."""

import json
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from fishmj import control
from fishmj.base.errors import ConfigError, StoreError, UnknownName
from fishmj.base.store import read_tensors, write_tensors
from fishmj.control.policy import FOLDER, SCHEMA, Policy, shipped

SCALE = [1.0, 1.0, 0.3, 0.3, 1.5, 0.7, 0.7, 0.7, 4.0, 4.0, 4.0]


def policy(activation="relu", memory=1, hidden=(8, 6), seed=0) -> Policy:
    """Random weights of order one."""
    rng = np.random.default_rng(seed)
    sizes = [11 * memory + 3 * (memory - 1), *hidden, 3]
    layers = [
        (rng.normal(size=(b, a)).astype(np.float32) / np.float32(a**0.5), rng.normal(size=b).astype(np.float32))
        for a, b in zip(sizes[:-1], sizes[1:], strict=True)
    ]
    return Policy(layers, {"scale": SCALE, "activation": activation, "memory": memory, "robot": "fish"})


def by_hand(p: Policy, x) -> np.ndarray:
    """The formula of the module, one row, one layer, one neuron at a time."""
    f = (lambda v: max(v, 0.0)) if p.meta["activation"] == "relu" else np.tanh
    for w, b in p.weights[:-1]:
        x = [f(sum(float(c) * v for c, v in zip(row, x, strict=True)) + float(e)) for row, e in zip(w, b, strict=True)]
    w, b = p.weights[-1]
    return np.array([np.tanh(float(row @ np.array(x)) + float(e)) for row, e in zip(w, b, strict=True)])


@pytest.mark.parametrize("activation", ["relu", "tanh"])
def test_actions_are_the_formula(activation):
    p, obs = policy(activation), np.random.default_rng(1).normal(size=(5, 11))
    for row, action in zip(obs, p(obs), strict=True):
        np.testing.assert_allclose(action, by_hand(p, row / SCALE), atol=1e-6)
    assert np.abs(p(100 * obs)).max() <= 1


def test_policy_memory_orders_action_observation_pairs_newest_first():
    p, obs = policy(memory=3), np.random.default_rng(2).normal(size=(6, 11))
    past = [(np.zeros(3), obs[0] / SCALE)] * 2  # before the start: at rest, and the first sight
    for row in obs:
        x = np.concatenate([row / SCALE, *(np.concatenate(pair) for pair in past)])
        action = p(row)[0]
        np.testing.assert_allclose(action, by_hand(p, x), atol=1e-6)
        past = [(action, row / SCALE), past[0]]
    later = p(obs[0])
    p.reset()
    first = p(obs[0])
    assert not np.array_equal(first, later)
    p.reset()
    np.testing.assert_array_equal(p(obs[0]), first)


@pytest.mark.parametrize("memory", [1, 4])
def test_a_batch_is_its_rows_one_by_one(memory):
    many, obs = policy(memory=memory), np.random.default_rng(3).normal(size=(7, 4, 11))
    singles = [policy(memory=memory) for _ in range(4)]
    for step in obs:
        rows = np.concatenate([one(row) for one, row in zip(singles, step, strict=True)])
        np.testing.assert_allclose(many(step), rows, atol=1e-6)


def test_a_saved_policy_comes_back_as_it_was(tmp_path):
    p = policy(memory=2)
    path = p.save(tmp_path / "p.safetensors")
    back = Policy.load(path)
    assert back.meta == {**p.meta, "schema": SCHEMA} and len(back.weights) == 3
    for ours, theirs in zip(p.weights, back.weights, strict=True):
        np.testing.assert_array_equal(ours[0], theirs[0])
        np.testing.assert_array_equal(ours[1], theirs[1])
    obs = np.random.default_rng(4).normal(size=(3, 11))
    np.testing.assert_array_equal(p(obs), back(obs))
    again = Policy.load(back.save(tmp_path / "q.safetensors"))
    assert again.meta == back.meta and np.array_equal(again.weights[0][0], p.weights[0][0])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda a, m: a.update(w1=a["w1"].T.copy()), r"layer 1 has weights \(8, 6\) and bias \(6,\): got \(in, out\), exp"),
        (lambda a, m: a.update(b0=a["b0"][:-1]), r"layer 0 has weights \(8, 11\) and bias \(7,\)"),
        (lambda a, m: a.update(w0=a["w0"][:, :-1]), "expected 11 inputs"),
        (lambda a, m: a.pop("b1"), "expected w0, b0, w1, b1"),
        (lambda a, m: a.clear(), "holds no arrays"),
        (lambda a, m: a["w2"].__setitem__((0, 0), np.nan), "weights are not finite"),
        (lambda a, m: a["b0"].__setitem__(0, np.inf), "weights are not finite"),
        (lambda a, m: m.update(schema="fishmj.policy/9"), "schema 'fishmj.policy/9', expected 'fishmj.policy/1'"),
        (lambda a, m: m.pop("schema"), "schema None, expected"),
        (lambda a, m: m.update(activation="gelu"), "activation 'gelu'; known: relu, tanh"),
        (lambda a, m: m.pop("scale"), "the header lacks scale; Policy.of"),
        (lambda a, m: m.update(scale=[0.0] * 11), "expected one positive divisor"),
        (lambda a, m: m.update(memory=0), "memory 0; expected the number"),
        (lambda a, m: m.update(memory=2), "expected 25 inputs"),
    ],
)
def test_a_file_that_does_not_fit_is_one_clear_error(change, said, tmp_path):
    arrays, meta = read_tensors(policy().save(tmp_path / "good.safetensors"))
    arrays = {k: v.copy() for k, v in arrays.items()}
    change(arrays, meta)
    path = write_tensors(tmp_path / "bad.safetensors", arrays, meta)
    with pytest.raises(ConfigError, match=said) as caught:
        Policy.load(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_what_cannot_be_right_is_not_saved_either(tmp_path):
    p = policy()
    p.weights[1][0][2, 3] = np.nan
    with pytest.raises(ConfigError, match="weights are not finite"):
        p.save(tmp_path / "p.safetensors")
    assert not list(tmp_path.iterdir())


def test_damage_is_found_before_anything_is_loaded(tmp_path):
    path = policy().save(tmp_path / "p.safetensors")
    raw = bytearray(path.read_bytes())
    raw[-40] ^= 1
    path.write_bytes(bytes(raw))
    with pytest.raises(StoreError, match="sha256 mismatch"):
        Policy.load(path)


def test_a_pickled_policy_is_refused_and_never_run(tmp_path):
    path = tmp_path / "p.safetensors"
    with zipfile.ZipFile(path, "w") as archive:  # what torch.save writes; io.open("SPRUNG", "w") when opened
        archive.writestr("archive/data.pkl", b"\x80\x02cio\nopen\nX\x06\x00\x00\x00SPRUNGX\x01\x00\x00\x00w\x86R.")
    with pytest.raises(StoreError, match="pickled objects"):
        Policy.load(path)
    assert not (tmp_path / "SPRUNG").exists()


def test_an_unknown_name_lists_the_shipped_ones():
    assert shipped() == sorted(p.stem for p in FOLDER.glob("*.safetensors"))
    near = shipped()[0][:-1] if shipped() else "papr"
    with pytest.raises(UnknownName, match=f"unknown policy '{near}'"):
        Policy.load(near)


@pytest.mark.parametrize("source", ["runs/nope", "nope.safetensors"])
def test_a_path_without_a_policy_is_no_unknown_name(source):
    for load in (Policy.load, control.chosen):
        with pytest.raises(StoreError, match=f"policy {source}: no such file or folder; expected a policy file, the folder of"):
            load(source)


@pytest.mark.parametrize("name", shipped())
def test_shipped_policies_load_and_act(name):
    p = Policy.load(name)
    obs = np.random.default_rng(0).normal(size=(16, p.n_obs)) * p.meta["scale"]
    assert p(obs).shape == (16, 3) and np.isfinite(p(obs)).all() and p(obs).std() > 0.1
    assert {"robot", "observation", "action", "command_path", "algorithm", "seed", "steps", "task"} <= p.meta.keys()
    assert p.meta["origin"] == "synthetic"  # trained in simulation only


def test_the_number_of_observations_must_fit():
    with pytest.raises(ConfigError, match="got 12 observations, expected 11"):
        policy()(np.zeros((2, 12)))


def test_running_a_policy_loads_numpy_and_safetensors_only(tmp_path):
    """The robot's host has no simulator: the import and an action need nothing else."""
    path = policy().save(tmp_path / "p.safetensors")
    code = (
        "import sys, json; before = set(sys.modules)\n"
        "from fishmj.control.policy import Policy; import numpy as np\n"
        f"action = Policy.load({str(path)!r})(np.zeros((1, 11)))\n"
        "print(json.dumps(sorted({m.split('.')[0] for m in set(sys.modules) - before})))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {m for m in json.loads(done.stdout) if not m.startswith("_")} - set(sys.stdlib_module_names)
    assert loaded <= {"fishmj", "numpy", "safetensors", "packaging"}
