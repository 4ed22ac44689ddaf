"""Settings of a training run: presets, all options, and the file that is written at the start."""

from dataclasses import MISSING, Field, asdict, dataclass, field, fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from fishmj.base import plugins
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.options import checked, checked_name, declared, option_of
from fishmj.base.store.atomic import differing, read_json
from fishmj.lbm_oracle.run.solver_water import PLAIN
from fishmj.tasks.reference import COURSES
from fishmj.water.choice import LBM

FILE = "settings.json"  # all settings of a run, hyperparameters included, and the versions that made it
MADE_BY = "made_by"  # key of the versions and the commit in that file
FREE = ("steps", "assess_every", "checkpoint_every", "solver.device")  # settings that a resumed run may change
REWARD = ("wG", "wD", "wS")


class Registered(NamedTuple):
    """Registered learning algorithm, as references `module:Class`, which are imported when they are used."""

    config: str  # dataclass of its hyperparameters
    learner: str  # a train.learner.Learner
    budget: int = 0  # default control steps with `--algo`; 0: the preset's
    train: str = ""  # module:function in place of TrainingRun, for an algorithm with an environment of its own
    packages: tuple[str, ...] = ()  # additional packages whose versions a run records


_STABLE_SAC = Registered(
    "fishmj.train.hyperparameters:SACConfig",
    "fishmj.train.sb3:StableSAC",
    budget=1_000_000,
    train="fishmj.train.sb3:train_sb3",
    packages=("stable-baselines3", "torch", "gymnasium"),
)
ALGORITHMS = {  # an algorithm is its file and a line here
    "ppo": Registered("fishmj.train.hyperparameters:PPOConfig", "fishmj.train.ppo:PPO"),
    "sac": Registered("fishmj.train.hyperparameters:SACConfig", "fishmj.train.sac:SAC", budget=1_000_000),
    "sb3-ppo": _STABLE_SAC._replace(
        config="fishmj.train.hyperparameters:PlainPPOConfig", learner="fishmj.train.sb3:StablePPO", budget=16_000_000
    ),
    "sb3-sac": _STABLE_SAC,
}


def referred(text: str) -> Any:
    """Returns the object that `module:Name` of the register names."""
    module, _, name = text.partition(":")
    return getattr(import_module(module), name)


def option_text(value: Any, kind: Any) -> str:
    """Text of a hyperparameter's value, as its option takes it."""
    if isinstance(value, bool):
        return kind.known[value]
    return ",".join(map(str, value)) if isinstance(value, tuple) else f"{value:g}" if isinstance(value, float) else str(value)


class Hyperparameter(NamedTuple):
    """One hyperparameter with all algorithms that have it."""

    option: str  # --learning-rate
    kind: Any  # of options
    about: str
    defaults: dict[str, Any]  # algorithm -> default
    presets: dict[str, Any]  # preset -> its own value


def hyperparameters() -> dict[str, Hyperparameter]:
    """Hyperparameters of the registered algorithms by the name of their field, as `setting` declares them."""
    found: dict[str, dict[str, Field]] = {}
    for algo, entry in ALGORITHMS.items():
        for name, one in declared(referred(entry.config)).items():
            found.setdefault(name, {})[algo] = one
    made = {}
    for name, ones in found.items():
        first, defaults = next(iter(ones.values())), {algo: one.default for algo, one in ones.items()}
        sets = {key: s.algorithm[name] for key, s in PRESETS.items() if name in s.algorithm}
        own = {key: value for key, value in sets.items() if value != defaults.get(PRESETS[key].algo)}
        made[name] = Hyperparameter(option_of(first), first.metadata["kind"], first.metadata["about"], defaults, own)
    return made


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of one run. `task` is passed to tasks.env.Options, `algorithm` to the settings of the algorithm."""

    preset: str = "quick"
    algo: str = "ppo"
    engine: str = "auto"
    robot: str = "fish"
    water: str = "auto"  # name in fishmj.water.choice; auto: fitted if the robot has a fitted water
    command_path: str = ""  # path of servo commands between two decisions; "": the robot's
    control_dt: float = 0.0  # s between two decisions; 0: the robot's
    steps: int = 8_000_000  # control steps, all fish together
    seed: int = 0
    assess_every: int = 1_000_000  # control steps
    assess_episodes: int = 256
    checkpoint_every: float = 20.0  # s
    task: dict = field(default_factory=dict)
    algorithm: dict = field(default_factory=dict)
    reward: dict = field(default_factory=dict)
    solver: dict = field(default_factory=dict)  # of the engine lbm (preset lbm): domain, slip, device


PRESETS = {
    # for a laptop: small network, gusts as in the demo; three to six minutes on two cores
    "quick": Settings(
        preset="quick", task={"turbulence": "gust", "intensity": (0.0, 0.15)}, algorithm={"hidden": (64, 64), "envs": 512}
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
    # fine-tuning in the flow solver, one tank for each fish
    LBM: Settings(
        preset=LBM, engine=LBM, steps=100_000, assess_every=25_000, assess_episodes=24,
        solver={"domain": PLAIN.domain, "slip": PLAIN.slip, "device": "auto"},
        task={"turbulence": "default", "intensity": (0.0, 0.1)},
        algorithm={"envs": 24, "horizon": 75, "minibatches": 6, "learning_rate": 1e-4, "entropy": 0.0},
    ),
}  # fmt: skip

ON_MJX = {"paper": {"envs": 16384}}  # changes of a preset for mjx: with 8,192 fish an H200 trained at a quarter of the rate


def preset(name: str) -> Settings:
    """Settings of a preset by name. Raises UnknownName."""
    if name not in PRESETS:
        raise UnknownName("preset", name, PRESETS)
    return PRESETS[name]


def change(settings: Settings, **changes) -> Settings:
    """Copy of the settings; `changes` replace top-level fields, and are merged into `task`, `algorithm`, `reward`, `solver`."""
    known = {f.name for f in fields(Settings)}
    for key in changes:
        if key not in known:
            raise UnknownName("setting", key, known)
    merged: dict[str, Any] = {
        k: {**getattr(settings, k), **changes.pop(k)} for k in ("task", "algorithm", "reward", "solver") if k in changes
    }
    made = replace(settings, **merged, **changes)
    if made.algo not in ALGORITHMS and made.algo not in plugins.loaded("algorithm"):
        raise UnknownName("algorithm", made.algo, ALGORITHMS)
    for key, weight in made.reward.items():
        checked(f"reward weight {checked_name('reward weight', key, REWARD)}", weight, 0)
    if all(made.reward.get(key) == 0 for key in REWARD):
        raise ConfigError(f"reward weights {', '.join(REWARD)} are all 0, so there is nothing to learn; set one above 0")
    if made.steps <= 0 or made.seed < 0:
        raise ConfigError(f"steps = {made.steps} and seed = {made.seed}: steps must be positive, the seed not negative")
    if made.assess_every <= 0 or made.assess_episodes <= 0:
        raise ConfigError(f"assess_every = {made.assess_every}, assess_episodes = {made.assess_episodes}: both must be positive")
    return made


def as_dict(settings: Settings) -> dict:
    """Settings as plain types, for JSON."""
    listed = lambda v: list(v) if isinstance(v, tuple) else v
    return {k: {a: listed(b) for a, b in v.items()} if isinstance(v, dict) else v for k, v in asdict(settings).items()}


def from_dict(table: dict) -> Settings:
    """Inverse of `as_dict`."""
    tupled = lambda v: tuple(v) if isinstance(v, list) else v
    values: dict[str, Any] = {k: {a: tupled(b) for a, b in v.items()} if isinstance(v, dict) else v for k, v in table.items()}
    return Settings(**values)


def of_run(folder: Path) -> Settings | None:
    """Settings of the run in a folder, from its file; None without a file. Raises StoreError, ConfigError."""
    path = folder / FILE
    if not path.is_file():
        return None
    table = read_json(path)
    if isinstance(table, dict):
        table.pop(MADE_BY, None)
        table.setdefault("solver", {})  # runs of earlier versions had none
    expected = {f.name: dict if f.default is MISSING else type(f.default) for f in fields(Settings)}
    if not isinstance(table, dict) or set(table) != set(expected) or not all(_is(table[k], t) for k, t in expected.items()):
        raise ConfigError(
            f"{path}: not the settings of a training by this version of fishmj; give them on the command line again"
        )
    return from_dict(table)


def _is(value: Any, kind: type) -> bool:
    return isinstance(value, (int, float) if kind is float else kind)


def own_code(settings: Settings) -> dict[str, str]:
    """User's own code in a run: {option: name}."""
    course = settings.task.get("course", "station_hold")
    own = {"--algo": settings.algo if settings.algo not in ALGORITHMS else "", "--task": course if course not in COURSES else ""}
    return {option: name for option, name in own.items() if name}


def same(folder: Path, mine: Settings, theirs: dict) -> None:
    """Refuses to resume a run with settings that differ from its own; theirs: the run's, as in its files.

    Raises ConfigError: settings differ; the message has both values.
    """
    if other := differing(as_dict(mine), theirs, "{key} = {mine}, the run has {theirs}", FREE):
        raise ConfigError(f"{folder}: {other}; a run resumes with its own settings: leave these options out")
