"""Pictures of a judgement, as PNG bytes: speeds, turns, a free run, forces over angle of attack."""

import io

import numpy as np

from fishmj.hydro_fit.fit.prediction_interval import CHANNELS, half_width, means
from fishmj.hydro_fit.fit.rollout import recorded
from fishmj.hydro_fit.free_swims import GAITS, FreeSwims

LABELS = {"speed": "speed along the body [m/s]", "yaw_rate": "yaw rate [rad/s]", "power": "servo power [W]"}


def against(swum: FreeSwims, band: dict[str, list[float]]) -> bytes:
    """Means of every free swim, model over record, with the 90 % band."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(CHANNELS), figsize=(12, 3.8), layout="constrained")
    got, seen = means(swum.track, swum.fleet), means(recorded(swum.fleet), swum.fleet)
    gait = np.array([r.meta["block"] in GAITS for r in swum.records])
    for axis, channel in zip(axes, CHANNELS, strict=True):
        x, y = getattr(seen, channel), getattr(got, channel)
        half = half_width(channel, got, swum.members, band)
        for part, colour, name in ((gait, "#20639b", "gaits"), (~gait, "#c0502e", "other")):
            if part.any():
                axis.errorbar(x[part], y[part], half[part], fmt="o", ms=3.5, lw=0.8, color=colour, label=name)
        ends = [min(x.min(), y.min()), max(x.max(), y.max())]
        axis.plot(ends, ends, lw=0.8, color="#555")
        axis.set_xlabel("flow solver")
        axis.set_title(LABELS[channel], fontsize=10)
    axes[0].set_ylabel("model")
    axes[0].legend(fontsize=8)
    return _png(figure)


def freeruns(swum: FreeSwims, count: int = 6) -> bytes:
    """Paths of some free runs beside the recorded ones."""
    import matplotlib.pyplot as plt

    which = np.linspace(0, len(swum.cruise.q) - 1, min(count, len(swum.cruise.q))).astype(int)
    figure, axes = plt.subplots(2, (len(which) + 1) // 2, figsize=(12, 5.5), layout="constrained", squeeze=False)
    for axis, b in zip(axes.ravel(), which, strict=False):
        stop = int(swum.cruise.mask[b].sum())
        axis.plot(*swum.cruise.q[b, : stop + 1, :2].T, color="#555", label="flow solver")
        axis.plot(*swum.cruise_track.q[b, :stop, :2].T, color="#20639b", lw=1.2, label="model")
        axis.set_aspect("equal", adjustable="datalim")
        axis.tick_params(labelsize=7)
    axes[0, 0].legend(fontsize=8)
    figure.suptitle("free runs, m", fontsize=10)
    return _png(figure)


def force_map(points: dict[str, np.ndarray]) -> bytes:
    """Drag and lateral force of held, straight and bent fish over the angle of attack, solver and model."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(12, 3.8), layout="constrained")
    titles = ("force along x, N", "force along y, N", "yaw moment, N m")
    for axis, name, title in zip(axes, ("x", "y", "m"), titles, strict=True):
        axis.plot(np.degrees(points["attack"]), points[f"seen_{name}"], "o", ms=3, color="#555", label="flow solver")
        axis.plot(np.degrees(points["attack"]), points[f"got_{name}"], "x", ms=4, color="#20639b", label="model")
        axis.set_xlabel("angle of attack [deg]")
        axis.set_title(title, fontsize=10)
    axes[0].legend(fontsize=8)
    return _png(figure)


def _png(figure) -> bytes:
    import matplotlib.pyplot as plt

    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110)
    plt.close(figure)
    return data.getvalue()
