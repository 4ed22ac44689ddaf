"""Central pattern generator: one travelling wave for every model-based controller, 50 Hz commands, continuous in phase.

    phi' = 2 pi f,     c_i = min(1, 3 / J) A sin(phi - lag_i) + bias / J      [rad], i = 1..J

Frequency f, amplitude A and bias move towards their goals at a limited rate, so that commands never jump. The bias is summed
over the joints; a positive one bends the tail to the right, which turns the fish to the right.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fishmj.base import console
from fishmj.engines import ticks_per
from fishmj.mjcf.description import Robot


@dataclass(frozen=True, kw_only=True)
class Rates:
    """Rate limits of frequency, amplitude and bias."""

    frequency: float  # Hz/s
    amplitude: float  # rad/s
    bias: float  # rad/s


class Cpg:
    """B oscillators.

    Args:
        robot: defines bus ticks and command path. With `hold` a control step repeats the wave's value at its middle; a beat
            above half the control rate then aliases, which is warned of once for each robot.
        lag: (J,) rad behind the phase.
        rates: limits on the rates of f, A and bias.
    """

    def __init__(self, robot: Robot, lag, rates: Rates):
        self.lag, self.rates = np.asarray(lag, float), rates
        self.share = min(1.0, 3 / len(self.lag))  # more than three joints share the bend of three
        self.ticks = ticks_per(robot)[1]
        self.dt = robot.timing.bus_dt
        self.hold = robot.timing.command_path == "hold"
        self.name, self.control_dt = robot.name, robot.timing.control_dt
        self.reset(0)

    def reset(self, n: int) -> None:
        """Starts n oscillators at rest: no amplitude, no bias, phase zero."""
        self.phase, self.frequency, self.amplitude, self.bias = (np.zeros(n) for _ in range(4))

    def __call__(self, frequency, amplitude, bias) -> np.ndarray:
        """The next control step's commands, (B, T, J) rad, for goals f [Hz], A [rad] and bias [rad], each (B,)."""
        f = self._towards(self.frequency, frequency, self.rates.frequency)
        if self.hold and np.max(f, initial=0.0) > 0.5 / self.control_dt:
            self._note_alias(float(f.max()))
        a = self._towards(self.amplitude, amplitude, self.rates.amplitude)
        b = self._towards(self.bias, bias, self.rates.bias)
        phase = self.phase[:, None] + 2 * np.pi * self.dt * np.cumsum(f, 1)
        wave = self.share * a[..., None] * np.sin(phase[..., None] - self.lag) + b[..., None] / len(self.lag)
        self.phase, self.frequency, self.amplitude, self.bias = phase[:, -1] % (2 * np.pi), f[:, -1], a[:, -1], b[:, -1]
        return np.repeat(wave[:, [self.ticks // 2 - 1]], self.ticks, 1) if self.hold else wave

    def _note_alias(self, beat: float) -> None:
        """Warns once for each robot and control rate that sampling aliases the beat."""
        rate = 1 / self.control_dt
        seen = abs(beat - round(beat / rate) * rate)
        console.warn_once(
            f"robot {self.name!r}: a beat of {beat:.3g} Hz on command_path 'hold' aliases to {seen:.3g} Hz at the joints;"
            f" expected at most {0.5 * rate:.3g} Hz, half the control rate; take path 'linear' or a slower beat",
            ("beat", self.name, rate),
        )

    def _towards(self, now, goal, rate: float):
        """Ramp (B, T) from `now` towards `goal` with at most this rate; values at the ends of the ticks."""
        most = rate * self.ticks * self.dt
        share = (np.arange(self.ticks) + 1) / self.ticks
        return now[:, None] + np.clip(goal - now, -most, most)[:, None] * share


def cpg_of(robot: Robot, gait: Mapping) -> Cpg:
    """The oscillators of a robot's gait (`gait_table.gait_of`)."""
    amplitude, bias = np.radians(gait["amplitude_rate"]), np.radians(gait["bias_rate"])
    return Cpg(robot, gait["lag"], Rates(frequency=gait["frequency_rate"], amplitude=amplitude, bias=bias))
