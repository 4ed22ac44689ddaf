"""Code of your own, one of each kind; docs/simulate/your_own_code.md walks through it and a test runs it.

fishmj evaluate examples/own_code.py:Chase pd --speeds 0.2 --repeats 1
fishmj train --task examples/own_code.py:LineFollow --algo examples/own_code.py:Evolution
fishmj gap find DATA --effects examples/own_code.py:WEED
python -m fishmj.log import RECORDING.csv --out DATA --format examples/own_code.py:read
"""

# controller
import numpy as np


class Chase:
    """A travelling wave of 1 Hz whose bias points the fish at its target."""

    name = "chase"

    def __init__(self, robot):
        self.joints, self.dt = robot.n_joints, robot.timing.bus_dt
        self.ticks = round(robot.timing.control_dt / self.dt)

    def reset(self, n):
        self.time = 0.0

    def __call__(self, obs):
        t = self.time + self.dt * np.arange(1, self.ticks + 1)
        self.time = t[-1]
        wave = np.sin(2 * np.pi * t[:, None] - np.radians(60) * np.arange(self.joints))  # (T, J)
        sight = np.arctan2(obs[:, 1], obs[:, 0])  # (B,) rad, positive to the left
        return 0.4 * wave - 0.15 * np.clip(sight, -1, 1)[:, None, None]  # (B, T, J) rad


# task
from dataclasses import dataclass

from fishmj.tasks.reference import EpisodeStart
from fishmj.tasks.station_hold import draw_start


@dataclass(frozen=True, kw_only=True)
class LineFollow:
    """Swim along the line y = 0 behind a point that moves at `speed`; paid for progress, fined for metres off the line."""

    speed: float = 0.08  # m/s
    seconds: float = 10.0

    def launch(self, xp, uniforms):
        start, zero = draw_start(xp, uniforms), 0.0 * uniforms[:, 0]
        pose = xp.stack([zero - 0.8, 0.4 * uniforms[:, 1] - 0.2, zero], -1)  # beside the line's beginning, facing along it
        return EpisodeStart(start._replace(pose=pose, target=xp.stack([zero - 0.8, zero], -1), speed=0.5 * start.speed), zero)

    def target(self, xp, launch, t):
        return xp.stack([self.speed * t - 0.8, 0.0 * t], -1)

    def reward(self, xp, step):
        progress = step.trace.velocity[..., 0].mean(-1) / self.speed
        return xp.minimum(progress, 1.0) - 2.0 * xp.abs(step.trace.pose[:, -1, 1])


# effect
from fishmj.effects import Effect, Parameter


def dragged(xp, p, body, memory, h):
    drag = p.drag * (1.0 + body.time / 600.0)  # twice as much after ten minutes
    return body._replace(fx=body.fx - body.wet * drag * body.u * xp.abs(body.u)), memory


WEED = Effect(
    name="weed",
    stage="hydrodynamics",
    about="weed caught on the hull: drag that grows with the time in the water",
    formula="F = -c (1 + t / 600 s) u |u|",
    source="made up for this page",
    parameters=(Parameter(name="drag", unit="N s2/m2", low=0.0, high=20.0, typical=(0.5, 3.0)),),
    shows=("position", "power"),
    body=dragged,
)

# algorithm
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from fishmj.train.networks import forward, mlp


class Training(NamedTuple):
    """What a checkpoint keeps; `actor` is what is judged and written."""

    actor: Any
    env: Any
    key: Any


class Evolution:
    """Evolution strategies, mirrored: every fish swims its own perturbed policy. Salimans et al., arXiv 1703.03864."""

    @dataclass(frozen=True, kw_only=True)
    class Config:
        """Settings; `--envs`, `--gamma` and every other hyperparameter go to the fields of their names."""

        envs: int = 64
        horizon: int = 25  # control steps that a perturbed policy swims
        hidden: tuple[int, ...] = (16,)
        sigma: float = 0.05
        learning_rate: float = 0.05
        activation: str = "tanh"

    def __init__(self, env, config, steps):
        self.env, self.config = env, config
        self.scale = jnp.asarray(env.input_scale)
        self.steps_per_iteration = config.envs * config.horizon

    def init(self, key):
        key, k_actor, k_env = jax.random.split(key, 3)
        actor = mlp(k_actor, [self.env.n_input, *self.config.hidden, self.env.n_act])
        return Training(actor, self.env.reset(k_env, self.config.envs, True), key)

    def act(self, actor, obs):
        return jnp.tanh(forward(actor, obs / self.scale, self.config.activation))

    @partial(jax.jit, static_argnums=0)
    def iterate(self, t):
        c, (key, k_noise) = self.config, jax.random.split(t.key)
        mean, unravel = ravel_pytree(t.actor)
        half = jax.random.normal(k_noise, (c.envs // 2, mean.size))
        noise = jnp.concatenate([half, -half])
        actors = jax.vmap(unravel)(mean + c.sigma * noise)

        def one(env, _):
            after = self.env.step(env, jax.vmap(self.act)(actors, env.obs))
            done = after.terminated | after.truncated | after.diverged
            return after, (after.reward, after.distance, done, after.terminated, after.diverged)

        env, (reward, distance, done, left, diverged) = jax.lax.scan(one, t.env, None, c.horizon)
        gain = reward.mean(0)
        gain = (gain - gain.mean()) / (gain.std() + 1e-6)
        actor = unravel(mean + c.learning_rate * gain @ noise / c.envs)
        figures = {
            "reward": reward.mean(),
            "late_distance": distance[-1].mean(),
            "late_arrived": (distance[-1] < 0.1).mean(),
            "left_tank": left.sum() / jnp.maximum(done.sum(), 1),
            "episodes": done.sum(),
            "diverged": diverged.sum(),
        }
        return Training(actor, env, key), figures


# importer
from fishmj.base.errors import LogError
from fishmj.log import Trial


def read(path):
    """A camera's CSV with columns time [ms], x [mm], y [mm], heading [deg]."""
    try:
        rows = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    except ValueError as error:
        raise LogError(f"{path}: {error}; expected four numbers in a row: time [ms], x [mm], y [mm], heading [deg]") from error
    t, x, y, heading = rows.T
    pose = {"t": t / 1e3, "x": x / 1e3, "y": y / 1e3, "yaw": np.unwrap(np.radians(heading))}
    meta = {"origin": "measured", "robot": "swift", "medium": "water", "clock": {"pose": "camera"}}
    return Trial(meta, {"pose": pose})
