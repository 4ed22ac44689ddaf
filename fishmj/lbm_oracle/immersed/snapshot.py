"""A coupled run at one instant: saved, and restored to the bit.

`save` and `restore` continue a run exactly (on the CPU to the bit; on a GPU the order of atomic additions differs from run to
run).
"""

from pathlib import Path

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.base.store import read_tensors, write_tensors
from fishmj.lbm_oracle.immersed.coupling import FluidStructure

SCHEMA = "fishmj.oracle-state/1"


def snapshot(coupled: FluidStructure) -> dict[str, np.ndarray]:
    """Complete state of a coupled run as arrays, without M, K and the markers, which follow from these."""
    body, data = coupled.body, coupled.body.data
    state = {f"fluid.{name}": np.asarray(value) for name, value in coupled.fluid.snapshot().items()}
    state |= {"qpos": data.qpos.copy(), "qvel": data.qvel.copy(), "ctrl": data.ctrl.copy(), "time": np.array(data.time)}
    state |= {"momentum": body.momentum.copy(), "slide": body.interior_speed.copy(), "applied": body.applied.copy()}
    state |= {"layers": body.layer_momentum.copy()} if body.layers.any() else {}
    coupling = {"gain": coupled.gain.copy(), "steps": np.array(coupled.steps), "wrench": coupled.boundary.wrench.numpy().copy()}
    return state | coupling


def resume(coupled: FluidStructure, state: dict[str, np.ndarray]) -> None:
    """Continues from a snapshot. Raises ConfigError: it belongs to another grid or another fish."""
    body, data = coupled.body, coupled.body.data
    for name, value in (("qpos", data.qpos), ("qvel", data.qvel), ("momentum", body.momentum), ("slide", body.interior_speed)):
        if state[name].shape != value.shape:
            raise ConfigError(f"oracle state: {name} has shape {state[name].shape}, this fish needs {value.shape}")
    # the water first: `place` does not read it, and a grid that does not fit must leave the body unchanged
    coupled.fluid.restore({name.removeprefix("fluid."): value for name, value in state.items() if name.startswith("fluid.")})
    data.time = float(state["time"])
    data.ctrl[:], body.applied[:] = state["ctrl"], state["applied"]
    body.place(state["qpos"], state["qvel"], state["slide"])
    # after `place`, which derives the interior water's momentum from the pose as if nothing had accelerated: the gain lags a step
    body.momentum[:] = state["momentum"]
    if "layers" in state:
        body.layer_momentum[:] = state["layers"]
    coupled.gain = state["gain"].copy()
    coupled.steps = int(state["steps"])
    coupled.boundary.wrench.assign(state["wrench"])


def save(path: str | Path, coupled: FluidStructure, **notes) -> Path:
    """Writes a snapshot as one file with its own checksum (safetensors, no pickle)."""
    lattice = coupled.fluid.lattice
    meta = {"schema": SCHEMA, "dx": lattice.dx, "dt": lattice.dt, "shape": list(coupled.fluid.extent), **notes}
    return write_tensors(path, snapshot(coupled), meta)


def load(path: str | Path, coupled: FluidStructure) -> dict:
    """Continues a coupled run from a file; returns its notes.

    Raises ConfigError: another schema, grid or fish; StoreError: the file is damaged.
    """
    state, meta = read_tensors(path)
    lattice, shape = coupled.fluid.lattice, list(coupled.fluid.extent)
    if meta.get("schema") != SCHEMA:
        raise ConfigError(f"{path}: schema {meta.get('schema')!r}; expected {SCHEMA!r}")
    if (meta["dx"], meta["dt"], meta["shape"]) != (lattice.dx, lattice.dt, shape):
        got = f"dx {meta['dx']} m, dt {meta['dt']} s, {meta['shape']} cells"
        raise ConfigError(f"{path}: a state of {got} does not fit {lattice.dx} m, {lattice.dt} s, {shape}; use its grid")
    resume(coupled, state)
    return meta
