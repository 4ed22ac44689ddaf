"""A trained policy as plain NumPy: what the robot's host runs. No JAX, no MuJoCo.

    h_0 = o / scale,   h_l = f(W_l h_{l-1} + b_l),   a = tanh(W_L h_{L-1} + b_L) in [-1, 1]^3

A file is safetensors (w0, b0, w1, ...) with a JSON header: which robot of which structure, which observations, scale,
activation, memory, command path (policy_header.py), how it was trained. With memory m > 1 the input is the newest observation
followed by m - 1 pairs (action, observation) back in time; the policy keeps that window itself.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fishmj import policy_header
from fishmj.errors import ConfigError, StoreError, UnknownName
from fishmj.plain_file import trouble
from fishmj.policy_header import MOST, is_number, shown
from fishmj.store import read_tensors, write_tensors

SCHEMA = "fishmj.policy/1"
FOLDER = Path(__file__).resolve().parent / "policies"
OF_A_RUN = ("best.safetensors", "last.safetensors")  # what a training leaves, the better one first
_ACTIVATIONS: dict[str, Callable[[np.ndarray], np.ndarray]] = {"relu": lambda x: np.maximum(x, 0.0), "tanh": np.tanh}


def shipped() -> list[str]:
    """Names of the policies that come with fishmj."""
    return sorted(p.stem for p in FOLDER.glob("*.safetensors"))


def is_policy(text: "str | Path") -> bool:
    """Whether `text` names a policy: a shipped one, a file *.safetensors, or a folder, as of a training."""
    return str(text).endswith(".safetensors") or str(text) in shipped() or os.path.isdir(text)


def file_of(source: "str | Path") -> Path:
    """The file of a policy by path, by shipped name, or by the folder of a training: its best, else its last.

    Raises:
        UnknownName: no such file or name. StoreError: not a plain file, or a folder without a policy.
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
    if path.suffix == ".safetensors" and (why := trouble(path)).startswith("is "):
        raise StoreError(f"{path}: {why}")
    if path.is_file():
        return path
    if not named.is_file():
        raise UnknownName("policy", str(source), shipped())
    return named


@dataclass
class Policy:
    """weights: list of (W (out, in), b (out,)); meta: the file's header."""

    weights: list[tuple[np.ndarray, np.ndarray]]
    meta: dict
    _window: np.ndarray | None = field(default=None, repr=False)

    @classmethod
    def load(cls, source: "str | Path") -> "Policy":
        """Read a policy by shipped name or path, as `file_of`.

        Raises:
            UnknownName: no such file or name. StoreError: damaged file. ConfigError: not a policy, or shapes that do not fit.
        """
        path = file_of(source)
        arrays, meta = read_tensors(path)
        schema = meta.get("schema") if isinstance(meta, dict) else meta
        if schema != SCHEMA:
            raise ConfigError(f"{path}: schema {shown(schema)}, expected {SCHEMA!r}: this is not a policy file")
        layers = len(arrays) // 2
        if layers == 0 or set(arrays) != {f"{kind}{i}" for kind in "wb" for i in range(layers)}:
            raise ConfigError(f"{path}: holds {', '.join(sorted(arrays))[:200] or 'no arrays'}; expected w0, b0, w1, b1, ...")
        policy = cls([(arrays[f"w{i}"], arrays[f"b{i}"]) for i in range(layers)], meta)
        policy.check(str(path))
        return policy

    def save(self, path: "str | Path") -> Path:
        """Write the policy; atomic, checksummed."""
        self.check(str(path))
        arrays = {}
        for i, (w, b) in enumerate(self.weights):
            arrays[f"w{i}"], arrays[f"b{i}"] = np.asarray(w, np.float32), np.asarray(b, np.float32)
        return write_tensors(path, arrays, {**self.meta, "schema": SCHEMA})

    def check(self, where: str) -> None:
        """Shapes, scale, memory, activation and header fit together; otherwise one ConfigError."""
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
            raise ConfigError(f"{where}: weights are no floating-point numbers")
        width = self.n_obs * self.memory + (self.weights[-1][1].size if self.weights[-1][1].ndim == 1 else 0) * (self.memory - 1)
        for i, (w, b) in enumerate(self.weights):
            if w.ndim != 2 or w.shape[1] != width or b.shape != (w.shape[0],) or w.shape[0] == 0:
                raise ConfigError(f"{where}: layer {i} has weights {w.shape} and bias {b.shape}, expected {width} inputs")
            width = w.shape[0]
        if not all(np.isfinite(w).all() and np.isfinite(b).all() for w, b in self.weights):
            raise ConfigError(f"{where}: weights are not finite")
        policy_header.check(self.meta, where)

    @property
    def n_obs(self) -> int:
        return len(self.meta["scale"])

    @property
    def n_act(self) -> int:
        return self.weights[-1][1].shape[0]

    @property
    def memory(self) -> int:
        return self.meta.get("memory") or 1

    @property
    def _width(self) -> int:
        return self.n_obs * self.memory + self.n_act * (self.memory - 1)

    def reset(self, n: int = 1) -> None:
        """Forget the past of n fish."""
        self._window = None

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Actions (B, J) in [-1, 1] for observations (B, n_obs)."""
        obs = np.atleast_2d(np.asarray(obs, np.float32))
        if obs.shape[1] != self.n_obs:
            raise ConfigError(f"policy {self.meta.get('name', '')}: got {obs.shape[1]} observations, expected {self.n_obs}")
        sight = obs / np.asarray(self.meta["scale"], np.float32)
        x = seen = self._recall(sight)
        f = _ACTIVATIONS[self.meta["activation"]]
        for w, b in self.weights[:-1]:
            x = f(x @ w.T + b)
        w, b = self.weights[-1]
        action = np.tanh(x @ w.T + b)
        if not np.isfinite(action).all():
            raise ConfigError(
                f"policy {self.meta.get('name', '')}: its answer is not finite; the weights are too large, or obs is not"
            )
        if self.memory > 1:
            self._window = np.concatenate([action, seen], 1)
        return action

    def _recall(self, sight: np.ndarray) -> np.ndarray:
        """The network's input: what is seen now, then the window; at the start as if the fish had rested here."""
        if self.memory == 1:
            return sight
        if self._window is None or len(self._window) != len(sight):
            pair = np.concatenate([np.zeros((len(sight), self.n_act), np.float32), sight], 1)
            self._window = np.concatenate([pair] * (self.memory - 1), 1)
        return np.concatenate([sight, self._window], 1)[:, : self._width]
