"""How far two versions of a model are from records: the same floor for both, that of a fish with no effect at all."""

from dataclasses import replace

from fishmj import effects
from fishmj.engines import in_water
from fishmj.engines.extensions import STRUCTURED
from fishmj.errors import ConfigError, LogError
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.records.records import Record, record_of
from fishmj.gap.search.likelihood import likelihood_of
from fishmj.log import Trial
from fishmj.mjcf.description import Robot


def gaps(versions: list[Robot], trials: list[Trial], null: SimulatedNull, water: str = STRUCTURED) -> list[tuple[float, dict]]:
    """(gap, gap by channel) of each version over all trials, mean squares in units of the floor. water: that they swim in.

    Raises:
        ConfigError: the versions differ in more than their effects. LogError: no trials, or one that cannot be compared.
    """
    bare = [replace(robot, effects=(), name=versions[0].name) for robot in versions]
    if any(robot != bare[0] for robot in bare):
        raise ConfigError("gap check: the versions differ in more than their effects; their gaps do not compare")
    if not trials:
        raise LogError("gap check: no records to judge on; the data set holds none of those that the version names")
    listed = dict.fromkeys(fitted.name for robot in versions for fitted in robot.effects)
    model = SwimmingFish(in_water(bare[0], water), [e for e in map(effects.get, listed) if not e.stochastic])
    evidence = likelihood_of(model, [record_of(trial, model.dt) for trial in trials], null)
    return [evidence.gap(model.row(robot)) for robot in versions]


def gaps_of(versions: list[Robot], records: list[Record], null: SimulatedNull, model: SwimmingFish) -> list[float]:
    """The gaps alone, of records that are read already and a model that holds all effects of the versions."""
    evidence = likelihood_of(model, records, null)
    return [evidence.gap(model.row(robot))[0] for robot in versions]
