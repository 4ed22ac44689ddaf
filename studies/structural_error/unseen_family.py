"""Upper limit for a healthy robot of an unseen family, from robots of a few families.

    y_fr = log |z|^2 / m = mu + b_f + e_fr     family f of F, robot r of R; b, e normal; each by widths without its family
    y    of a robot of a new family: about mean y with the variance V = (1 + 1/F) B + (1 - 1/R) W
    B    variance of the families' means; W: mean variance within a family
    level = exp(mean y + t_(share, nu) V^1/2),    nu by Satterthwaite (1946)

The robots of one family are alike: F families are F draws of the distance of another water, for any number of robots in each. A
quantile over all the robots therefore says little about the next family. This is the prediction limit of a one-way random model
(Lin & Liao 2008, "Prediction intervals for general balanced linear random models").
"""

from collections.abc import Sequence

import numpy as np
from scipy.stats import hmean
from scipy.stats import t as student

from fishmj.base.errors import ConfigError

FEWEST = 2  # families; robots of each


def level(families: Sequence[Sequence[float]], share: float) -> float:
    """|z|^2 / m that `share` of the robots of a new family stay below.

    Args:
        families: |z|^2 / m (R_f,) of the healthy robots of each, all > 0; for unequal counts R is the harmonic mean.

    Raises:
        ConfigError: fewer than two families, or a family of fewer than two robots.
    """
    logs = [np.log(np.asarray(values, float)) for values in families]
    if len(logs) < FEWEST or min(map(len, logs)) < FEWEST:
        counts = ", ".join(str(len(values)) for values in logs) or "none"
        raise ConfigError(f"structural_error: {len(logs)} families of {counts} robots; expected {FEWEST} of {FEWEST} at least")
    count, robots = len(logs), float(hmean([len(values) for values in logs]))
    means = np.array([values.mean() for values in logs])
    between = (1.0 + 1.0 / count) * float(np.var(means, ddof=1))
    within = (1.0 - 1.0 / robots) * float(np.mean([np.var(values, ddof=1) for values in logs]))
    freedom = sum(len(values) - 1 for values in logs)
    variance = between + within
    if variance == 0.0:
        return float(np.exp(means.mean()))
    nu = variance**2 / (between**2 / (count - 1) + within**2 / freedom)
    return float(np.exp(means.mean() + student.ppf(share, nu) * np.sqrt(variance)))
