"""The plan of a campaign: its blocks, durations, slip ratios, and the split of the episodes. Drawn from one seed.

    full(robot)                        about 4000 s of water, a dozen tanks on one GPU
    full(robot, scale=0.1)             the same blocks, a tenth as many episodes
    preview(robot)                     every kind of movement for a few seconds: tests and a first look on a CPU
    fresh_test(robot, seed=7)          new test episodes and their repeats, nothing else
    full(robot).at([1.0]).first(70)    of one slip ratio, the first 70 in an order that spans the states early
    planned("full, slip 1, first 70", robot)      the plan of this label

An episode's draws depend on (seed, block, number) only: a part of a block has exactly the same episodes. Every eighth is for
validation; test episodes are drawn separately, with turbulence from another table. A quarter of each block is also run at two
more slip ratios.

A block is a function (k, u (9,), robot) -> keywords of a `Segment`: drive, flow, pose, joints, settle of its k-th episode. Draws
u of neighbouring k, in [0, 1), come from one low-discrepancy sequence, so a part of a block is spread like the whole. Angles rad;
u is used in order.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from math import ceil, cos, pi, radians, sin
from typing import Any, NamedTuple

import numpy as np

from fishmj import control
from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError, FishmjError
from fishmj.hydro_fit.campaign.data.segment import Segment
from fishmj.hydro_fit.segment_dataset import SPLITS, split_hashes
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.water.flow import BOXES, Flow

DRAWS = 9
SETTLE = 3.0  # s of flow past a held fish before its record
SWEEP = radians(4)  # rad/s, at which a held fish turns through the angles of attack: 1 % of the slowest stream at its nose
SPEEDS = (0.1, 0.2, 0.3)  # m/s
CELLS = ((1, 1), (0, 0), (2, 0), (0, 1), (2, 1), (1, 0))  # of frequency and amplitude; the middle of the range first
Made = dict[str, Any]
DEFAULT_SLIP, OTHER_SLIPS = 1.0, (0.95, 0.0)
EVERY_SLIP = 4  # of so many episodes one is run at the other slips, too
EVERY_VAL = 8
STEERED = 0.35  # m/s, fastest stream of on-policy episodes
VALIDATES = 6  # of so many episodes of a round the last
# Default controllers; those among them that are made for the fish are used.
POLICIES = ("paper", "pilot", "dob", "paper-sac", "pi", "adrc-c1", "pd")
SEEDS = 3  # runs of one repeated episode with the grid's own time step


def within(u: float, low: float, high: float) -> float:
    """u mapped linearly from [0, 1) to [low, high)."""
    return low + (high - low) * float(u)


def static(k: int, u, robot: Robot) -> Made:
    """Held fish in a stream: four postures, three speeds, the water from every side; three of four turn slowly."""
    reach, n = robot.servo.range / 3, robot.n_joints
    bends = np.array([np.zeros(n), np.full(n, 1.0), np.full(n, 2.0), 1.5 * (-1.0) ** np.arange(n)])
    joints = tuple((reach * bends[k % 4]).tolist())
    attack, side = pi * float(u[0]), 1 if u[1] < 0.5 else -1
    rate = 0.0 if k % 16 in (3, 6, 9, 12) else SWEEP * (1 if attack < pi / 2 else -1)  # each posture is held still, too
    flow = Flow(speed=SPEEDS[(k + k // 4) % 3], direction=pi)
    drive = {"kind": "hold", "rate": -side * rate}
    return {"drive": drive, "flow": flow, "pose": (0.0, 0.0, -side * attack), "joints": joints, "settle": SETTLE}


def oscillation(k: int, u, robot: Robot) -> Made:
    """Forced oscillation in still water, for the added mass: heave, yaw, surge, each joint alone."""
    names = ["y", "yaw", *(f"j{i + 1}" for i in range(robot.n_joints)), "x"]
    along, frequency = names[k % len(names)], within(u[0], 0.5, 2.0)
    most, fastest = {"x": (0.06, 0.3), "y": (0.05, 0.3), "yaw": (0.25, 0.8)}.get(along, (radians(25), 3.0))  # m, m/s; rad, rad/s
    amplitude = within(u[1], 0.4, 1.0) * min(most, fastest / (2 * pi * frequency))
    bent = tuple((robot.servo.range / 3 * within(u[2], -1, 1) * np.ones(robot.n_joints)).tolist()) if u[3] < 0.4 else ()
    drive = {"kind": "shake", "along": along, "amplitude": amplitude, "frequency": frequency}
    return {"drive": drive, "joints": bent, "settle": 1 / frequency}


def chirp(k: int, u, robot: Robot) -> Made:
    """Joints from 0.2 to 3 Hz: held in a stream and prescribed exactly, or free by the servos."""
    held = k % 2 == 0
    drive = {"kind": "chirp", "low": 0.2, "high": 3.0, "held": held, "amplitude": radians(within(u[0], 8, 25 if held else 35))}
    drive |= {"ratio": within(u[1], 0.7, 1.3), "lag": radians(within(u[2], -90, 120))}
    flow = Flow(speed=(0.0, 0.2, 0.4)[k // 2 % 3] if held else _current(u[3]), direction=pi if held else 2 * pi * float(u[4]))
    return {"drive": drive, "flow": flow, "pose": (0.0, 0.0, 0.0 if held else 2 * pi * float(u[5]))}


def gait(k: int, u, robot: Robot) -> Made:
    """Swimming from rest: frequency, amplitude, lag, bias, stream and heading; a third swims straight, a half in still water."""
    bias = 0.0 if u[3] < 0.35 else radians(within((u[3] - 0.35) / 0.65, -30, 30))
    return {"drive": _wave(u, bias), "flow": Flow(speed=_current(u[4]), direction=2 * pi * float(u[5])), "pose": _heading(u[6])}


def straight(k: int, u, robot: Robot) -> Made:
    """Straight ahead from rest in still water, one draw from each of six cells of frequency and amplitude."""
    column, row = CELLS[k % len(CELLS)]
    wave = {"frequency": 0.5 + 0.45 * (column + float(u[0])), "amplitude": radians(12 + 11 * (row + float(u[1])))}
    drive = {"kind": "gait", "bias": 0.0, "lag": radians(within(u[2], 45, 75))}
    return {"drive": drive | wave, "pose": _heading(u[6])}


def turning(k: int, u, robot: Robot) -> Made:
    """Turning from rest in still water: a bias of 8 to 30 deg to either side."""
    wave = {"frequency": within(u[0], 0.8, 1.6), "amplitude": radians(within(u[1], 15, 30)), "lag": radians(within(u[2], 45, 75))}
    return {"drive": {"kind": "gait", "bias": radians(within(u[3], 8, 30)) * (-1) ** k} | wave, "pose": _heading(u[6])}


def random(k: int, u, robot: Robot) -> Made:
    """New random targets every control step, in a straight line or held, as from an untrained policy."""
    drive = {"kind": "targets", "amplitude": within(u[0], 0.15, 0.75) * robot.servo.range, "path": ("linear", "hold")[k % 2]}
    flow = Flow(speed=_current(u[1]), direction=2 * pi * float(u[2]))
    return {"drive": drive | {"seed": int(1e6 * u[3])}, "flow": flow, "pose": _heading(u[4])}


def manoeuvre(k: int, u, robot: Robot) -> Made:
    """Steps of amplitude, coasting, C-turns, start and stop, braking with a bent body, a stream from behind."""
    f, a, far = within(u[0], 0.8, 1.8), radians(within(u[1], 18, 32)), radians(within(u[2], 60, 120)) * (1 if u[3] < 0.5 else -1)
    phases = (
        [(4.0, f, a, 0.0), (9.0, f, 0.0, 0.0)],  # coast
        [(1.0, f, 0.0, 0.0), (0.7, f, 0.0, far), (9.0, f, a, 0.0)],  # C-turn from rest
        [(2.5, f, a, 0.0), (2.0, f, 0.0, 0.0)] * 3,  # start and stop
        [(4.0, f, a, 0.0), (2.5, f, 0.0, far), (9.0, f, a, 0.0)],  # brake
        [(3.0, f, a / 2, 0.0), (3.0, f, a, 0.0), (9.0, f / 2, a, 0.0)],  # steps
        [(3.0, f, a, 0.0), (2.0, f, a, far / 2), (9.0, f, a, -far / 2)],  # a stream from behind, S-turn
    )[k % 6]
    heading = 2 * pi * float(u[4])
    reverse = k % 6 == 5
    flow = Flow(
        speed=within(u[5], 0.1, 0.3) if reverse else _current(u[5]), direction=heading if reverse else 2 * pi * float(u[6])
    )
    drive = {"kind": "manoeuvre", "phases": phases, "lag": radians(within(u[7], 40, 80))}
    return {"drive": drive, "flow": flow, "pose": (0.0, 0.0, heading)}


def uneven(k: int, u, robot: Robot) -> Made:
    """Swimming through gusts, shear, a vortex street and turbulence."""
    preset = ("gust", "shear", "vortex_street", "default", "gust", "fine")[k % 6]
    direction = 2 * pi * float(u[5])
    flow = Flow(
        speed=within(u[4], 0.1, 0.35),
        direction=direction,
        turbulence=preset,
        intensity=within(u[3], 0.05, 0.25),
        seed=int(1e6 * u[7]),
    )
    heading = (0.0, 0.0, direction + pi + radians(within(u[6], -60, 60)))
    return {"drive": _wave(u, 0.0), "flow": flow, "pose": heading}


def steered(k: int, u, robot: Robot, helms: tuple[Made, ...]) -> Made:
    """A controller or policy on its way to a target 1.4 m off and at it, from any heading, in a turbulent stream."""
    speed, direction, far = within(u[0], 0.0, STEERED), 2 * pi * float(u[1]), constant("protocol", "distance")
    near = 0.2 if k % 3 == 2 else 1.0  # of the distance: every third episode begins close to the target
    where = 2 * pi * float(u[2])
    target = (near * far * cos(where), near * far * sin(where))
    flow = Flow(
        speed=speed,
        direction=direction,
        turbulence=("default", "gust")[k // 2 % 2],
        intensity=within(u[4], 0.0, 0.1),
        seed=int(1e6 * u[5]),
    )
    drive = {"kind": "policy", "target": target, "seed": int(1e6 * u[6])}
    return {"drive": drive | helms[k % len(helms)], "flow": flow, "pose": _heading(u[3])}


def flapping(k: int, u, robot: Robot) -> Made:
    """Held fish that follows a gait exactly, at rest or in a stream from ahead: the thrust of its beat."""
    wave = {"frequency": within(u[0], 0.5, 1.8), "amplitude": radians(within(u[1], 10, 32)), "lag": radians(within(u[2], 30, 90))}
    drive = {"kind": "gait", "held": True, "bias": 0.0 if k % 3 else radians(within(u[3], -25, 25))}
    flow = Flow(speed=(0.0, 0.15, 0.3)[(k + k // 3) % 3], direction=pi)
    return {"drive": drive | wave, "flow": flow, "pose": (0.0, 0.0, radians(within(u[4], -15, 15))), "settle": SETTLE / 2}


def _wave(u, bias: float) -> Made:
    wave = {"frequency": within(u[0], 0.4, 2.0), "amplitude": radians(within(u[1], 6, 35)), "lag": radians(within(u[2], 30, 90))}
    return {"kind": "gait", "bias": bias} | wave


def _current(u: float) -> float:
    """Speed of the stream: half still water, half up to 0.45 m/s."""
    return 0.0 if u < 0.5 else 0.9 * (float(u) - 0.5)


def _heading(u: float) -> tuple[float, float, float]:
    return 0.0, 0.0, 2 * pi * float(u)


BLOCKS: dict[str, Callable[..., Made]] = {
    "static": static,
    "oscillation": oscillation,
    "chirp": chirp,
    "gait": gait,
    "straight": straight,
    "turning": turning,
    "random": random,
    "manoeuvre": manoeuvre,
    "uneven": uneven,
    "policy": steered,
    "flapping": flapping,  # draws go by the place in this table: a new block comes last
}


class PlanPart(NamedTuple):
    """Number and duration of a block's episodes; at least `least` episodes at any scale."""

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
LEAST = (  # split, block, episodes: the least that a water is fitted to and judged by
    ("train", "gait", 4), ("val", "gait", 1), ("test", "straight", 1), ("train", "static", 2), ("train", "random", 1),
    ("train", "oscillation", 1), ("train", "flapping", 1), ("test", "turning", 1),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class CampaignPlan:
    """Segments in the order in which they are run, and the label of their draws."""

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
        """sha256 of the episodes of each split."""
        return split_hashes(self.episodes)

    @property
    def water(self) -> float:
        """Seconds of water, in steps of the domain, settling included."""
        return sum(segment.water for segment in self.segments)

    def at(self, slips: Sequence[float]) -> "CampaignPlan":
        """The part of the plan at these slip ratios. Raises ConfigError: no segment is at one of them."""
        there = sorted({segment.slip for segment in self.segments})
        if unknown := [slip for slip in slips if slip not in there]:
            known = ", ".join(f"{s:g}" for s in there)
            raise ConfigError(f"campaign: slip = {unknown[0]}; expected of this plan's {known}; --all-at-slip S takes any")
        kept = tuple(segment for segment in self.segments if segment.slip in slips)
        return replace(self, label=f"{self.label}, slip {', '.join(f'{s:g}' for s in sorted(set(slips)))}", segments=kept)

    def moved_to(self, slip: float) -> "CampaignPlan":
        """Segments at the default slip ratio, moved to this one."""
        made = [replace(s, slip=slip, id=_id(s.episode, slip) + s.id.removeprefix(_id(s.episode, s.slip))) for s in self.default]
        ids = {old.id: new.id for old, new in zip(self.default, made, strict=True)}
        made = [replace(s, replicate_of=ids.get(s.replicate_of, s.replicate_of)) for s in made]
        return replace(self, label=f"{self.label}, all at slip {slip:g}", segments=tuple(made))

    @property
    def default(self) -> list[Segment]:
        """Segments at the default slip ratio."""
        return [segment for segment in self.segments if segment.slip == DEFAULT_SLIP]

    def first(self, count: int) -> "CampaignPlan":
        """The first `count` segments in the order of `spanning`."""
        return replace(self, label=f"{self.label}, first {count}", segments=tuple(spanning(self.segments)[:count]))

    def rows(self) -> list[dict]:
        """Rows of a table: blocks with their segments and seconds by split."""
        blocks = list(dict.fromkeys(segment.block for segment in self.segments))
        rows = []
        for block in [*blocks, "all"]:
            own = [segment for segment in self.segments if block in (segment.block, "all")]
            seconds = {split: sum(s.seconds for s in own if s.split == split) for split in SPLITS}
            other = sum(s.seconds for s in own if s.slip != DEFAULT_SLIP)
            row = {"block": block, "segments": len(own), "recorded_s": sum(s.seconds for s in own), "other_slips_s": other}
            rows.append(row | {f"{split}_s": value for split, value in seconds.items()} | {"water_s": sum(s.water for s in own)})
        return rows


def spanning(segments: Iterable[Segment]) -> list[Segment]:
    """Segments in an order of which every first part spans the states.

    First `LEAST`, then one episode of every block and split, then all at equal shares, then repeats and other slips.
    """
    return [segment for _, segment in _ranked(segments)]


def least(segments: Iterable[Segment]) -> list[Segment]:
    """Segments of `LEAST`, as far as they exist."""
    return [segment for tier, segment in _ranked(segments) if tier == 0]


def _ranked(segments: Iterable[Segment]) -> list[tuple[int, Segment]]:
    """Tier (0 for `LEAST`) and segment, in order."""
    segments = sorted(segments, key=lambda segment: segment.id)
    slips = {segment.slip for segment in segments}
    main = DEFAULT_SLIP if DEFAULT_SLIP in slips else max(slips, default=DEFAULT_SLIP)
    groups: dict[tuple, list[Segment]] = {}
    for segment in segments:
        aside = 4 if segment.slip != main else 3 if segment.replicate_of else 0
        groups.setdefault((aside, segment.split, segment.block), []).append(segment)
    wanted = {(split, block): (k, count) for k, (split, block, count) in enumerate(LEAST)}
    rows = []
    for (aside, split, block), own in groups.items():
        place, count = wanted.get((split, block), (len(LEAST), 0))
        for k, segment in enumerate(own):
            tier = aside or (0 if k < count else 1 if k == 0 else 2)
            rows.append(((tier, k if tier == 0 else k / len(own), place, split, block, k), segment))
    return [(key[0], segment) for key, segment in sorted(rows, key=lambda row: row[0])]


def planned(label: str, robot: "Robot | str", seed: int = 0) -> CampaignPlan:
    """Plan of a label, as a data set states it; its policies are those made for the fish. Raises ConfigError: no such label."""
    kinds, parts = r"(full|preview|scale ([\d.e+-]+)|fresh test (\d+))", r"(?:, slip ([\d., ]+?))?(?:, all at slip ([\d.]+?))?"
    known = re.fullmatch(kinds + parts + r"(?:, first (\d+))?", label)
    if known is None:
        raise ConfigError(f"campaign: no plan {label!r}; expected full, preview, scale X or fresh test N, and slip S, first N")
    kind, scale, fresh, slips, other, count = known.groups()
    if fresh:
        plan = fresh_test(robot, seed=int(fresh))
    else:
        plan = preview(robot, seed=seed) if kind == "preview" else full(robot, seed=seed, scale=float(scale or 1))
    plan = plan.at([float(slip) for slip in slips.split(", ")]) if slips else plan
    plan = plan.moved_to(float(other)) if other else plan
    return plan.first(int(count)) if count else plan


def full(robot: "Robot | str" = "fish", *, seed: int = 0, scale: float = 1.0, policies: Sequence[str] = ()) -> CampaignPlan:
    """The whole campaign, or the same with `scale` times as many episodes.

    Args:
        policies: names or files of controllers for on-policy episodes; by default those of `POLICIES` for this fish.

    Raises ConfigError: a scale that is not positive; a named policy is not for this fish.
    """
    if not 0 < scale <= 100:
        raise ConfigError(f"campaign: scale = {scale}; expected a positive number, 1 for the whole campaign")
    robot = load_robot(robot)
    steer = _steering(robot, policies)
    train = [e for part in TRAINING for e in _episodes(part, robot, seed, "train", _count(part, scale), steer)]
    test = [e for part in TEST for e in _episodes(part, robot, seed, "test", _count(part, scale), steer)]
    label = f"scale {scale:g}" if scale != 1 else "full"
    return CampaignPlan(label=label, robot=robot, seed=seed, segments=_ordered([*_at_slips(train + test), *_repeats(test)]))


def preview(robot: "Robot | str" = "fish", *, seed: int = 0, policies: Sequence[str] = ()) -> CampaignPlan:
    """Every block and split for a few seconds; also a held and a swimming fish at the other slips."""
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
    return CampaignPlan(label="preview", robot=robot, seed=seed, segments=_ordered(made))


def fresh_test(robot: "Robot | str" = "fish", *, seed: int, policies: Sequence[str] = (), scale: float = 1.0) -> CampaignPlan:
    """New test episodes and repeats, unseen by any fit: figures on them must agree with those of the shipped ones."""
    if seed < 1:
        raise ConfigError(f"campaign: fresh test seed {seed}; expected 1 or more, 0 drew the shipped one")
    robot = load_robot(robot)
    steer = _steering(robot, policies)
    test = [e for part in TEST for e in _episodes(part, robot, seed, "test", _count(part, scale), steer)]
    return CampaignPlan(
        label=f"fresh test {seed}", robot=robot, seed=seed, segments=_ordered([*_at_slips(test), *_repeats(test)])
    )


def on_policy(
    robot: "Robot | str", controller: str, *, episodes: int, seconds: float, seed: int, slip: float = DEFAULT_SLIP,
    speeds: tuple[float, float] | None = None,
) -> CampaignPlan:  # fmt: skip
    """Training episodes steered by one controller or policy file: the addition of one round of correction to a data set.

    speeds: m/s, bounds of the draw of the stream's speed; by default those of the campaign. Every sixth episode validates, and
    of fewer the last.
    """
    robot = load_robot(robot)
    steer = _steering(robot, (controller,))
    made = _episodes(PlanPart("policy", episodes, seconds), robot, seed, "train", episodes, steer, prefix=f"round{seed}-")
    every = min(VALIDATES, episodes)
    split = lambda k: "val" if k % every == every - 1 > 0 else "train"
    if speeds is not None:
        made = [replace(s, flow=replace(s.flow, speed=within(s.flow.speed / STEERED, *speeds))) for s in made]
    segments = tuple(replace(s, slip=slip, id=_id(s.episode, slip), split=split(k)) for k, s in enumerate(made))
    return CampaignPlan(label=f"on policy, round {seed}", robot=robot, seed=seed, segments=segments)


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
    """Some test episodes again: with the fish shifted by part of a cell, and with half the time step."""
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
    """Segments in running order: long ones first, so that tanks side by side finish together; blocks mixed."""
    rng = np.random.default_rng(0)
    mixed = [segments[i] for i in rng.permutation(len(segments))]
    return tuple(sorted(mixed, key=lambda segment: -segment.water))


def _count(part: PlanPart, scale: float) -> int:
    return max(1, ceil(part.episodes * scale - 1e-9)) if scale >= 1 else max(part.least, round(part.episodes * scale))


def _steering(robot: Robot, wanted: Sequence[str]) -> tuple[dict, ...]:
    """Controllers of on-policy episodes, policies with their sha256; by default those that can be made for this fish."""
    made = []
    for name in wanted or POLICIES:
        try:
            brain = control.make(name, robot)
        except FishmjError:
            if wanted:
                raise
            continue
        sha = getattr(brain, "sha256", "")
        made.append({"controller": str(name)} | ({"sha256": sha} if sha else {}))
    return tuple(made)


def _id(episode: str, slip: float) -> str:
    return f"{episode}_s{slip:g}"
