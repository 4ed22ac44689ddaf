"""Error of a launch's velocity: a log may state `push_sigma` beside `push`, one standard deviation of each.

    S += sum_k c_k c_k^T        c_k = residual at push + sigma_k e_k less that at push: surge, sway [m/s], yaw rate [rad/s]

A carriage's own speed needs none. A velocity from the camera is known to a centimetre a second, and its error
grows along the path.
"""

import numpy as np

from fishmj.gap.records.records import Record, ResidualLayout


def factors(model, records: list[Record], layout: ResidualLayout) -> np.ndarray:
    """(K, m) c of every record that states the error of its launch."""
    row = np.asarray(getattr(model, "nothing", model.null))[None]
    found = [np.zeros((0, layout.size))]
    for i, record in enumerate(records):
        sigma = np.asarray(record.push_sigma, float)
        if not sigma.any():
            continue
        others = [record._replace(push=record.push + step) for step in np.diag(sigma)]
        alone = ResidualLayout([record])
        seen = np.nan_to_num([alone.residuals([one])[0] for one in model.predict([record, *others], row)])
        moved = np.zeros((len(sigma), layout.size))
        moved[:, layout.record == i] = seen[1:] - seen[0]
        found.append(moved)
    return np.concatenate(found)
