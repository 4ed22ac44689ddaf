"""The flow solver as a generator of logs: the immersed fish on the second robot's servos, radio and camera; hidden effects.

    from fishmj.campaign.hidden_lbm.hidden import generate_lbm
    trials = generate_lbm({"command_latency": {"delay": 0.04}}, ["gait", "steps", "tow_ahead"], seed=7)

Actuator, timing and measurement effects are the second robot's own code; masses are the immersed body's; a steady current is the
solver's; other effects of the water are the force that they make in the second robot's water, added to the solver's. One seed
is one robot (servo, radio, masses, slip) and one noise, whatever is planted. Nothing in a trial says what that is.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np

from fishmj import excitation
from fishmj.campaign.data.run_segments import DOUBT
from fishmj.campaign.hidden_lbm.hidden_run import CARRY, PASSES, WIDTH, HiddenRun, Job
from fishmj.errors import ConfigError, OracleUnstable
from fishmj.excitation import PERIOD, Excitation
from fishmj.lbm_oracle.run.domain import PREVIEWS, Domain, preset
from fishmj.lbm_oracle.run.run import ConcurrentRuns
from fishmj.log import SCHEMA, Trial, numbered
from fishmj.source import made_by
from fishmj.virtual_robot import random_streams, sensors
from fishmj.virtual_robot.trials import SENSORS, Effects, plant, sense, sigmas

SLIPPERY = 0.02  # at nuisance 0.1 the slip ratio is 1 to 0.998 of what is asked for: 15 % of the speed at s = 1
HEAVY = 0.2  # of the nuisance: nobody weighs a fish to a tenth
SHORTEST = 1.0  # s; less of an experiment is no trial
CLOCKS = {"cmd": "host, sending", "joint": "host, reading", "pose": "camera, frame received", "power": "host, reading"}


def generate_lbm(
    effects: Effects,
    excitations: Iterable[str | Excitation],
    seed: int,
    noise: float = 1.0,
    nuisance: float = 0.1,
    domain: "str | Domain" = "laptop",
    device: str = "cpu",
    slip: float = 1.0,
    *,
    flow: tuple[float, float] = (0.0, 0.0),
    tanks: int = 1,
    say: Callable[[str], None] = lambda text: None,
) -> list[Trial]:
    """One trial an excitation, in order; a repeated one is a replicate with its own noise.

    Args:
        effects, noise, flow: as `virtual_robot.generate`. nuisance: relative half width of the servo's and radio's constants; a
            fifth of it that of the masses, and slip is drawn between `slip` and (1 - 0.02 nuisance) `slip`.
        domain: box of water, or its name; "laptop" is a preview. slip: ratio of the hull. tanks: experiments side by side.

    Raises:
        UnknownName, ConfigError: as `virtual_robot.generate`; no such domain. OracleUnstable: an experiment could not be set up,
        or less than a second of it was sound.
    """
    waiting = jobs(effects, excitations, seed, noise, nuisance, domain, slip, flow=flow)
    order = [job.name for job in waiting]
    made: dict[str, Trial] = {}
    for run in swum(waiting, device, tanks):
        made[run.job.name] = trial = trial_of(run)
        say(f"{trial.name}: {trial.span[1]:.1f} s")
    return [made[name] for name in order]


def jobs(
    effects: Effects,
    excitations: Iterable[str | Excitation],
    seed: int,
    noise: float = 1.0,
    nuisance: float = 0.1,
    domain: "str | Domain" = "laptop",
    slip: float = 1.0,
    *,
    flow: tuple[float, float] = (0.0, 0.0),
) -> list[Job]:
    """The experiments of one robot, not yet run; arguments as `generate_lbm`."""
    box = preset(domain) if isinstance(domain, str) else domain
    if not 0.0 <= slip <= 1.0:
        raise ConfigError(f"slip = {slip}; a ratio from 0, water that sticks to the hull, to 1, water that slides along it")
    made = plant(effects, seed, nuisance=nuisance)
    speed, direction = flow
    made = made.with_fields({"tank.flow_x": speed * np.cos(direction), "tank.flow_y": speed * np.sin(direction)})
    rng = random_streams.stream(seed, "immersed")
    heavier, smooth = 1.0 + HEAVY * nuisance * rng.uniform(-1, 1), slip * (1.0 - SLIPPERY * nuisance * rng.uniform(0, 1))
    out: list[Job] = []
    first: dict[str, str] = {}
    for index, item in enumerate(excitations):
        what = excitation.get(item) if isinstance(item, str) else item
        name = f"{index + 1:02d}_{what.id}"
        job = Job(made=made, what=what, seed=seed, index=index, name=name, noise=noise, slip=smooth, domain=box)
        out.append(replace(job, replicate_of=first.get(what.id, ""), heavier=heavier, flow=flow))
        first.setdefault(what.id, name)
    return out


def swum(waiting: Iterable[Job], device: str = "cpu", tanks: int = 1) -> Iterator[HiddenRun]:
    """Run jobs, `tanks` side by side; they come back as they finish, or stop."""
    queue: deque[Job] = deque(waiting)
    busy: list[HiddenRun] = []
    while queue or busy:
        while queue and len(busy) < tanks:
            busy.append(HiddenRun(queue.popleft(), device))
        ConcurrentRuns(busy).tick(np.zeros((len(busy), 3)))
        for run in [run for run in busy if run.done]:
            busy.remove(run)
            yield run


def trial_of(run: HiddenRun) -> Trial:
    """What the sensors made of a finished run; a run that failed is kept as far as it was sound.

    Raises:
        OracleUnstable: less than a second of it was.
    """
    job, made, what = run.job, run.job.made, run.job.what
    record, ticks = run.recording(), run.ticks
    if run.stopped and not run.stopped.startswith("left_domain"):
        ticks = max(0, ticks - round(DOUBT / PERIOD))
        rows = round(ticks * PERIOD * 1000)
        record = record._replace(t=record.t[:rows], data=record.data[:rows])
    if ticks * PERIOD < SHORTEST:
        raise OracleUnstable(
            f"{job.name}: {ticks * PERIOD:.2f} s were sound; {run.stopped}. Another seed or a finer grid may hold"
        )
    sent = what.t[:ticks]
    tables = {"cmd": {"t": sent, "seq": np.arange(ticks), **numbered("c#", what.commands[:ticks])}}
    streams = {name: random_streams.stream(job.seed, name, job.index) for name in SENSORS}
    tables |= sense(made, record, streams, (0.0, float(record.t[-1])), job.noise)
    tables["pose"] = sensors.on_its_clock(made.camera, sensors.track(made.camera, tables["pose"]))
    return Trial(_meta(run, tables), tables, name=job.name)


def _meta(run: HiddenRun, tables: dict) -> dict:
    job, box, what = run.job, run.job.domain, run.job.what
    grid = {"domain": box.name, "dx": box.dx, "dt": box.dt, "shape": list(box.shape), "kernel": WIDTH, "passes": PASSES}
    return {
        "schema": SCHEMA,
        "origin": "synthetic",
        "robot": job.made.robot.name,
        "medium": "water",
        "water": "lbm",
        "grid": grid | {"preview": box.name in PREVIEWS, "device": str(run.coupled.fluid.device)},
        "flow": {"speed": float(job.flow[0]), "direction": float(job.flow[1]), "known": True},
        "excitation": what.id,
        "replicate_of": job.replicate_of,
        "start": list(map(float, what.start)),
        "push": list(map(float, what.push)),
        "carried": CARRY if any(what.push) else 0.0,
        "sigma": sigmas(job.made, job.noise),
        "clock": {table: CLOCKS[table] for table in tables},
        "controller": "open loop",
        "refined_ticks": run.refined,
        "stopped": " ".join(run.stopped.split()),
        **made_by("numpy"),
        "source": "fishmj.campaign.hidden_lbm.hidden",
        "licence": "Apache-2.0",
        "notes": "simulated: immersed fish, electronics of the second robot; what is hidden in it is kept elsewhere",
    }
