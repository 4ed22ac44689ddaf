"""Gymnasium ids of fishmj's environments, registered as soon as both packages are imported, in either order.

    import fishmj, gymnasium
    env = gymnasium.make("fishmj/StationHold-v0")

Gymnasium 1.x does not load entry points of other packages. `import fishmj` therefore registers the ids at once if Gymnasium is
loaded, and otherwise after its import. It does not import Gymnasium itself.
"""

import sys
from importlib.abc import MetaPathFinder
from importlib.util import find_spec

IDS = {
    "fishmj/StationHold-v0": "station_hold",
    "fishmj/FigureEight-v0": "figure_eight",
    "fishmj/AngleOfAttack-v0": "angle_of_attack",
}


def register() -> None:
    """Adds the environments to Gymnasium's registry; a second call changes nothing."""
    import gymnasium

    for name, task in IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                id=name,
                entry_point="fishmj.tasks.gym.fish_env:FishEnv",
                vector_entry_point="fishmj.tasks.gym.fish_env:FishVectorEnv",
                kwargs={"task": task},
            )


def announce() -> None:
    """Registers now, or as soon as Gymnasium has been imported."""
    if "gymnasium" in sys.modules:
        if hasattr(sys.modules["gymnasium"], "registry"):  # its import has finished
            register()
    elif not any(isinstance(finder, _Wait) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Wait())


class _Wait(MetaPathFinder):
    """Import hook that registers the environments after the import of Gymnasium."""

    def find_spec(self, fullname, path=None, target=None):
        if fullname != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = find_spec(fullname)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def then_register(module) -> None:
                execute(module)
                register()

            spec.loader.exec_module = then_register
        return spec
