"""Effects of the stage `timing`: delays, clocks, packets."""

import numpy as np

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm

CAMERA_LATENCY = Effect(
    name="camera_latency",
    stage="timing",
    about="exposure, transfer and tracking take longer: position and heading lag, the joints do not",
    formula="pose_log(t) = pose(t - delay)",
    source="paper, calibration of latency; cameras over USB have 30 to 100 ms",
    parameters=(Parameter(name="delay", unit="s", low=0.0, high=0.25, typical=(0.02, 0.1)),),
    shows=("position", "heading"),
    native="sensor delay",
    confusions=(
        Confusion("clock_offset", "only an event seen by both clocks", ("impulse",)),
        Confusion("marker_offset", "a marker's error goes with heading, not with rate", ("spin",)),
        Confusion("command_latency", "the joints do not lag", ("chirp", "turn_left")),
    ),
    delays={"pose": "delay"},
)


CLOCK_DRIFT = Effect(
    name="clock_drift",
    stage="timing",
    about="two computers without a time server stamp commands and readings",
    formula="t_reading = r t",
    source="quartz: 10 to 100 ppm; microcontrollers with a resonator: 0.1 to 0.5 %",
    drifts={"joint": "rate"},
    robot=RobotForm(
        site="robot",
        parameters=(Parameter(name="rate", unit="1", null=1.0, low=0.98, high=1.02, typical=(1.0005, 1.004)),),
        confusions=(Confusion("command_latency", "the delay grows along a record: make it longer"),),
    ),
)


CLOCK_OFFSET = Effect(
    name="clock_offset",
    stage="timing",
    about="poses are stamped by a clock that is off and drifts against that of the commands",
    formula="t_stamp = t + offset + (drift - 1) t",
    source="computers without a time server: 0 to 50 ms, 10 to 40 ppm",
    parameters=(
        Parameter(name="offset", unit="s", low=-0.2, high=0.2, typical=(0.01, 0.05)),
        Parameter(name="drift", unit="1", null=1.0, low=0.999, high=1.001, typical=(1.00001, 1.00004), about="rate of the clock"),
    ),
    shows=("position", "heading"),
    confusions=(
        Confusion(
            "camera_latency", "only an event seen by both clocks; drift shows from start to end of a session", ("impulse",)
        ),
        Confusion("joint_sensor_delay", "joints keep their phase to the commands", ("chirp",)),
    ),
    delays={"pose": "offset"},
    drifts={"pose": "drift"},
)


PHASES = 8  # over which a mean is taken


def command_hold_command(p, t, c):
    """Mean over the moments at which the bus may take a command, which no log tells: each waits from none to a whole period."""
    stamps = t[:, None] + p.period * (np.arange(PHASES) + 0.5) / PHASES
    order = np.argsort(stamps, axis=None, kind="stable")
    jumps = np.repeat(np.diff(c, prepend=c[0]) / PHASES, PHASES)
    return stamps.ravel()[order], c[0] + np.cumsum(jumps[order])


def command_hold_simulated(p, t, c, first=0.0):
    """Every `period`, the latest command; between them the earlier one holds. first: when, as a share of the period."""
    if p.period <= 0.1 * np.median(np.diff(t)):
        return t, c
    ticks = np.arange(t[0] + (first - 1.0) * p.period, t[-1] + p.period, p.period)
    return ticks, c[np.maximum(np.searchsorted(t, ticks + 1e-9, side="right") - 1, 0)]


def command_hold_scatter(rng, p, t, c):
    """One draw for a whole record."""
    return command_hold_simulated(p, t, c, rng.uniform())


COMMAND_HOLD = Effect(
    name="command_hold",
    stage="timing",
    about="the bus or the firmware takes a command only every so often, and holds it",
    formula="c'(t) = c(T floor(t / T))",
    source="bus servos: 5 to 40 ms",
    robot=RobotForm(
        site="robot",
        parameters=(Parameter(name="period", unit="s", low=0.0, high=0.2, typical=(0.008, 0.04)),),
        command=command_hold_command,
        scatter=command_hold_scatter,
        simulated=command_hold_simulated,
        confusions=(Confusion("command_latency", "a hold makes steps: command a fast ramp and read the torque"),),
    ),
)


COMMAND_LATENCY = Effect(
    name="command_latency",
    stage="timing",
    about="radio and firmware hold a command back, so joints and body both lag behind it",
    formula="c_servo(t) = c(t - delay)",
    source="paper, calibration of latency; wireless links have 10 to 80 ms",
    parameters=(Parameter(name="delay", unit="s", low=0.0, high=0.25, typical=(0.01, 0.06)),),
    shows=("joint", "position", "heading", "power"),
    native="actuator delay",
    confusions=(
        Confusion("joint_sensor_delay", "the body lags too, not only the joint channel", ("chirp", "turn_left")),
        Confusion("servo_gain", "a delay's phase grows with frequency without changing amplitude", ("chirp",)),
    ),
    delays={"command": "delay"},
    robot=RobotForm(site="robot", parameters=(Parameter(name="delay", unit="s", low=0.0, high=0.2, typical=(0.003, 0.03)),)),
)


JOINT_SENSOR_DELAY = Effect(
    name="joint_sensor_delay",
    stage="timing",
    about="joint angles are read over a slow bus: the joint channel lags, the body does not",
    formula="joint_log(t) = joint(t - delay)",
    source="half duplex bus at 115200 baud: 5 to 60 ms",
    parameters=(Parameter(name="delay", unit="s", low=0.0, high=0.25, typical=(0.01, 0.06)),),
    shows=("joint",),
    native="sensor delay",
    confusions=(
        Confusion("command_latency", "the body does not lag", ("chirp", "turn_left")),
        Confusion("viscous_friction", "phase grows with frequency, power is the same", ("chirp",)),
        Confusion("clock_offset", "camera and power keep their phase to the commands", ("impulse",)),
    ),
    delays={"joint": "delay"},
    robot=RobotForm(site="robot", parameters=(Parameter(name="delay", unit="s", low=0.0, high=0.2, typical=(0.003, 0.03)),)),
)


def latency_jitter_command(p, t, c):
    """Mean over the delays: the mean of copies of the record, each with another quantile of the delay.

    P(delay < x) = prod_j (1 - exp(-(x + j T) / sigma)): packets T apart stay in order. A row with the command before is none.
    """
    new = np.append(True, np.diff(c) != 0.0)
    t, c = t[new], c[new]
    copies, apart = 8, max(np.median(np.diff(t)), 0.01 * p.sigma) if len(t) > 1 else 1.0
    x = p.sigma * np.linspace(0.0, 12.0, 600)
    below = np.prod(-np.expm1(-(x[:, None] + apart * np.arange(min(8.0 * p.sigma / apart, 800.0) + 1)) / p.sigma), 1)
    stamps = t[:, None] + np.interp((np.arange(copies) + 0.5) / copies, below, x)
    order = np.argsort(stamps, axis=None, kind="stable")
    jumps = np.repeat(np.diff(c, prepend=c[0]) / copies, copies)
    return stamps.ravel()[order], c[0] + np.cumsum(jumps[order])


def latency_jitter_scatter(rng, p, t, c):
    """t'_k = max(t_k + d_k, t'_{k-1}), d_k exponential of mean sigma: late, never early, in order."""
    new = np.append(True, np.diff(c) != 0.0)
    return np.maximum.accumulate(t[new] + p.sigma * rng.standard_exponential(new.sum())), c[new]


LATENCY_JITTER = Effect(
    name="latency_jitter",
    stage="timing",
    about="each packet has its own delay: scatter between replicates that grows with the speed of the command",
    formula="t_arrival = t + delay + d, d exponential of mean and deviation sigma",
    source="wireless links: 2 to 20 ms with a long tail",
    parameters=(Parameter(name="sigma", unit="s", low=0.0, high=0.1, typical=(0.002, 0.02)),),
    shows=("joint", "position", "heading"),
    confusions=(
        Confusion("packet_loss", "no plateaus; stamps at both ends", ("sine",)),
        Confusion("turbulence", "shows in the joints", ("sine", "gait")),
    ),
    robot=RobotForm(
        site="robot",
        parameters=(Parameter(name="sigma", unit="s", low=0.0, high=0.1, typical=(0.003, 0.03)),),
        command=latency_jitter_command,
        scatter=latency_jitter_scatter,
        confusions=(
            Confusion("command_latency", "commands spread, too: compare the stamps at both ends"),
            Confusion("packet_loss", "no plateaus: compare the stamps at both ends"),
            Confusion("joint_sensor_delay", "commands spread, too: compare the stamps at both ends"),
        ),
    ),
    stream="command",
)


def packet_loss_command(p, t, c):
    """Mean over the losses: c'_k = (1 - p) c_k + p c'_{k-1}. A row with the command before is no packet."""
    from scipy.signal import lfilter

    new = np.append(True, np.diff(c) != 0.0)
    t, c = t[new], c[new]
    return t, lfilter([1.0 - p.probability], [1.0, -p.probability], c, zi=[p.probability * c[0]])[0]


def packet_loss_scatter(rng, p, t, c):
    """Each command but the first is lost with the probability p: the one before it holds."""
    new = np.append(True, np.diff(c) != 0.0)
    t, c = t[new], c[new]
    kept = rng.uniform(size=len(t)) >= p.probability
    kept[:1] = True
    return t, c[np.maximum.accumulate(np.where(kept, np.arange(len(kept)), 0))]


PACKET_LOSS = Effect(
    name="packet_loss",
    stage="timing",
    about="a lost command leaves the one before it standing: plateaus in the joints",
    formula="c'_k = c_k with probability 1 - p, else c'_{k-1}",
    source="wireless links: 0.1 to 5 %",
    parameters=(Parameter(name="probability", unit="1", low=0.0, high=0.9, typical=(0.005, 0.05)),),
    shows=("joint", "position", "heading"),
    confusions=(
        Confusion("latency_jitter", "isolated plateaus of whole packets", ("sine",)),
        Confusion("command_quantisation", "plateaus at random times, also in fast motion", ("sine",)),
    ),
    robot=RobotForm(
        site="robot",
        parameters=(Parameter(name="probability", unit="1", low=0.0, high=0.9, typical=(0.02, 0.3)),),
        command=packet_loss_command,
        scatter=packet_loss_scatter,
        confusions=(
            Confusion("command_latency", "plateaus at random times: compare the stamps at both ends"),
            Confusion("command_hold", "plateaus at random times: compare the stamps at both ends"),
        ),
    ),
    stream="command",
)


VELOCITY_FILTER = Effect(
    name="velocity_filter",
    stage="timing",
    about="velocities come from a longer filter than the model's: a group delay that only feedback and logged velocities feel",
    formula="velocity_log(t) = velocity(t - time)",
    source="straight-line fits and low passes on camera poses: 40 to 150 ms of group delay",
    parameters=(Parameter(name="time", unit="s", low=0.0, high=0.5, typical=(0.04, 0.15)),),
    confusions=(
        Confusion("camera_latency", "logged velocity against the differences of logged poses", ("burst_and_coast", "turn_left")),
    ),
    delays={"velocity": "time"},
)
