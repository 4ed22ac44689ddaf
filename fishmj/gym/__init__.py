"""Gymnasium environments of the fish. Importing this module registers them; nothing heavy is loaded before `make`.

    env  = gymnasium.make("fishmj.gym:fishmj/StationHold-v0")
    envs = gymnasium.make_vec("fishmj.gym:fishmj/StationHold-v0", num_envs=64)

The part before the colon is what Gymnasium imports to find the name (`import fishmj` alone loads NumPy only, so it registers
nothing). After `import fishmj.gym` the plain "fishmj/StationHold-v0" works as well.
"""

import gymnasium

IDS = {
    "fishmj/StationHold-v0": "station_hold",
    "fishmj/FigureEight-v0": "figure_eight",
    "fishmj/AngleOfAttack-v0": "angle_of_attack",
}


def register() -> None:
    """Put the environments into Gymnasium's registry; a second call changes nothing."""
    for name, task in IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                id=name,
                entry_point="fishmj.gym.single:FishEnv",
                vector_entry_point="fishmj.gym.vector:FishVectorEnv",
                kwargs={"task": task},
            )


register()
