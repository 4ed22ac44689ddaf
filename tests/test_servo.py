"""The position servo is the LX-824: MuJoCo's DC motor with the same nameplate, driven by the same PD voltage, moves alike."""

import mujoco
import numpy as np
import pytest

from fishmj import mjcf
from fishmj.mjcf.model import build_spec
from fishmj.mjcf.servos import on_the_bus
from fishmj.water.dynamics import planar_chain

DT = 2.5e-4  # s
STEP = np.radians(30)


def servo_in_air(robot):
    """The built fish, in air, as (step(target) -> (angle, torque, power) of every joint)."""
    model = mjcf.build(robot)
    model.opt.timestep = DT
    data, sw = mujoco.MjData(model), planar_chain.nominal(robot)

    def step(target):
        v = data.qvel.copy()
        data.ctrl[:] = target
        mujoco.mj_step(model, data)
        drive = data.actuator_force.copy()
        return data.qpos[3:].copy(), drive - sw.kb * v[3:], planar_chain.electrical_power(np, sw, v, drive)

    return step, data


def dc_motor_in_air(robot):
    """The same fish with MuJoCo's `dcmotor` on every joint and the PD law as a voltage: V = R/K clip(kp e - kv w, +-T)."""
    s = robot.servo
    spec = build_spec(robot)
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    spec.compile()
    nameplate = f"{s.voltage} {s.torque} {s.speed_no_load}"
    motors = "".join(f'<dcmotor joint="j{i + 1}" nominal="{nameplate}"/>' for i in range(robot.n_joints))
    spec = mujoco.MjSpec.from_string(spec.to_xml().replace("</mujoco>", f"<actuator>{motors}</actuator></mujoco>"))
    for joint in spec.joints:
        joint.damping = [0, 0, 0]
    spec.option.timestep, spec.option.integrator = DT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model = spec.compile()
    data = mujoco.MjData(model)
    resistance, constant = model.actuator_gainprm[0, :2]

    def step(target):
        demand = np.clip(s.kp * (target - data.qpos[3:]) - s.kv * data.qvel[3:], -s.torque, s.torque)
        data.ctrl[:] = demand * resistance / constant
        mujoco.mj_step(model, data)
        torque = data.actuator_force.copy()
        return data.qpos[3:].copy(), torque, np.maximum(data.ctrl * torque / constant, 0).sum()

    return step, data


def run(step, command, seconds):
    rows = [step(command(i * DT)) for i in range(round(seconds / DT))]
    return [np.array(column) for column in zip(*rows, strict=True)]


@pytest.mark.parametrize(
    "command",
    [lambda t: np.array([STEP, -STEP, STEP]), lambda t: STEP * np.sin(2 * np.pi * 2 * t - np.arange(3))],
    ids=["step", "2 Hz sine, saturating"],
)
def test_servo_equals_the_dc_motor(command):
    """Angle to 1e-4 deg, torque to 1e-5 of stall, electrical energy to 1e-4: both treat the back-EMF implicitly."""
    robot = mjcf.load_robot("fish")
    angle, torque, power = run(servo_in_air(robot)[0], command, 0.6)
    angle_dc, torque_dc, power_dc = run(dc_motor_in_air(robot)[0], command, 0.6)
    assert np.abs(angle - angle_dc).max() < np.radians(1e-4)
    assert np.abs(torque - torque_dc).max() < 1e-5 * robot.servo.torque
    assert power.sum() == pytest.approx(power_dc.sum(), rel=1e-4)
    assert power.max() > 1.0  # the case is not idle


def lone_servo(inertia):
    """One servo on a flywheel: (model, data)."""
    robot = mjcf.load_robot("fish")
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="wheel")
    body.mass, body.inertia, body.explicitinertial = 0.1, [inertia] * 3, True
    mjcf.model._add_servo(spec, body, robot, "j1")
    spec.option.timestep = DT
    model = spec.compile()
    return model, mujoco.MjData(model)


def test_thirty_degree_step_rises_in_an_eighth_of_a_second():
    """0 -> 27 deg of a 30 deg step: 0.115 s with the inertia of the tail link in air, 0.125 s with ten times as much."""
    for inertia, expected in ((8e-4, 0.115), (1e-2, 0.125)):
        model, data = lone_servo(inertia)
        data.ctrl[:] = STEP
        while data.qpos[0] < 0.9 * STEP and data.time < 1:
            mujoco.mj_step(model, data)
        assert data.time == pytest.approx(expected, abs=0.002)


def test_no_load_speed():
    """Full drive against nothing but back-EMF: 5.236 rad/s within 1 %."""
    model, data = lone_servo(8e-4)
    model.actuator_ctrllimited[:] = 0
    data.ctrl[:] = 100.0
    for _ in range(round(0.5 / DT)):
        mujoco.mj_step(model, data)
    assert data.qvel[0] == pytest.approx(mjcf.load_robot("fish").servo.speed_no_load, rel=0.01)


def test_stall_torque_is_the_limit():
    model, data = lone_servo(8e-4)
    data.ctrl[:] = 1.0
    mujoco.mj_forward(model, data)
    assert data.actuator_force[0] == pytest.approx(1.667)


def test_command_is_clamped_to_the_range():
    model, data = lone_servo(8e-4)
    data.ctrl[:] = 3.0
    for _ in range(round(1.0 / DT)):
        mujoco.mj_step(model, data)
    assert data.qpos[0] == pytest.approx(np.pi / 3, abs=1e-3)


def test_bus_command_is_quantised_and_clamped():
    servo = mjcf.load_robot("fish").servo
    command = on_the_bus(servo, [0.1, -2.0, 2.0])
    lsb = np.radians(0.24)
    np.testing.assert_allclose(command / lsb, np.round(command / lsb), atol=1e-9)
    assert abs(command[0] - 0.1) <= lsb / 2
    np.testing.assert_allclose(np.degrees(command[1:]), [-60, 60], atol=0.13)


def test_power_formula_is_voltage_times_current():
    """P = V i with V = drive R / K, i = (V - K w) / R, K^2 / R = kb; braking gives nothing back."""
    servo = mjcf.load_robot("fish").servo
    sw = planar_chain.nominal(mjcf.load_robot("fish"))
    kb = servo.kb
    rng = np.random.default_rng(0)
    for drive, rate in rng.normal(size=(50, 2)) * [1.0, 3.0]:
        constant = servo.voltage / servo.speed_no_load
        resistance = constant**2 / kb
        volt = drive * resistance / constant
        expected = max(volt * (volt - constant * rate) / resistance, 0.0)
        power = planar_chain.electrical_power(np, sw, [0, 0, 0, rate, 0, 0], [drive, 0.0, 0.0])
        assert power == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert kb == pytest.approx(servo.constant**2 / servo.resistance, rel=2e-3)
