"""Identifiability of the parameters of a fit, from the curvature of its objective.

    H = J^T W J  (data alone),   S = (H + P^-1)^-1  (with the prior P)
A parameter is `on bound` if it ends at a hard bound, `not identified` if the data shrink its prior by less than `SHRINK`, and
else `identified`. Its partner is the parameter with which it trades: the one of the largest correlation under a weak prior.
"""

from dataclasses import asdict, dataclass

import numpy as np

from fishmj.water.prior import Prior

SHRINK = 0.5  # posterior over prior standard deviation
NEAR = 1e-3  # of the distance between the bounds
WEAK = 100.0  # prior standard deviations for the correlations
CLOSE = 0.7  # correlation from which a partner is named


@dataclass(frozen=True)
class IdentifiedParameter:
    """Fit result of one parameter."""

    name: str
    value: float
    sd: float
    prior: float
    prior_sd: float
    status: str  # identified | on bound | not identified
    partner: str  # "" where none
    correlation: float


@dataclass(frozen=True)
class Identified:
    """All parameters of one fit; `condition`: of H in units of the prior."""

    parameters: tuple[IdentifiedParameter, ...]
    condition: float

    def table(self) -> dict:
        """Plain numbers, for TOML and JSON."""
        return {"condition": float(self.condition), "parameters": {p.name: asdict(p) for p in self.parameters}}


def identify(prior: Prior, value: np.ndarray, hessian: np.ndarray) -> Identified:
    """Judges a fit.

    Args:
        value: (P,) fitted values.
        hessian: (P, P) of the data's half squared error, in honest units (noise and its correlation in time divided out).
    """
    scaled = hessian * np.outer(prior.sd, prior.sd)
    size = len(value)
    posterior = np.linalg.inv(scaled + np.eye(size))
    weak = np.linalg.inv(scaled + np.eye(size) / WEAK**2)
    spread = np.sqrt(np.diag(weak))
    correlation = weak / np.outer(spread, spread) - np.eye(size)
    eigen = np.linalg.eigvalsh(scaled)
    room = NEAR * np.where(np.isfinite(prior.high - prior.low), prior.high - prior.low, 0.0)
    found = []
    for i, name in enumerate(prior.names):
        j = int(np.argmax(np.abs(correlation[i]))) if size > 1 else i
        trades = size > 1 and abs(correlation[i, j]) >= CLOSE
        shrunk = float(np.sqrt(posterior[i, i]))
        bound = value[i] <= prior.low[i] + room[i] or value[i] >= prior.high[i] - room[i]
        status = "on bound" if bound else "not identified" if shrunk > SHRINK else "identified"
        doubt = status != "identified"
        found.append(
            IdentifiedParameter(
                name=name,
                value=float(value[i]),
                sd=shrunk * float(prior.sd[i]),
                prior=float(prior.mean[i]),
                prior_sd=float(prior.sd[i]),
                status=status,
                partner=prior.names[j] if trades or (doubt and size > 1) else "",
                correlation=float(correlation[i, j]) if size > 1 else 0.0,
            )
        )
    return Identified(tuple(found), float(eigen[-1] / max(eigen[0], 1e-12)))
