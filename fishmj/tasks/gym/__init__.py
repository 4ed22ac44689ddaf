"""Gymnasium environments of the fish; heavy packages are imported in `make`.

    import fishmj, gymnasium

    env  = gymnasium.make("fishmj/StationHold-v0")
    envs = gymnasium.make_vec("fishmj/StationHold-v0", num_envs=64)

`import fishmj` registers the ids (fishmj/tasks/gym_ids.py). Without it, use "fishmj.tasks.gym:fishmj/StationHold-v0", for which
Gymnasium imports the module.
"""

from fishmj.tasks.gym_ids import IDS, register

register()

__all__ = ["IDS", "register"]
