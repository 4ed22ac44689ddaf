"""Tasks in the style of dm_control's suite: real `rl.control.Environment`s of the fish.

    env = fishmj.tasks.dm_control.load("fish", "station_hold", task_kwargs={"random": 1})
    fishmj.tasks.dm_control.register()            # from now on dm_control.suite.load("fish", "station_hold") works too

`upright` and `swim` of dm_control's own fish, and all its other domains, still load by the same function.
"""

from dm_control import suite as _dm

from fishmj.base import plugins
from fishmj.base.errors import UnknownName
from fishmj.tasks.dm_control import fish
from fishmj.tasks.reference import named

_OWN = fish.SUITE
ALL_TASKS = tuple((fish.DOMAIN, name) for name in _OWN)
BENCHMARKING = tuple((fish.DOMAIN, name) for name in _OWN.tagged("benchmarking"))
EXTRA = tuple(pair for pair in ALL_TASKS if pair not in BENCHMARKING)
REWARD_VIZ, NO_REWARD_VIZ = ALL_TASKS, ()
TASKS_BY_DOMAIN = {fish.DOMAIN: tuple(_OWN)}


def load(domain_name: str, task_name, task_kwargs=None, environment_kwargs=None, visualize_reward: bool = False):
    """Makes an environment by name.

    Args:
        task_name: in the domain "fish" also your own task: `module:Name`, `file.py:Name`, or its class. Loading it runs it.
        task_kwargs: `random` (seed or RandomState), `root`, and the fields of `fishmj.tasks.episode.TaskOptions`.
        environment_kwargs: for `dm_control.rl.control.Environment`, for example `flat_observation=True`.
        visualize_reward: colour the target by the reward.

    Raises:
        UnknownName: no such domain or task, here or in dm_control.
        ConfigError: an invalid option. OwnCodeError: your own object is not a task.
    """
    own = domain_name == fish.DOMAIN and (not isinstance(task_name, str) or plugins.is_reference(task_name))
    if not own and (domain_name, task_name) not in ALL_TASKS:
        known = {*_dm.ALL_TASKS, *ALL_TASKS}
        if (domain_name, task_name) not in known:
            raise UnknownName("task", f"{domain_name} {task_name}", (f"{d} {t}" for d, t in known))
        return _dm.load(domain_name, task_name, task_kwargs, environment_kwargs, visualize_reward)
    kwargs = dict(fish.table_of("task_kwargs", task_kwargs or {}))
    if environment_kwargs is not None:
        kwargs["environment_kwargs"] = environment_kwargs
    random, given, root = kwargs.pop("random", None), kwargs.pop("environment_kwargs", None), kwargs.pop("root", "planar")
    env = fish.environment(named(task_name), random, given, root, kwargs)
    env.task.visualize_reward = visualize_reward
    return env


def register() -> None:
    """Adds the tasks to dm_control's domain `fish` and to its task lists; a second call changes nothing.

    They are not in dm_control's `BENCHMARKING`, whose rewards lie in [0, 1]; the paper's reward may be negative. Names imported
    from `dm_control.suite` earlier (`from dm_control.suite import ALL_TASKS`) do not change.
    """
    for name, factory in _OWN.items():
        if name not in _dm.fish.SUITE:
            _dm.fish.SUITE.add("fishmj")(factory)
    with_own = lambda pairs: tuple(sorted({*pairs, *ALL_TASKS}))
    _dm.ALL_TASKS, _dm.EXTRA, _dm.REWARD_VIZ = (with_own(pairs) for pairs in (_dm.ALL_TASKS, _dm.EXTRA, _dm.REWARD_VIZ))
    names = (*_dm.TASKS_BY_DOMAIN[fish.DOMAIN], *_OWN)
    _dm.TASKS_BY_DOMAIN[fish.DOMAIN] = tuple(dict.fromkeys(names))


__all__ = ["ALL_TASKS", "BENCHMARKING", "EXTRA", "NO_REWARD_VIZ", "REWARD_VIZ", "TASKS_BY_DOMAIN", "load", "register"]
