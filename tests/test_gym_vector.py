"""The vector environment against Gymnasium's `SyncVectorEnv` of the single one: the same numbers in every autoreset mode."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from fishmj.base.errors import ConfigError, ResetNeeded
from fishmj.tasks.gym.fish_env import FishEnv, FishVectorEnv

ID = "fishmj/StationHold-v0"
FISH = 4
MODES = pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.value)
OPTIONS = dict(seconds=1.0, engine="compiled")
EDGE = {"pose": (1.97, 0.0, 0.0), "speed": 0.3, "direction": 0.0}  # leaves the domain in the second step


class Losing(FishEnv):
    """A fish whose physics diverges in the step that begins with `lost` set."""

    lost = False

    def step(self, action):
        """Breaks the state first."""
        if self.lost:
            self.episodes.fish.v[:], self.lost = 1e12, False
        return super().step(action)


def pair(mode, **options):
    """(our vector environment, Gymnasium's) of the same fish."""
    made = {**OPTIONS, **options}
    ours = FishVectorEnv(FISH, autoreset_mode=mode, **made)
    return ours, SyncVectorEnv([lambda: Losing(**made)] * FISH, autoreset_mode=mode)


def same(one, two):
    """Two answers of `step` or `reset` are equal: values, types, shapes, keys."""
    assert type(one) is type(two), (type(one), type(two))
    if isinstance(one, tuple):
        assert len(one) == len(two)
        for a, b in zip(one, two, strict=True):
            same(a, b)
    elif isinstance(one, dict):
        assert set(one) == set(two)
        for key in one:
            same(one[key], two[key])
    elif isinstance(one, np.ndarray) and one.dtype == object:
        for a, b in zip(one, two, strict=True):
            same(a, b)
    elif one is not None:
        assert one.dtype == two.dtype and one.shape == two.shape
        np.testing.assert_array_equal(one, two)


def actions(rng):
    return rng.uniform(-1, 1, (FISH, 3)).astype(np.float32)


def test_spaces_and_metadata_are_those_of_gymnasium():
    ours, theirs = pair(AutoresetMode.NEXT_STEP)
    for name in ("num_envs", "single_observation_space", "observation_space", "single_action_space", "action_space", "metadata"):
        assert getattr(ours, name) == getattr(theirs, name), name


@MODES
def test_episodes_are_those_of_gymnasium_in_every_mode(mode):
    """Time up, the edge and a divergence; with `Disabled` the ended fish are reset by mask."""
    ours, theirs = pair(mode)
    rng, ends = np.random.default_rng(5), 0
    same(ours.reset(seed=3, options=dict(EDGE)), theirs.reset(seed=3, options=dict(EDGE)))
    for k in range(16):
        if k == 3:
            ours.episodes.fish.v[1], theirs.envs[1].lost = 1e12, True
        action = actions(rng)
        one, two = ours.step(action), theirs.step(action)
        same(one, two)
        over, again = one[2] | one[3], None
        ends += over.sum()
        if mode is AutoresetMode.DISABLED and over.any():
            again = {"reset_mask": over}
            same(ours.reset(options=dict(again)), theirs.reset(options=again))
    assert ends > 2 * FISH


@MODES
def test_a_masked_reset_is_that_of_gymnasium(mode):
    """Healthy fish keep their observation with its noise; info is of the masked fish alone; seeds count for these alone."""
    ours, theirs = pair(mode)
    rng, mask = np.random.default_rng(6), np.array([True, False, True, False])
    ours.reset(seed=9), theirs.reset(seed=9)
    action = actions(rng)
    before, _ = ours.step(action)[0], theirs.step(action)
    for seed in (None, [11, 12, None, 14]):
        one = ours.reset(seed=seed, options={"reset_mask": mask})
        same(one, theirs.reset(seed=seed, options={"reset_mask": mask}))
        assert not one[1]["diverged"].any() and one[1]["_distance"].tolist() == mask.tolist()
        np.testing.assert_array_equal(one[0][~mask], before[~mask])
    for _ in range(4 if mode is AutoresetMode.DISABLED else 6):
        action = actions(rng)
        same(ours.step(action), theirs.step(action))


def test_a_masked_reset_in_next_step_mode_takes_the_place_of_the_restart():
    ours, theirs = pair(AutoresetMode.NEXT_STEP)
    for envs in (ours, theirs):
        envs.reset(seed=2)
    rng, mask = np.random.default_rng(7), np.array([False, True, False, False])
    for _ in range(5):
        action = actions(rng)
        same(ours.step(action), theirs.step(action))
    same(ours.reset(options={"reset_mask": mask}), theirs.reset(options={"reset_mask": mask}))
    for _ in range(3):
        action = actions(rng)
        same(ours.step(action), theirs.step(action))


def test_seeds_are_those_of_gymnasium():
    ours, theirs = pair(AutoresetMode.NEXT_STEP)
    for seed in (4, [8, 6, 5, 4], [None, 3, None, 3]):
        ours.reset(seed=seed), theirs.reset(seed=seed)
        seeded = [i for i in range(FISH) if not isinstance(seed, list) or seed[i] is not None]
        assert [ours.np_random_seed[i] for i in seeded] == [theirs.np_random_seed[i] for i in seeded]
    assert [rng.random() for rng in ours.np_random[1::2]] == [rng.random() for rng in theirs.np_random[1::2]]


def test_options_of_a_masked_reset_have_one_row_for_each_fish_of_the_batch():
    envs = FishVectorEnv(FISH, noise=0.0, turbulence="none", **OPTIONS)
    envs.reset(seed=0)
    poses = np.array([[0.1 * i, 0.0, 0.0] for i in range(FISH)])
    envs.reset(options={"pose": poses, "reset_mask": np.array([False, True, False, True])})
    np.testing.assert_allclose(envs.episodes.fish.q[[1, 3], 0], [0.1, 0.3])
    with pytest.raises(ConfigError, match=r"expected shape \(3,\) or \(4, 3\)"):
        envs.reset(options={"pose": poses[:2], "reset_mask": np.array([False, True, False, True])})


def test_an_ended_fish_is_not_stepped_without_autoreset():
    ours, theirs = pair(AutoresetMode.DISABLED)
    for envs in (ours, theirs):
        envs.reset(seed=1)
        for _ in range(5):
            envs.step(np.zeros((FISH, 3)))
        with pytest.raises(AssertionError):
            envs.step(np.zeros((FISH, 3)))
    with pytest.raises(ResetNeeded, match="reset_mask"):
        ours.step(np.zeros((FISH, 3)))
    ours.reset(options={"reset_mask": np.ones(FISH, bool)})
    ours.step(np.zeros((FISH, 3)))


@pytest.mark.parametrize("env", [FishEnv(), FishVectorEnv(1)])
def test_a_step_before_the_first_reset_is_refused(env):
    with pytest.raises(ResetNeeded, match="reset"):
        env.step(np.zeros(env.action_space.shape))


def test_what_a_step_returns_is_never_changed_later():
    envs = FishVectorEnv(FISH, autoreset_mode="SameStep", **OPTIONS)
    envs.reset(seed=0)
    seen = [envs.step(np.zeros((FISH, 3))) for _ in range(5)]
    kept = [step[0].copy() for step in seen]
    final = seen[-1][4]["final_obs"][0].copy()
    envs.step(np.zeros((FISH, 3)))
    envs.reset()
    for step, copied in zip(seen, kept, strict=True):
        np.testing.assert_array_equal(step[0], copied)
    np.testing.assert_array_equal(seen[-1][4]["final_obs"][0], final)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (dict(options={"reset_mask": np.array([1, 2, 3, 0])}), "int64"),
        (dict(options={"reset_mask": np.ones(3, bool)}), r"\(3,\)"),
        (dict(options={"reset_mask": np.zeros(FISH, bool)}), "one True"),
        (dict(seed=[1, 2]), "list of 4"),
        (dict(seed=1.5), "whole number"),
        (dict(seed=[1, 2, "x", 4]), "whole number"),
        (dict(seed=[1, 2, -3, 4]), "whole number"),
    ],
)
def test_a_wrong_mask_or_seed_is_one_clear_error(given, said):
    envs = FishVectorEnv(FISH, **OPTIONS)
    envs.reset(seed=0)
    with pytest.raises(ConfigError, match=said):
        envs.reset(**given)


# ---- the specification ----


@pytest.mark.parametrize(("options", "steps"), [({}, 150), ({"seconds": 60.0}, 300), ({"control_dt": 0.1, "seconds": 1}, 10)])
def test_the_specification_says_how_long_an_episode_is(options, steps):
    env, envs = gymnasium.make(ID, **options), gymnasium.make_vec(ID, num_envs=2, **options)
    assert env.spec.max_episode_steps == envs.spec.max_episode_steps == env.unwrapped.rules.limit == steps


def test_a_specification_makes_the_same_environment_again():
    env = gymnasium.make(gymnasium.make(ID, seconds=1.0).spec)
    envs = gymnasium.make_vec(gymnasium.make(ID, seconds=1.0).spec, num_envs=2)
    env.reset(seed=0), envs.reset(seed=0)
    single = [env.step(np.zeros(3, np.float32))[3] for _ in range(5)]
    many = [envs.step(np.zeros((2, 3), np.float32))[3].all() for _ in range(5)]
    assert single == many == [False] * 4 + [True]


def test_gymnasiums_time_limit_shortens_an_episode_but_never_lengthens_it():
    for most, steps in ((3, 3), (500, 5), (-1, 5)):
        env = gymnasium.make(ID, seconds=1.0, max_episode_steps=most)
        envs = gymnasium.make_vec(ID, num_envs=2, seconds=1.0, max_episode_steps=most)
        env.reset(seed=0), envs.reset(seed=0)
        assert envs.spec.max_episode_steps == steps
        for k in range(steps):
            ends = env.step(np.zeros(3, np.float32))[3], envs.step(np.zeros((2, 3), np.float32))[3].all()
            assert ends == ((k == steps - 1),) * 2
