"""Commands arrive later than the model believes."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm

EFFECT = Effect(
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
