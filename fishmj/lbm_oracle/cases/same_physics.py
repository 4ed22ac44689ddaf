"""Two backends, one physics: 200 steps of a free fish in a turbulent stream, compared with the shipped state.

The state was made on a CPU. It uses all parts of a free swim: open faces, sponge, turbulent inflow, eddy viscosity, markers with
partial slip, the coupled solve, the servos. A backend that computes the same differs only by the growth of round-off in 200
steps. One that leaves out a term, or uses a slightly different number, differs by more (both figures: studies/solver/NOTES.md).

python -m fishmj.lbm_oracle cases same_physics --device cuda
python -m fishmj.lbm_oracle.cases.same_physics --why "markers are drawn in by another length"      makes it anew, on the CPU
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from fishmj.base import console
from fishmj.base.calib import calib_folder
from fishmj.base.errors import ConfigError, StoreError
from fishmj.base.store import Manifest, read_tensors, write_tensors
from fishmj.lbm_oracle.cases import Check, below, register, reported
from fishmj.lbm_oracle.run.domain import Domain
from fishmj.lbm_oracle.run.run import Run
from fishmj.lbm_oracle.run.setup import Gait, SwimSetup
from fishmj.water.flow import Flow

SCHEMA, NAME, STEPS = "fishmj.same-physics/1", "same_physics.safetensors", 200
DOMAIN = Domain(name="same physics", shape=(52, 36, 24), dx=0.02, dt=0.004, sponge=5)
FLOW = Flow(speed=0.2, direction=2.9, turbulence="default", intensity=0.1, seed=7)
SLIP = 0.98  # between 0 and 1, so that both parts of the forcing work
# of the greatest value: rounding every population at every step anew moves the velocity by 2e-6, the pressure by 1e-5
TOLERANCE = 1e-3


def folder() -> Path:
    """Folder of the shipped state (checkout or wheel)."""
    return calib_folder().parent / "oracle"


def run(device: str, **options) -> Run:
    """Run of the swim, at its end; options change the set-up."""
    stage = replace(SwimSetup(domain=DOMAIN, flow=FLOW, slip=SLIP, pose=(0.02, -0.02, 0.15), device=device), **options)
    made, gait = stage.run(latency=0.0), Gait(ramp=0.2)
    while made.coupled.steps < STEPS:
        made.tick(gait(made.time))
    return made


def fields(made: Run) -> dict[str, np.ndarray]:
    """Velocity (nx, ny, nz, 3) m/s and pressure (nx, ny, nz) Pa as float32; qpos, qvel; wrenches (L, 6) of the last tick."""
    coupled = made.coupled
    with coupled.scope():
        water = {"velocity": coupled.fluid.velocity(), "pressure": coupled.fluid.pressure()}
    data = coupled.body.data
    solid = {"qpos": data.qpos.copy(), "qvel": data.qvel.copy(), "wrench": made.rows[-1][-1]}
    return {name: value.astype(np.float32) for name, value in water.items()} | solid


def difference(got: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> dict[str, float]:
    """Greatest difference of each array, divided by its greatest value."""
    return {
        name: float(np.abs(np.asarray(got[name], float) - value).max() / np.abs(value).max()) for name, value in expected.items()
    }


def shipped() -> dict[str, np.ndarray]:
    """Shipped state. Raises StoreError: missing, or not as its manifest says; ConfigError: made for another set-up."""
    Manifest.read(folder()).verify(folder())
    arrays, meta = read_tensors(folder() / NAME)
    if (meta.get("schema"), meta.get("set_up")) != (SCHEMA, set_up()):
        raise ConfigError(f"{folder() / NAME}: made for {meta.get('set_up')}, this build runs {set_up()}; {REMAKE}")
    return arrays


REMAKE = "make it again: python -m fishmj.lbm_oracle.cases.same_physics --why REASON"


def set_up() -> str:
    """Description of the state's set-up, which changes with it."""
    shape = " x ".join(map(str, DOMAIN.shape))
    return f"{STEPS} steps, {shape}, dx {DOMAIN.dx} m, dt {DOMAIN.dt} s, slip {SLIP}, {FLOW.speed} m/s, seed {FLOW.seed}"


@register("same_physics", rung=0, quick=True, grid="52 x 36 x 24, dx = 2 cm, 200 steps", source="this solver on a CPU, shipped")
def same_physics(device):
    """A free fish in a turbulent stream, against the shipped state of the CPU."""
    expected, made = shipped(), run(device)
    yield from checks(difference(fields(made), expected))
    yield reported("greatest speed of the water, m/s", np.linalg.norm(expected["velocity"], axis=-1).max())


def checks(off: dict[str, float]) -> list[Check]:
    """Checks, one for each array."""
    return [below(f"{name} off the shipped one, relative", value, TOLERANCE) for name, value in off.items()]


def write(why: str, where: Path | None = None) -> Path:
    """Computes the state on the CPU and ships it with the reason and its manifest. Raises ConfigError: no reason."""
    if not why.strip():
        raise ConfigError("same_physics: --why is empty; say what changed the physics, it is kept beside the state")
    where = folder() if where is None else where
    try:
        before = shipped() if where == folder() else {}
    except (StoreError, ConfigError):
        before = {}
    arrays = fields(run("cpu"))
    for name, value in (difference(arrays, before) if before else {}).items():
        console.say(f"{name}: changed by {value:.2g} of its greatest value")
    path = write_tensors(where / NAME, arrays, {"schema": SCHEMA, "set_up": set_up(), "why": why, "origin": "synthetic"})
    Manifest.of(where, {"why": why, "made_by": "python -m fishmj.lbm_oracle.cases.same_physics"}).write(where)
    return path


def main(argv: list[str]) -> int:
    """Computes the shipped state anew and writes it; returns the exit code."""
    parser = console.parser("lbm_oracle.cases.same_physics", "Compute the shipped state anew, on the CPU.")
    parser.add_argument("--why", required=True, metavar="REASON", help="what changed the physics")
    args = parser.parse_args(argv)
    path = write(args.why)
    console.say(f"wrote {path} ({path.stat().st_size / 1e6:.2f} MB)")
    if args.json:
        console.emit_json({"path": path, "bytes": path.stat().st_size})
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
