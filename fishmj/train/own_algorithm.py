"""A learning algorithm of the user's own behind the interface of ppo.py and sac.py, every answer looked at.

    class Mine:
        Config                                      frozen dataclass of its settings, all with defaults
        def __init__(self, env, config, steps): ..  steps: control steps of the whole run, all fish together
        steps_per_iteration: int                    control steps that one `iterate` takes
        def init(self, key): ..                     -> a NamedTuple of arrays, with actor: [(weights (in, out), bias), ..]
        def iterate(self, training): ..             -> (training, metrics): see learner.METRICS
        def act(self, actor, obs): ..               -> actions (B, J) in [-1, 1] for raw observations, in JAX
        def policy_layers(self, actor): ..          -> learner.PolicyLayers; left out: all of actor, Config.activation or tanh

What is trained must be what is written: a policy file holds tanh(MLP(observation / scale)), and `act` is compared with it.
"""

from collections.abc import Mapping
from dataclasses import is_dataclass
from typing import Any

import numpy as np

from fishmj import plugins
from fishmj.errors import OwnCodeError
from fishmj.train.learner import METRICS, NEEDED, PolicyLayers
from fishmj.train.settings import Settings

CLOSE = 1e-4  # of an action in [-1, 1]: float32 through another library


def config_of(text: str):
    """The Config of a loaded algorithm. Raises OwnCodeError."""
    kind = getattr(plugins.loaded("algorithm")[text], "Config", None)
    if not (isinstance(kind, type) and is_dataclass(kind)):
        raise OwnCodeError(f"algorithm {text}: has no Config; give it a frozen dataclass of its settings, each with a default")
    return kind


class OwnAlgorithm:
    """Wraps `Name(env, config, steps)`. Raises OwnCodeError."""

    def __init__(self, text: str, env, config: Any, steps: int, settings: Settings):
        self.what = f"algorithm {text}"
        self.settings, self.env, self.config = settings, env, config
        made = plugins.loaded("algorithm")[text]
        plugins.takes(self.what, made, "Name(env, config, steps)", 3)
        self.mine = plugins.call(self.what, made, env, config, steps)
        self.name = plugins.name_of(text)
        for call, count in (("init(key)", 1), ("iterate(training)", 1), ("act(actor, obs)", 2)):
            plugins.takes(self.what, getattr(self.mine, call.partition("(")[0], None), call, count)
        self.steps_per_iteration: int = getattr(self.mine, "steps_per_iteration", 0)
        if not isinstance(self.steps_per_iteration, int) or self.steps_per_iteration < 1:
            raise OwnCodeError(
                f"{self.what}: steps_per_iteration = {self.steps_per_iteration!r}; expected a whole number, 1 or more"
            )

    def init(self, key):
        """A fresh training; its actor and `act` are checked."""
        training = plugins.call(f"{self.what}: init", self.mine.init, key)
        self._check(training)
        return training

    def iterate(self, state):
        """(train state, metrics)."""
        answer = plugins.call(f"{self.what}: iterate", self.mine.iterate, state)
        if not (isinstance(answer, tuple) and len(answer) == 2 and isinstance(answer[1], Mapping)):
            raise OwnCodeError(f"{self.what}: iterate gave {type(answer).__name__}; expected (training, figures as a dict)")
        if lacking := [name for name in NEEDED if name not in answer[1]]:
            raise OwnCodeError(f"{self.what}: its figures lack {', '.join(lacking)}; expected {', '.join(METRICS)}, numbers each")
        for name, value in answer[1].items():
            if np.shape(value) != ():
                raise OwnCodeError(f"{self.what}: figure {name} has shape {np.shape(value)}; expected one number")
        return answer

    def act(self, actor, obs):
        """Actions for raw observations."""
        return plugins.call(f"{self.what}: act", self.mine.act, actor, obs)

    def policy_layers(self, actor) -> PolicyLayers:
        """What a policy file holds."""
        if mine := getattr(self.mine, "policy_layers", None):
            return PolicyLayers(*plugins.call(f"{self.what}: policy_layers", mine, actor))
        return PolicyLayers(actor, getattr(self.config, "activation", "tanh"))

    def _check(self, training) -> None:
        from fishmj.train.build import policy_of

        try:
            policy = policy_of(self.policy_layers(training.actor), self.settings, {})
            policy.check("what it would write")
        except Exception as error:
            raise OwnCodeError(
                f"{self.what}: init gave no training whose `actor` is a list of (weights (in, out), bias (out,)) from "
                f"{self.env.n_input} inputs to {self.env.n_act} actions: {' '.join(str(error).split())[:200]}"
            ) from error
        if self.settings.task.get("memory", 1) > 1 or self.settings.task.get("hide"):
            return  # a window of past observations, or weights that are cut: not one observation in, one action out
        obs = np.random.default_rng(0).normal(size=(16, self.env.n_obs)).astype(np.float32)
        ours, theirs = policy(obs), np.asarray(self.act(training.actor, obs))
        if theirs.shape != ours.shape or not np.abs(theirs - ours).max() < CLOSE:
            off = f"shape {theirs.shape}" if theirs.shape != ours.shape else f"differs by {np.abs(theirs - ours).max():.3g}"
            raise OwnCodeError(
                f"{self.what}: act is not the policy that would be written ({off}): expected tanh(MLP(obs / scale)) with "
                f"activation {policy.meta['activation']!r}; fishmj.train.networks has forward and input_scale"
            )
