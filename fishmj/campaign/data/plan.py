"""The plan of a campaign: its blocks, how long, at which slip ratios, and which episode is for what. Drawn from one seed.

    full(robot)                        about 4000 s of water, a dozen tanks on one GPU
    full(robot, scale=0.1)             the same blocks, a tenth as many episodes
    preview(robot)                     every kind of movement for a few seconds: tests and a first look on a CPU
    fresh_test(robot, seed=7)          new test episodes and their repeats, nothing else

An episode's draws depend on (seed, block, number) only: a part of a block consists of the very same episodes. Every eighth is
for validation; test episodes are drawn apart, with turbulence from another table. A quarter of each block is run at two more slip
ratios, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Any, NamedTuple

import numpy as np

from fishmj import controllers
from fishmj.campaign.data.movements import BLOCKS, DRAWS
from fishmj.campaign.data.segment import Segment
from fishmj.errors import ConfigError, FishmjError
from fishmj.flow import BOXES
from fishmj.hydro_fit.segment_dataset import SPLITS, split_hashes
from fishmj.mjcf.description import Robot, load_robot

DEFAULT_SLIP, OTHER_SLIPS = 1.0, (0.95, 0.0)
EVERY_SLIP = 4  # of so many episodes one is run at the other slips, too
EVERY_VAL = 8
# What steers unless others are named; those that are made for the fish.
POLICIES = ("paper", "pilot", "dob", "paper-sac", "pi", "adrc-c1", "pd")
SEEDS = 3  # runs of one repeated episode with the grid's own time step


class PlanPart(NamedTuple):
    """So many episodes of a block, so many seconds each, at least `least` however small the scale."""

    block: str
    episodes: int
    seconds: float
    least: int = 1


TRAINING = (
    PlanPart("static", 40, 15.0, 3),
    PlanPart("oscillation", 12, 5.0, 3),
    PlanPart("chirp", 16, 15.0, 2),
    PlanPart("flapping", 56, 6.0, 1),
    PlanPart("gait", 36, 10.0, 6),
    PlanPart("random", 24, 10.0, 2),
    PlanPart("manoeuvre", 12, 10.0, 2),
    PlanPart("uneven", 12, 10.0, 1),
    PlanPart("policy", 70, 25.0, 1),
)
TEST = (
    PlanPart("straight", 6, 12.0),
    PlanPart("turning", 4, 12.0),
    PlanPart("gait", 4, 12.0),
    PlanPart("random", 4, 10.0),
    PlanPart("manoeuvre", 4, 10.0),
    PlanPart("uneven", 2, 15.0),
    PlanPart("chirp", 1, 15.0),
    PlanPart("flapping", 6, 6.0),
    PlanPart("policy", 7, 20.0),
)
REPEATED = ("straight", "turning", "random", "flapping")  # the first test episode of each: how well the oracle repeats itself
LONGEST_PREVIEW = 4.0  # s


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Segments in the order in which they are run, and how they were drawn."""

    label: str
    robot: Robot
    seed: int
    segments: tuple[Segment, ...]

    @property
    def episodes(self) -> dict[str, str]:
        """Split of every episode."""
        return {segment.episode: segment.split for segment in self.segments}

    @property
    def split_sha256(self) -> dict[str, str]:
        return split_hashes(self.episodes)

    @property
    def water(self) -> float:
        """Seconds of water, in steps of the domain, settling included."""
        return sum(segment.water for segment in self.segments)

    def at(self, slips: Sequence[float]) -> "Plan":
        """The part of the plan at these slip ratios.

        Raises:
            ConfigError: no segment is at one of them.
        """
        there = sorted({segment.slip for segment in self.segments})
        if unknown := [slip for slip in slips if slip not in there]:
            raise ConfigError(f"campaign: slip = {unknown[0]}; expected of this plan's {', '.join(f'{s:g}' for s in there)}")
        kept = tuple(segment for segment in self.segments if segment.slip in slips)
        return replace(self, label=f"{self.label}, slip {', '.join(f'{s:g}' for s in sorted(set(slips)))}", segments=kept)

    def rows(self) -> list[dict]:
        """Blocks with their segments and seconds by split, for a table."""
        blocks = list(dict.fromkeys(segment.block for segment in self.segments))
        rows = []
        for block in [*blocks, "all"]:
            own = [segment for segment in self.segments if block in (segment.block, "all")]
            seconds = {split: sum(s.seconds for s in own if s.split == split) for split in SPLITS}
            other = sum(s.seconds for s in own if s.slip != DEFAULT_SLIP)
            row = {"block": block, "segments": len(own), "recorded_s": sum(s.seconds for s in own), "other_slips_s": other}
            rows.append(row | {f"{split}_s": value for split, value in seconds.items()} | {"water_s": sum(s.water for s in own)})
        return rows


def full(robot: "Robot | str" = "fish", *, seed: int = 0, scale: float = 1.0, policies: Sequence[str] = ()) -> Plan:
    """The whole campaign, or the same with `scale` times as many episodes.

    Args:
        policies: names or files of what steers on-policy episodes; by default those of `POLICIES` that know the fish.

    Raises:
        ConfigError: a scale that is not positive; a named policy is not for this fish.
    """
    if not 0 < scale <= 100:
        raise ConfigError(f"campaign: scale = {scale}; expected a positive number, 1 for the whole campaign")
    robot = load_robot(robot)
    steer = _steering(robot, policies)
    train = [e for part in TRAINING for e in _episodes(part, robot, seed, "train", _count(part, scale), steer)]
    test = [e for part in TEST for e in _episodes(part, robot, seed, "test", _count(part, scale), steer)]
    label = f"scale {scale:g}" if scale != 1 else "full"
    return Plan(label=label, robot=robot, seed=seed, segments=_ordered([*_at_slips(train + test), *_repeats(test)]))


def preview(robot: "Robot | str" = "fish", *, seed: int = 0, policies: Sequence[str] = ()) -> Plan:
    """Every block and split for a few seconds, a held and a swimming fish at the other slips, too."""
    robot = load_robot(robot)
    steer = _steering(robot, policies)
    draw = lambda part, split, n: _episodes(
        part._replace(seconds=min(part.seconds, LONGEST_PREVIEW)), robot, seed, split, n, steer
    )
    train = [e for part in TRAINING for e in draw(part, "train", part.least)]
    test = [e for part in TEST if part.block in REPEATED for e in draw(part, "test", 1)]
    first = [e for e in train if e.episode in ("static-000", "gait-000")]
    others = [s for s in _at_slips(first) if s.slip != DEFAULT_SLIP]
    made = [replace(s, settle=min(s.settle, 1.0)) for s in [*train, *others, *test, _repeats(test)[0]]]
    return Plan(label="preview", robot=robot, seed=seed, segments=_ordered(made))


def fresh_test(robot: "Robot | str" = "fish", *, seed: int, policies: Sequence[str] = (), scale: float = 1.0) -> Plan:
    """Test episodes and repeats that no one has seen: figures on them must be those of the shipped ones."""
    if seed < 1:
        raise ConfigError(f"campaign: fresh test seed {seed}; expected 1 or more, 0 drew the shipped one")
    robot = load_robot(robot)
    steer = _steering(robot, policies)
    test = [e for part in TEST for e in _episodes(part, robot, seed, "test", _count(part, scale), steer)]
    return Plan(label=f"fresh test {seed}", robot=robot, seed=seed, segments=_ordered([*_at_slips(test), *_repeats(test)]))


def on_policy(
    robot: "Robot | str", controller: str, *, episodes: int, seconds: float, seed: int, slip: float = DEFAULT_SLIP
) -> Plan:
    """Training episodes steered by one controller or policy file: what a round of correction adds to a data set."""
    robot = load_robot(robot)
    steer = _steering(robot, (controller,))
    made = _episodes(PlanPart("policy", episodes, seconds), robot, seed, "train", episodes, steer, prefix=f"round{seed}-")
    split = lambda k: "val" if 0 < k == episodes - 1 else "train"  # the last of several validates
    segments = tuple(replace(s, slip=slip, id=_id(s.episode, slip), split=split(k)) for k, s in enumerate(made))
    return Plan(label=f"on policy, round {seed}", robot=robot, seed=seed, segments=segments)


def _episodes(
    part: PlanPart, robot: Robot, seed: int, split: str, count: int, steer: tuple[dict, ...], prefix: str = ""
) -> list[Segment]:
    """The first `count` episodes of a block at the default slip."""
    from scipy.stats import qmc

    if part.block == "policy" and not steer:
        return []
    kind, test = list(BLOCKS).index(part.block), split == "test"
    draws = qmc.Halton(DRAWS, scramble=True, rng=np.random.default_rng([seed, kind, test])).random(count)
    head = prefix or ("" if not test else "test-" if seed == 0 else f"test{seed}-")
    made = []
    for k, u in enumerate(draws):
        details = BLOCKS[part.block](k, u, robot, *((steer,) if part.block == "policy" else ()))
        if test and "flow" in details:
            details["flow"] = replace(details["flow"], box=BOXES["judge"])
        episode = f"{head}{part.block}-{k:03d}"
        where = "val" if split == "train" and k % EVERY_VAL == 5 else split
        named: dict[str, Any] = {"id": _id(episode, DEFAULT_SLIP), "block": part.block, "episode": episode, "split": where}
        made.append(Segment(**named, seconds=part.seconds, slip=DEFAULT_SLIP, **details))
    return made


def _at_slips(episodes: list[Segment]) -> list[Segment]:
    """All of them at the default slip, some of each block at the others."""
    seen: dict[tuple, int] = {}
    out = []
    for segment in episodes:
        key = segment.block, segment.split == "test"
        number = seen[key] = seen.get(key, -1) + 1
        out.append(segment)
        if number % EVERY_SLIP == 0:
            out += [replace(segment, slip=slip, id=_id(segment.episode, slip)) for slip in OTHER_SLIPS]
    return out


def _repeats(episodes: list[Segment]) -> list[Segment]:
    """Some test episodes again: the fish shifted by part of a cell, and with half the time step."""
    out = []
    for block in REPEATED:
        first = next((segment for segment in episodes if segment.block == block), None)
        if first is None:
            continue
        for r in range(1, SEEDS):
            nudge = np.random.default_rng([r, list(BLOCKS).index(block)]).uniform(-0.5, 0.5, 2)
            x, y = nudge.tolist()
            out.append(replace(first, id=f"{first.id}_r{r}", nudge=(x, y), replicate_of=first.id))
        out.append(replace(first, id=f"{first.id}_half", finer=2, replicate_of=first.id))
    return out


def _ordered(segments: list[Segment]) -> tuple[Segment, ...]:
    """Long ones first, so that tanks side by side finish together; blocks mixed."""
    rng = np.random.default_rng(0)
    mixed = [segments[i] for i in rng.permutation(len(segments))]
    return tuple(sorted(mixed, key=lambda segment: -segment.water))


def _count(part: PlanPart, scale: float) -> int:
    return max(1, ceil(part.episodes * scale - 1e-9)) if scale >= 1 else max(part.least, round(part.episodes * scale))


def _steering(robot: Robot, wanted: Sequence[str]) -> tuple[dict, ...]:
    """What steers on-policy episodes, policies with their sha256; without wishes those that can be made for this fish."""
    made = []
    for name in wanted or POLICIES:
        try:
            brain = controllers.make(name, robot)
        except FishmjError:
            if wanted:
                raise
            continue
        sha = getattr(brain, "sha256", "")
        made.append({"controller": str(name)} | ({"sha256": sha} if sha else {}))
    return tuple(made)


def _id(episode: str, slip: float) -> str:
    return f"{episode}_s{slip:g}"
