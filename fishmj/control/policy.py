"""Trained policy in plain NumPy, so that the robot's host needs neither JAX nor MuJoCo.

    h_0 = o / scale,   h_l = f(W_l h_{l-1} + b_l),   a = tanh(W_L h_{L-1} + b_L) in [-1, 1]^3

    policy = Policy.of(env, [(W, b), ..], activation="tanh");  policy.save("mine.safetensors")
    policy = Policy.load("station");  actions = policy(observations)

A file is safetensors (w0, b0, w1, ...) with a JSON header (`control.policy_meta`): the robot and its structure, the observations,
scale, activation, memory, command path, and the training. With memory m > 1 the input is the newest observation followed by m - 1
pairs (action, observation) back in time. The policy keeps this window; `reset` clears it for fish that begin a new episode.
headers.json adds keys to the headers of the shipped files, whose bytes do not change.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base.errors import ConfigError, StoreError, UnknownName
from fishmj.base.plain_file import why_unreadable
from fishmj.base.store import read_json, read_tensors, write_tensors
from fishmj.control.policy_meta import MOST, check_header, is_number, shown

SCHEMA = "fishmj.policy/1"
FOLDER = Path(__file__).resolve().parent / "policies"
OF_A_RUN = ("best.safetensors", "last.safetensors")  # policies of a training's folder, the better one first
_ACTIVATIONS: dict[str, Callable[[np.ndarray], np.ndarray]] = {"relu": lambda x: np.maximum(x, 0.0), "tanh": np.tanh}
SHIPPED = {  # one line each, as `--help` lists them; docs/train/controllers.md has their figures
    "station-family": "PPO with a memory of 8 observations, trained in a family of waters, for robots without a fitted water",
    "station": "PPO, trained in the water fitted to the flow solver",
    "station-sac": "SAC with the paper's budget, trained in the same water",
    "station-sb3": "PPO of stable-baselines3, trained in the same water",
    "pilot": "PPO, trained in an earlier fit of that water; made data for the present fit",
    "paper": "PPO, trained in the structured water",
    "paper-sac": "SAC with the paper's budget, trained in the structured water",
}
BEST = "station-family"  # the best shipped policy in waters without a fit
ALSO = "headers.json"  # additional header keys of the shipped files


def shipped() -> list[str]:
    """Names of the policies that come with fishmj."""
    return sorted(p.stem for p in FOLDER.glob("*.safetensors"))


def is_policy(text: "str | Path") -> bool:
    """Returns True if `text` names a policy: a shipped one, a file *.safetensors, or a folder, such as that of a training."""
    return str(text).endswith(".safetensors") or str(text) in shipped() or os.path.isdir(text)


def file_of(source: "str | Path") -> Path:
    """File of a policy by path, shipped name, or folder of a training (its best, else its last policy).

    Raises UnknownName: no such name; StoreError: no such file, not a regular file, or a folder without a policy.
    """
    path, named = Path(source), FOLDER / f"{source}.safetensors"
    if os.path.isdir(source) and path.suffix != ".safetensors" and str(source) not in shipped():
        inside = [path / name for name in OF_A_RUN if (path / name).is_file()]
        deeper = [str(found.parent) for name in OF_A_RUN for found in sorted(path.glob(f"*/{name}"))]
        if not inside:
            also = f"; there is one in {', '.join(dict.fromkeys(deeper))}" if deeper else ""
            expected = f"expected a policy file or the folder of a training{also}"
            raise StoreError(f"{path}: a folder without {' or '.join(OF_A_RUN)}; {expected}")
        return inside[0]
    if path.suffix == ".safetensors" and (why := why_unreadable(path)).startswith("is "):
        raise StoreError(f"{path}: {why}")
    if path.is_file():
        return path
    if not named.is_file():
        if path.name != str(source) or path.suffix:
            expected = f"expected a policy file, the folder of a training, or one of {', '.join(shipped())}"
            raise StoreError(f"policy {source}: no such file or folder; {expected}")
        raise UnknownName("policy", str(source), shipped())
    return named


@dataclass
class Policy:
    """Network of a policy. weights: list of (W (out, in), b (out,)); meta: the file's header, which `of` writes."""

    weights: list[tuple[np.ndarray, np.ndarray]]
    meta: dict
    _window: np.ndarray | None = field(default=None, repr=False)
    _fresh: np.ndarray | None = field(default=None, repr=False)  # (B,) bool, fish that begin an episode

    def __post_init__(self):
        try:
            self.weights = [(np.asarray(w), np.asarray(b)) for w, b in self.weights]
        except (TypeError, ValueError) as error:
            raise ConfigError(
                "policy: wrong layers; expected pairs (weights (out, in), bias (out,)), one for each layer"
            ) from error
        if hasattr(scale := self.meta.get("scale"), "tolist"):  # NumPy's and JAX's arrays
            self.meta = {**self.meta, "scale": scale.tolist()}

    @classmethod
    def of(
        cls, env: Any, layers: Any, *, activation: str = "tanh", scale: Any = None, memory: int | None = None, hide: Any = None,
        **meta: Any,
    ) -> "Policy":  # fmt: skip
        """Makes the policy of a network that was trained in `env`: action = tanh(MLP(observation / scale)).

        The header takes robot, water, control step and command path from the environment.

        Args:
            env: environment of fishmj (JAX, Gymnasium, dm_control, stable-baselines3), or a `Robot` in its water.
            layers: (weights (out, in), bias (out,)) of each layer, as in PyTorch; transpose JAX's (in, out).
            activation: of the hidden layers, tanh or relu.
            scale: (5 + 2 J,) divisors of one observation; None: `input_scale` of the environments.
            memory: observations that the network sees; None: as many as the environment stacks.
            hide: observation groups that were zero in training; None: those of the environment.
            meta: more keys of the header, such as algorithm, seed, steps.

        Raises ConfigError: the layers do not fit the robot and the memory, or `env` is no environment of fishmj.
        """
        from fishmj.control.learned import header_of, robot_in  # not on the robot's host
        from fishmj.tasks.station_hold import input_scale, visible

        robot, given = robot_in(env), getattr(env, "options", env)
        memory = getattr(given, "memory", 1) if memory is None else memory
        seen = visible(robot.n_joints, getattr(given, "hide", ()) if hide is None else hide)
        divisors = np.asarray(input_scale(robot.n_joints) if scale is None else scale)
        if divisors.shape != (len(seen),):
            raise ConfigError(f"Policy.of: scale of shape {divisors.shape}; expected ({len(seen)},), divisors of one observation")
        header = {**header_of(robot), "scale": divisors, "activation": activation, "memory": memory}
        policy = cls(layers, {**header, **meta})
        policy.check("Policy.of")
        if policy.n_act != robot.n_joints:
            raise ConfigError(f"Policy.of: the last layer gives {policy.n_act}; robot {robot.name} has {robot.n_joints} joints")
        policy.weights = [(np.asarray(w, np.float32), np.asarray(b, np.float32)) for w, b in policy.weights]
        (first, bias), *rest = policy.weights
        seen = seen + ([True] * robot.n_joints + seen) * (memory - 1)
        policy.weights = [(first * np.asarray(seen, np.float32), bias), *rest]  # observations hidden in training stay hidden
        return policy

    @classmethod
    def load(cls, source: "str | Path") -> "Policy":
        """Reads a policy by shipped name or path, as `file_of`.

        Raises UnknownName: no such file or name; StoreError: damaged file; ConfigError: not a policy, or shapes that do not fit.
        """
        path = file_of(source)
        arrays, meta = read_tensors(path)
        schema = meta.get("schema") if isinstance(meta, dict) else meta
        if schema != SCHEMA:
            raise ConfigError(f"{path}: schema {shown(schema)}, expected {SCHEMA!r}: this is not a policy file")
        if path.resolve().parent == FOLDER:
            meta = meta | read_json(FOLDER / ALSO).get(path.stem, {})
        layers = len(arrays) // 2
        if layers == 0 or set(arrays) != {f"{kind}{i}" for kind in "wb" for i in range(layers)}:
            raise ConfigError(f"{path}: holds {', '.join(sorted(arrays))[:200] or 'no arrays'}; expected w0, b0, w1, b1, ...")
        policy = cls([(arrays[f"w{i}"], arrays[f"b{i}"]) for i in range(layers)], meta)
        policy.check(str(path))
        return policy

    def save(self, path: "str | Path") -> Path:
        """Writes the policy, atomically and with a checksum."""
        self.check(str(path))
        arrays = {}
        for i, (w, b) in enumerate(self.weights):
            arrays[f"w{i}"], arrays[f"b{i}"] = np.asarray(w, np.float32), np.asarray(b, np.float32)
        return write_tensors(path, arrays, {**self.meta, "schema": SCHEMA})

    def check(self, where: str) -> None:
        """Checks that shapes, scale, memory, activation and header fit together; raises one ConfigError."""
        if lacking := [key for key in ("activation", "scale") if self.meta.get(key) is None]:
            raise ConfigError(f"{where}: the header lacks {' and '.join(lacking)}; Policy.of(env, layers) writes a complete one")
        scale, memory, activation = (self.meta.get(k) for k in ("scale", "memory", "activation"))
        if not (isinstance(activation, str) and activation in _ACTIVATIONS):
            raise ConfigError(f"{where}: activation {shown(activation)}; known: {', '.join(_ACTIVATIONS)}")
        if not (isinstance(scale, list) and 0 < len(scale) <= MOST and all(is_number(s) and 1e-30 < s < 1e30 for s in scale)):
            raise ConfigError(f"{where}: scale {shown(scale)}; expected one positive divisor for each observation")
        if not (memory is None or (isinstance(memory, int) and not isinstance(memory, bool) and 1 <= memory <= MOST)):
            raise ConfigError(
                f"{where}: memory {shown(memory)}; expected the number of observations that the policy sees, 1 to {MOST}"
            )
        if not self.weights:
            raise ConfigError(f"{where}: holds no layers")
        if not all(a.dtype.kind == "f" for layer in self.weights for a in layer):
            raise ConfigError(f"{where}: weights are not floating-point numbers")
        width = self.n_obs * self.memory + (self.weights[-1][1].size if self.weights[-1][1].ndim == 1 else 0) * (self.memory - 1)
        for i, (w, b) in enumerate(self.weights):
            if w.ndim != 2 or w.shape[1] != width or b.shape != (w.shape[0],) or w.shape[0] == 0:
                turned = w.ndim == 2 and (w.shape[0], b.shape) == (width, w.shape[1:])
                todo = ": got (in, out), expected (out, in); transpose them" if turned else f", expected {width} inputs"
                raise ConfigError(f"{where}: layer {i} has weights {w.shape} and bias {b.shape}{todo}")
            width = w.shape[0]
        if not all(np.isfinite(w).all() and np.isfinite(b).all() for w, b in self.weights):
            raise ConfigError(f"{where}: weights are not finite")
        check_header(self.meta, where)

    @property
    def n_obs(self) -> int:
        """Number of observations."""
        return len(self.meta["scale"])

    @property
    def n_act(self) -> int:
        """Number of actions, one for each joint."""
        return self.weights[-1][1].shape[0]

    @property
    def memory(self) -> int:
        """Number of observations in the input, 1 without memory."""
        return self.meta.get("memory") or 1

    def reset(self, rows: Any = None) -> None:
        """Clears the memory of the fish `rows` (B,) bool, by default all: their next observation is the first of an episode.

        A number of fish also means all. Raises ConfigError for other rows.
        """
        if rows is None or np.ndim(rows) == 0 or self._window is None:
            self._window = self._fresh = None
            return
        rows = np.asarray(rows)
        if rows.shape != (len(self._window),) or rows.dtype != bool:
            expected = f"({len(self._window)},) bool, True for a fish that begins an episode"
            raise ConfigError(f"policy: reset of rows {rows.shape}, {rows.dtype}; expected {expected}")
        self._fresh = rows if self._fresh is None else rows | self._fresh

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Actions (B, J) in [-1, 1] for observations (B, n_obs); sums in double precision, as in firmware and ONNX."""
        seen = self.inputs(obs)
        x = seen.astype(np.float64)
        f = _ACTIVATIONS[self.meta["activation"]]
        for w, b in self.weights[:-1]:
            x = f(x @ w.T + b)
        w, b = self.weights[-1]
        action = np.tanh(x @ w.T + b).astype(np.float32)
        if not np.isfinite(action).all():
            raise ConfigError(
                f"policy {self.meta.get('name', '')}: its action is not finite; the weights are too large, or obs is not finite"
            )
        if self.memory > 1:
            self._window, self._fresh = np.concatenate([action, seen], 1), None
        return action

    def inputs(self, obs: np.ndarray) -> np.ndarray:
        """Inputs of the network (B, width) for observations (B, n_obs): scaled, followed by the memory. Raises ConfigError."""
        obs = np.atleast_2d(np.asarray(obs, np.float32))
        if obs.shape[1] != self.n_obs:
            raise ConfigError(f"policy {self.meta.get('name', '')}: got {obs.shape[1]} observations, expected {self.n_obs}")
        return self._recall(obs / np.asarray(self.meta["scale"], np.float32))

    def jacobian(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Actions (B, J) for inputs of the network (B, width), and their derivatives (B, J, width)."""
        layers = [np.asarray(inputs)]
        f = _ACTIVATIONS[self.meta["activation"]]
        slope = (lambda y: y > 0.0) if self.meta["activation"] == "relu" else (lambda y: 1.0 - y * y)  # of the unit's output y
        for w, b in self.weights[:-1]:
            layers.append(f(layers[-1] @ w.T + b))
        w, b = self.weights[-1]
        action = np.tanh(layers[-1] @ w.T + b)
        back = (1 - action**2)[:, :, None] * w
        for (w, _), out in zip(self.weights[-2::-1], layers[:0:-1], strict=True):
            back = (back * slope(out)[:, None]) @ w
        return action, back

    def _recall(self, sight: np.ndarray) -> np.ndarray:
        """Input of the network: the observation, then the window; an episode starts as if the fish had rested at its start."""
        if self.memory == 1:
            return sight
        width = self.n_obs * self.memory + self.n_act * (self.memory - 1)
        past = None if self._window is None or len(self._window) != len(sight) else self._window[:, : width - self.n_obs]
        if past is None or self._fresh is not None:
            pair = np.concatenate([np.zeros((len(sight), self.n_act), np.float32), sight], 1)
            rest = np.concatenate([pair] * (self.memory - 1), 1)
            past = rest if past is None or self._fresh is None else np.where(self._fresh[:, None], rest, past)
        return np.concatenate([sight, past], 1)
