"""Gymnasium environments of the fish. Nothing heavy is loaded before `make`.

    import fishmj, gymnasium

    env  = gymnasium.make("fishmj/StationHold-v0")
    envs = gymnasium.make_vec("fishmj/StationHold-v0", num_envs=64)

`import fishmj` registers the names (fishmj/tasks/gym_ids.py). Without it Gymnasium imports the module before a colon:
"fishmj.tasks.gym:fishmj/StationHold-v0".
"""

from fishmj.tasks.gym_ids import IDS, register

register()

__all__ = ["IDS", "register"]
