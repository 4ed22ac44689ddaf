"""Prescribed swimming movements: joint angles as functions of time, with a smooth start.

j_i(t) = bias_i + r(t) A_i sin(2 pi f t - i lag),   r = (3 - 2 x) x^2, x = min(t / ramp, 1)
"""

from dataclasses import dataclass
from math import pi, radians

import numpy as np

from fishmj.calib import constant
from fishmj.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Gait:
    """A travelling wave over J joints: frequency Hz, amplitude, lag from joint to joint and bias in rad, ramp s.

    amplitude and bias are one number or one a joint.
    """

    joints: int = 3
    frequency: float = 1.0
    amplitude: float | tuple[float, ...] = radians(30.0)
    lag: float = radians(60.0)
    bias: float | tuple[float, ...] = 0.0
    ramp: float = 1.0

    def __post_init__(self):
        for name in ("amplitude", "bias"):
            if np.size(getattr(self, name)) not in (1, self.joints):
                raise ConfigError(f"gait: {name} has {np.size(getattr(self, name))} values; expected 1 or {self.joints}")
        if not (self.frequency > 0 and self.ramp >= 0):
            raise ConfigError(f"gait: frequency = {self.frequency} Hz must be positive, ramp = {self.ramp} s not negative")

    @classmethod
    def of_the_paper(cls, second: bool = True) -> "Gait":
        """The calibration swim: 1 Hz, 30 deg on all joints; `second` with 60 deg lag, otherwise in phase."""
        lag = constant("calibration", "phase_lag_second_deg" if second else "phase_lag_deg")[0]
        amplitude = radians(constant("calibration", "amplitude_deg"))
        return cls(frequency=constant("calibration", "frequency"), amplitude=amplitude, lag=radians(lag))

    def __call__(self, t: float) -> np.ndarray:
        """Joint angles (J,) at time t, rad."""
        x = min(t / self.ramp, 1.0) if self.ramp > 0 else 1.0
        wave = np.sin(2 * pi * self.frequency * t - self.lag * np.arange(self.joints))
        return np.broadcast_to(self.bias, self.joints) + x * x * (3 - 2 * x) * np.broadcast_to(self.amplitude, self.joints) * wave
