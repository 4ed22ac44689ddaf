"""What the water remembers where a piece of a record begins: the tail's attachment and the wake, filled by the recorded motion.

A model walks along the records at the bus tick, its forces not acting on the fish but noted: the judge of forces needs the same.
"""

from typing import NamedTuple

import numpy as np

from fishmj.dynamics import planar_chain, strip_forces
from fishmj.hydro_fit.fit.regression_rows import RegressionRows
from fishmj.hydro_fit.fit.training_windows import links_of
from fishmj.water import residual_hooks, residual_network


class WarmUp(NamedTuple):
    """A model along M recorded ticks."""

    force: np.ndarray  # (3, N, M) of the residual, N and N m about the link's origin
    memory: np.ndarray  # (M, WAKES + 2) before each tick
    spread: np.ndarray  # (M,) variance between the members' coefficients
    outside: np.ndarray  # (M,) 1 where a link was outside the fitted range


def warm_up(
    ch: planar_chain.Chain, rows: RegressionRows, c: strip_forces.Coefficients, learnt: residual_hooks.Residual, tick: float
) -> WarmUp:
    """Along all records side by side, each from rest."""
    spans, n = rows.spans(), ch.n
    longest, count = max(span.stop - span.start for span in spans), len(spans)
    wide = np.zeros((3, n, longest, count))
    for j, span in enumerate(spans):
        for f, value in enumerate((rows.u, rows.w, rows.omega)):
            wide[f, :, : span.stop - span.start, j] = value[1, :, span]
    memory = [np.zeros(count) for _ in residual_hooks.at_rest()]
    kept: list[tuple] = []
    for k in range(longest):
        motion = planar_chain.Links([], [], list(wide[2, :, k]), list(wide[0, :, k]), list(wide[1, :, k]), [])
        hooks = residual_hooks.LearnedResidual(np, ch, learnt, memory)
        force = np.array(hooks.advance(ch.strips, c, motion, tick))  # (N, 3, R)
        new = [value + np.zeros(count) for value in hooks.end(ch, None, None, None)]
        kept.append((force.transpose(1, 0, 2), np.array(memory), hooks.spread + np.zeros(count), new[-1] - memory[-1]))
        memory = new
    force, before, spread, outside = (np.stack(column, -2) for column in zip(*kept, strict=True))
    line = lambda a: np.concatenate([a[..., : s.stop - s.start, j] for j, s in enumerate(spans)], -1)
    return WarmUp(line(force), line(before).T, line(spread), line(outside))


def features(ch: planar_chain.Chain, rows: RegressionRows) -> tuple[np.ndarray, np.ndarray]:
    """xi (M, N, 5) and V_i (M, N) of every row: what the fitted range is made from."""
    p, k = residual_network.panels(ch), links_of(rows)
    xi, speed = residual_hooks.near(np, p, k, residual_network.motion(np, p, k))
    return np.array(xi).transpose(2, 0, 1), np.array(speed).T
