"""What a training run is: presets, everything that can be changed, and how it is written to disk at the start."""

from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from fishmj import plugins
from fishmj.errors import ConfigError, UnknownName

ALGORITHMS = ("ppo", "sac", "sb3-sac")
REWARD = ("wG", "wD", "wS")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """One run. `task` goes to tasks.env.Options, `algorithm` to the Config of ppo.py or sac.py."""

    preset: str = "quick"
    algo: str = "ppo"
    engine: str = "auto"
    robot: str = "fish"
    water: str = "structured"
    command_path: str = "linear"
    steps: int = 13_000_000  # control steps of 0.2 s, all fish together
    seed: int = 0
    assess_every: int = 1_000_000  # control steps
    assess_episodes: int = 256
    checkpoint_every: float = 20.0  # s
    task: dict = field(default_factory=dict)
    algorithm: dict = field(default_factory=dict)
    reward: dict = field(default_factory=dict)


PRESETS = {
    # a laptop: small network, gusts as strong as the demo's; about a minute on two cores
    "quick": Settings(
        preset="quick",
        task={"turbulence": "gust", "intensity": (0.0, 0.15)},
        algorithm={"hidden": (64, 64), "envs": 512},
    ),
    # one GPU: the paper's actor (11-256-256-3, memoryless); half a minute with --engine planar
    "paper": Settings(
        preset="paper",
        steps=120_000_000,
        assess_every=15_000_000,
        assess_episodes=1024,
        task={"turbulence": "gust", "intensity": (0.0, 0.12)},
        algorithm={
            "hidden": (256, 256), "activation": "relu", "envs": 8192, "horizon": 16, "minibatches": 8, "learning_rate": 7e-4,
            "entropy": 0.001, "final_rate": 0.03,
        },
    ),
    # the paper's algorithm, networks and budget
    "paper-sac": Settings(
        preset="paper-sac", algo="sac", steps=1_000_000, assess_every=100_000,
        task={"turbulence": "gust", "intensity": (0.0, 0.12)},
        algorithm={"hidden": (256, 256), "envs": 64},
    ),
}  # fmt: skip


def preset(name: str) -> Settings:
    """A preset by name. Raises UnknownName."""
    if name not in PRESETS:
        raise UnknownName("preset", name, PRESETS)
    return PRESETS[name]


def change(settings: Settings, **changes) -> Settings:
    """A copy with top-level fields replaced and `task`, `algorithm`, `reward` merged."""
    known = {f.name for f in fields(Settings)}
    for key in changes:
        if key not in known:
            raise UnknownName("setting", key, known)
    merged: dict[str, Any] = {
        k: {**getattr(settings, k), **changes.pop(k)} for k in ("task", "algorithm", "reward") if k in changes
    }
    made = replace(settings, **merged, **changes)
    if made.algo not in ALGORITHMS and made.algo not in plugins.loaded("algorithm"):
        raise UnknownName("algorithm", made.algo, ALGORITHMS)
    for key in made.reward:
        if key not in REWARD:
            raise UnknownName("reward weight", key, REWARD)
    if made.steps <= 0 or made.seed < 0:
        raise ConfigError(f"steps = {made.steps} and seed = {made.seed}: steps must be positive, the seed not negative")
    if made.assess_every <= 0 or made.assess_episodes <= 0:
        raise ConfigError(f"assess_every = {made.assess_every}, assess_episodes = {made.assess_episodes}: both must be positive")
    return made


def as_dict(settings: Settings) -> dict:
    """Plain types, for JSON."""
    listed = lambda v: list(v) if isinstance(v, tuple) else v  # noqa: E731
    return {k: {a: listed(b) for a, b in v.items()} if isinstance(v, dict) else v for k, v in asdict(settings).items()}


def from_dict(table: dict) -> Settings:
    """The inverse of `as_dict`."""
    tupled = lambda v: tuple(v) if isinstance(v, list) else v  # noqa: E731
    values: dict[str, Any] = {k: {a: tupled(b) for a, b in v.items()} if isinstance(v, dict) else v for k, v in table.items()}
    return Settings(**values)
