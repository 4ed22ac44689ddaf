"""Tasks in the style of dm_control's suite.

from fishmj import suite

env = suite.load("fish", "station_hold", task_kwargs={"random": 1})
suite.register()            # from now on dm_control.suite.load("fish", "station_hold") works too
"""

from fishmj.tasks.dm_control import ALL_TASKS, BENCHMARKING, EXTRA, NO_REWARD_VIZ, REWARD_VIZ, TASKS_BY_DOMAIN, load, register

__all__ = ["ALL_TASKS", "BENCHMARKING", "EXTRA", "NO_REWARD_VIZ", "REWARD_VIZ", "TASKS_BY_DOMAIN", "load", "register"]
