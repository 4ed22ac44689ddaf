"""Effects of the stage `measurement`: errors of camera, encoders and power meter."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def camera_scale_measure(xp, p, seen):
    """(x, y)' = (1 + s) (x, y)."""
    return seen._replace(x=(1.0 + p.scale) * seen.x, y=(1.0 + p.scale) * seen.y)


CAMERA_SCALE = Effect(
    name="camera_scale",
    stage="measurement",
    about="all lengths come out too long or too short: height of the camera, refraction",
    formula="(x, y)' = (1 + s) (x, y)",
    source="overhead camera 3 m above water: 1 to 4 %",
    parameters=(Parameter(name="scale", unit="1", low=-0.2, high=0.2, typical=(0.01, 0.04)),),
    shows=("position",),
    confusions=(Confusion("quadratic_drag", "a run of known length", ("out_and_back",)),),
    measure=camera_scale_measure,
    rank=2,
)


def camera_yaw_measure(xp, p, seen):
    """(x, y)' = R(d) (x, y), yaw' = yaw + d."""
    c, s = xp.cos(p.angle), xp.sin(p.angle)
    return seen._replace(x=c * seen.x - s * seen.y, y=c * seen.y + s * seen.x, yaw=seen.yaw + p.angle)


CAMERA_YAW = Effect(
    name="camera_yaw",
    stage="measurement",
    about="tracks and headings are turned as a whole; only an outside axis, such as the flow's, can tell",
    formula="(x, y)' = R(d) (x, y), yaw' = yaw + d",
    source="overhead camera on a beam: 1 to 5 deg",
    parameters=(Parameter(name="angle", unit="rad", low=-0.3, high=0.3, typical=(0.017, 0.087)),),
    handed=("angle",),
    shows=("position", "heading"),
    confusions=(
        Confusion("heading_marker_offset", "turns the track too", ("burst_and_coast", "gait")),
        Confusion(
            "steady_current", "a turned camera turns tracks, a current moves a resting fish", ("drift_east", "drift_north")
        ),
    ),
    measure=camera_yaw_measure,
    rank=3,
)


def heading_marker_offset_measure(xp, p, seen):
    """yaw' = yaw + d."""
    return seen._replace(yaw=seen.yaw + p.angle)


HEADING_MARKER_OFFSET = Effect(
    name="heading_marker_offset",
    stage="measurement",
    about="heading is off by a constant, the track is not: it seems to slip sideways",
    formula="yaw' = yaw + d",
    source="paper, red head and yellow neck by eye: 1 to 5 deg",
    parameters=(Parameter(name="angle", unit="rad", low=-0.3, high=0.3, typical=(0.017, 0.087)),),
    handed=("angle",),
    shows=("heading",),
    confusions=(
        Confusion("camera_yaw", "the track keeps its direction", ("tow_oblique", "gait")),
        Confusion("com_offset", "the same at rest", ("drift_east", "turn_left")),
    ),
    measure=heading_marker_offset_measure,
    rank=4,
)


def joint_scale_reading(p):
    """Encoder: (1 + s) angle."""
    return 1.0 + p.scale, 0.0


JOINT_SCALE = Effect(
    name="joint_scale",
    stage="measurement",
    about="counts per turn, or the ratio of the gears behind the encoder, are off",
    formula="reading = (1 + s) q",
    source="potentiometers 1 to 3 %; a wrong gear ratio 5 % and more",
    robot=RobotForm(
        site="joint",
        parameters=(Parameter(name="scale", unit="1", low=-0.3, high=0.3, typical=(0.01, 0.06)),),
        reading=joint_scale_reading,
        confusions=(Confusion("servo_gain", "hold known angles and read a protractor"),),
    ),
)


def lens_distortion_measure(xp, p, seen):
    """(x, y)' = (x, y) (1 + k_1 (x^2 + y^2)), about the tank's centre."""
    wide = 1.0 + p.k1 * (seen.x * seen.x + seen.y * seen.y)
    return seen._replace(x=wide * seen.x, y=wide * seen.y)


LENS_DISTORTION = Effect(
    name="lens_distortion",
    stage="measurement",
    about="lengths at the edge of the picture come out too long or too short",
    formula="(x, y)' = (x, y) (1 + k_1 r^2)",
    source="wide lenses: 1 to 2 % at the edge, 1.8 m from the centre",
    parameters=(Parameter(name="k1", unit="1/m2", low=-0.1, high=0.1, typical=(0.003, 0.01)),),
    shows=("position",),
    confusions=(
        Confusion("camera_scale", "none at the centre", ("station_left", "station_right", "out_and_back")),
        Confusion("wall_effect", "bends a resting grid", ("out_and_back",)),
    ),
    measure=lens_distortion_measure,
    rank=1,
)


def marker_offset_measure(xp, p, seen):
    """(x, y)' = (x, y) + d (cos yaw, sin yaw)."""
    return seen._replace(x=seen.x + p.x * xp.cos(seen.yaw), y=seen.y + p.x * xp.sin(seen.yaw))


MARKER_OFFSET = Effect(
    name="marker_offset",
    stage="measurement",
    about="the spot that the camera follows lies ahead of the reference point (x > 0) or behind: sway seems to go with yaw",
    formula="(x, y)' = (x, y) + d (cos yaw, sin yaw)",
    source="colour blobs on the head: 10 to 40 mm",
    parameters=(Parameter(name="x", unit="m", low=-0.15, high=0.15, typical=(0.01, 0.04), of="length"),),
    shows=("position",),
    confusions=(
        Confusion("camera_latency", "goes with heading, not with rate", ("spin", "turn_left")),
        Confusion("com_offset", "does not act on the motion", ("spin", "impulse")),
    ),
    measure=marker_offset_measure,
)


NOISE_LEVEL = Effect(
    name="noise_level",
    stage="measurement",
    about="white noise of all sensors is a factor above what their data sheet says",
    formula="sigma' = factor sigma",
    source="colour tracking: 1 to 3 mm, 0.5 to 1.5 deg",
    parameters=(Parameter(name="factor", unit="1", null=1.0, low=1.0, high=10.0, typical=(1.5, 3.0)),),
    unplanted="its sensors have noise of their own, for all runs alike",
    shows=("joint", "position", "heading", "power"),
    confusions=(Confusion("turbulence", "a resting log shows it", ("idle", "drift_east")),),
    stream="seen",
)


def power_offset_measure(xp, p, seen):
    """P' = P + P_0."""
    return seen._replace(power=seen.power + p.power)


POWER_OFFSET = Effect(
    name="power_offset",
    stage="measurement",
    about="radio, lamps or the meter itself add a constant to the power",
    formula="P' = P + P_0",
    source="idle draw of boards: 0.1 to 0.5 W",
    parameters=(Parameter(name="power", unit="W", low=-2.0, high=3.0, typical=(0.1, 0.5)),),
    shows=("power",),
    confusions=(Confusion("skin_stiffness", "the same at every angle", ("idle", "hold_angles")),),
    measure=power_offset_measure,
)
