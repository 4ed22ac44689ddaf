"""Saliency of the policy's inputs over time, by two methods, and their rank correlation.

    sensitivity    sum over joints of |da/ds_i| sigma_i              sigma_i: spread of the input over all trials
    integrated     sum over joints of |(s_i - b_i) int_0^1 da/ds_i(b + u (s - b)) du|        b = 0: at rest on the target

Sundararajan, Taly, Yan 2017 (integrated gradients). Both are shares: they sum to 1 at every time. An input of a policy with
memory counts with all its remembered values.
"""

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.base.figures import BLUE, VERMILION, canvas, png, style
from fishmj.control.learned import LearnedController
from fishmj.control.policy import Policy
from fishmj.evaluate.experiments.experiment_figures import compared, read, rounded
from fishmj.evaluate.experiments.paper_experiment import ExperimentFindings, ExperimentPart, ExperimentSetup, PaperExperiment, Row
from fishmj.evaluate.metrics import Result
from fishmj.evaluate.plots import STYLE
from fishmj.tasks.station_hold import spans

SPEEDS, SIDES = (0.1, 0.2, 0.3), {"downstream": 225, "upstream": 45}
STEPS = 24  # quadrature steps of the integral
WORK = 15  # cost of a trial with its derivatives, in trials without; measured
OWN = 2  # number of inputs (the target) before those of the fish's own state
MEANT = 3  # control steps averaged to one saved sample
METHODS = ("sensitivity", "integrated")


def slopes(policy: Policy, inputs: np.ndarray) -> np.ndarray:
    """Derivatives (B, J, N) of the actions with respect to the N observations, in their units, summed over remembered values."""
    return _by_observation(policy, policy.jacobian(inputs)[1]) / np.asarray(policy.meta["scale"])


def integrated(policy: Policy, inputs: np.ndarray) -> np.ndarray:
    """Integrated gradients (B, J, N) from zero input; without memory they sum over N to the action minus that at zero."""
    share = ((np.arange(STEPS) + 0.5) / STEPS).astype(inputs.dtype)
    points = (share[:, None, None] * inputs).reshape(-1, inputs.shape[1])
    mean = policy.jacobian(points)[1].reshape(STEPS, len(inputs), policy.n_act, -1).mean(0)
    return _by_observation(policy, mean * inputs[:, None])


def _by_observation(policy: Policy, columns: np.ndarray) -> np.ndarray:
    """Sums columns (B, J, width) of the network's input over the remembered values of each observation, (B, J, N)."""
    pair = policy.n_obs + policy.n_act
    return np.sum([columns[..., k * pair : k * pair + policy.n_obs] for k in range(policy.memory)], 0)


def shares(importance: np.ndarray) -> np.ndarray:
    """Importance (..., N) as shares of its sum."""
    return importance / np.maximum(importance.sum(-1, keepdims=True), 1e-12)


def rank_correlation(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Spearman's correlation (...,) over the last axis of two arrays (..., N)."""
    from scipy.stats import rankdata

    a, b = (rankdata(x, axis=-1) for x in (one, other))
    a, b = a - a.mean(-1, keepdims=True), b - b.mean(-1, keepdims=True)
    return np.sum(a * b, -1) / np.sqrt(np.maximum(np.sum(a * a, -1) * np.sum(b * b, -1), 1e-12))


def parts(setup: ExperimentSetup) -> list[ExperimentPart]:
    """Two directions at three speeds. Raises ConfigError: a controller that is not a policy of `fishmj.control.policy`."""
    brain = setup.brain
    if not isinstance(brain, LearnedController):
        raise ConfigError(f"experiment saliency: {brain.name} is not a policy, so it has no derivatives; take a trained policy")
    trials = setup.trials(speeds=SPEEDS, los_deg=list(SIDES.values()), repeats=setup.of(8, 5), duration=30)
    part = setup.part("policy", brain, trials, lambda result: saliency_row(result, brain.policy))
    return [part._replace(seconds=(WORK if setup.solver is None else 1) * part.seconds)]


def saliency_row(result: Result, policy: Policy) -> Row:
    """Replays the policy on its swims: mean shares over time for each condition, and the correlation of each trial."""
    sigma, steps = result.obs.std((0, 1)), []
    policy.reset()
    for k in range(result.obs.shape[1]):
        inputs = policy.inputs(result.obs[:, k])
        steps.append([np.abs(found(policy, inputs)).sum(1) for found in (slopes, integrated)])
        policy(result.obs[:, k])
    one, other = (np.stack(column, 1) for column in zip(*steps, strict=True))
    found = {"sensitivity": shares(one * sigma), "integrated": shares(other)}
    same = rank_correlation(*found.values())
    row: Row = {"correlation": rounded(same.mean(1), 4), "names": names_of(result.robot.n_joints), "maps": {}}
    degrees = np.round(np.degrees(result.trials.los))
    for side, los in SIDES.items():
        for speed in SPEEDS:
            some = (degrees == los) & (result.trials.speed == speed)
            means = {method: rounded(_block_means(x[some].mean(0)), 4) for method, x in found.items()}
            own = {f"own, {method}": rounded(x[some][..., OWN:].sum(-1).mean(1), 4) for method, x in found.items()}
            row["maps"][f"{side}, {speed:g} m/s"] = means | own | {"correlation": rounded(_block_means(same[some].mean(0)), 3)}
    return row


def _block_means(x: np.ndarray) -> np.ndarray:
    """Block means of x (T, ..) over MEANT control steps."""
    n = len(x) // MEANT
    return x[: n * MEANT].reshape(n, MEANT, *x.shape[1:]).mean(1)


def names_of(joints: int) -> list[str]:
    """Names of the inputs, as in the paper."""
    letters = {"target": "q", "velocity": "v", "yaw_rate": "w", "joint": "J", "joint_rate": "K"}
    return [letters[name] + (f"{i + 1}" if width > 1 else "") for name, width in spans(joints).items() for i in range(width)]


def groups_of(joints: int) -> dict[str, slice]:
    """Columns of target, own motion and joints."""
    return {"target": slice(0, 2), "own velocity": slice(2, 5), "joints": slice(5, 5 + 2 * joints)}


def findings(setup: ExperimentSetup, rows: dict[str, Row]) -> ExperimentFindings:
    """Share of the target and of the fish's own state, and the agreement of the methods."""
    row, joints = rows["policy"], setup.robot.n_joints
    found = [compared("rank correlation of both methods, mean over time", "one method", row["correlation"])]
    table = []
    for key, one in row["maps"].items():
        for method in METHODS:
            means = {name: f"{read(one[method])[:, c].sum(1).mean():.2f}" for name, c in groups_of(joints).items()}
            table.append({"condition": key, "method": method} | means)
    slow, fast = (f"{side}, {speed:g} m/s" for side, speed in (("downstream", SPEEDS[0]), ("upstream", SPEEDS[-1])))
    for method in METHODS:
        for key, paper in ((slow, "target dominates"), (fast, "own state grows substantially")):
            found.append(compared(f"share of own state, {method}, {key}", paper, row["maps"][key][f"own, {method}"], digits=2))
    notes = ["Sensitivity weighs what an input could change, integrated gradients what its present value does."]
    shown = [(picture(row, method), f"Share of each input over time, {method}.") for method in METHODS]
    shown.append((agreement(row), "Rank correlation of both methods over time, mean over trials."))
    return ExperimentFindings(found, shown, [("Mean share over 30 s", table)], notes)


@style(STYLE)
def picture(row: Row, method: str) -> bytes:
    """Maps of shares: rows directions, columns speeds."""
    figure, axes = canvas(len(SIDES), len(SPEEDS), (4.0 * len(SPEEDS), 3.0 * len(SIDES)), sharex=True, sharey=True)
    for axis, (key, one) in zip(axes.ravel(), row["maps"].items(), strict=True):
        share = read(one[method])
        seen = axis.imshow(share.T, aspect="auto", cmap="Blues", vmin=0, vmax=0.5, extent=(0, 30, len(row["names"]) - 0.5, -0.5))
        axis.set_yticks(range(len(row["names"])), labels=row["names"])
        axis.set_title(key)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    figure.colorbar(seen, ax=axes, label="share", shrink=0.8)
    return png(figure)


@style(STYLE)
def agreement(row: Row) -> bytes:
    """Rank correlation over time, by direction and speed."""
    figure, axes = canvas(1, len(SIDES), (9, 3.2), sharey=True)
    for axis, side in zip(axes[0], SIDES, strict=True):
        for speed, dash in zip(SPEEDS, ("-", "--", ":"), strict=True):
            values = read(row["maps"][f"{side}, {speed:g} m/s"]["correlation"])
            t = (np.arange(len(values)) + 0.5) * 30 / len(values)
            axis.plot(t, values, color=BLUE if side == "downstream" else VERMILION, linestyle=dash, label=f"{speed:g} m/s")
        axis.set(title=side, xlabel="time [s]", ylim=(-1, 1))
        axis.legend(frameon=False, loc="lower right")
    axes[0, 0].set_ylabel("rank correlation")
    return png(figure)


EXPERIMENT = PaperExperiment(
    "saliency",
    "17, saliency of the inputs",
    "importance of each input over time, by two methods",
    "the same maps of the observations that the tracker gave",
    parts,
    findings,
)
