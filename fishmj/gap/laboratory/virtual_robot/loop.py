"""Main loop of the second robot: firmware, water, joints, solve and friction in steps of one millisecond."""

from math import exp

from fishmj.gap.laboratory.virtual_robot.chain import assemble, factor, hang, push_joint, solve
from fishmj.gap.laboratory.virtual_robot.loop_compiler import compiled, entry
from fishmj.gap.laboratory.virtual_robot.servo import battery, firmware, friction_bound, motor_torque, spring_torque, stick_slip
from fishmj.gap.laboratory.virtual_robot.water import friction_speed

H = 0.001  # s, physics step
GUST = 0.02  # s, spacing of the gust table


@entry
def advance(body, water, motor, tank, odd, air, anchor, zero, gust, arrivals, commands, s, record, work):
    """Runs len(record) steps; writes the state before each step to record (T, 8 + 4 J), columns as in `simulate.columns`.

    arrivals (K,): ascending times [s] at which commands (K, J) [rad] reach the servos. gust (G, 2): time-varying water velocity
    [m/s] every GUST s from t = 0, linear in between. work: `simulate.workspace`.
    """
    A, f, mobility, columns, bound, w, stream, sprung = work
    fresh = 1.0 - exp(-H / motor.inductive_time)
    nxt = 0
    for step in range(record.shape[0]):
        time = s.clock[0]
        while nxt < arrivals.shape[0] and arrivals[nxt] <= time + 1e-9:
            for j in range(len(body.joints)):
                s.goal[j] = commands[nxt, j]
            nxt += 1
        blow(gust, tank, time, stream)
        if time >= s.clock[1] - 1e-9:
            firmware(body, motor, odd, zero, s)
            friction_speed(body, s, stream)
            s.clock[1] += motor.period
        assemble(body, water, tank, odd, s, stream, A, f, H)
        if water.active == 0.0:
            hang(air, s, anchor, f)
        for j in range(len(body.joints)):
            angle, rate = s.z[3 + j] - s.z[2 + j], s.rate[3 + j] - s.rate[2 + j]
            torque, damping = motor_torque(motor, s, j, rate, fresh, H)
            bound[j] = H * friction_bound(motor, rate, torque)
            slow = motor.viscous + motor.damping
            sprung[j] = spring_torque(motor, odd, water, zero, s, j, angle, rate, H)
            push_joint(A, f, j, torque + sprung[j] - slow * rate, motor.armature + H * (damping + slow))
        battery(body, motor, s, H)
        write(body, record, step, s)
        factor(body, A)
        for a in range(len(body.links) + 2):
            f[a] *= H
        solve(body, A, f)
        rub(body, A, f, s, mobility, columns, bound, w)
        for a in range(len(body.links) + 2):
            s.rate[a] += f[a]
            s.z[a] += H * s.rate[a]
        s.clock[0] = time + H


@compiled
def blow(gust, tank, time, stream):
    """Sets stream: uniform water velocity and its time derivative, from stream, current and gusts; the last gust remains."""
    k = min(int(time / GUST), gust.shape[0] - 2)
    part = min(time / GUST - k, 1.0)
    for a in range(2):
        stream[2 + a] = (gust[k + 1, a] - gust[k, a]) / GUST if part < 1.0 else 0.0
        stream[a] = gust[k, a] + part * (gust[k + 1, a] - gust[k, a])
    stream[0] += tank.flow_x + tank.current_x
    stream[1] += tank.flow_y + tank.current_y


@compiled
def rub(body, L, dv, s, mobility, columns, bound, w):
    """Adds the effect of dry friction to the velocity change dv; L: Cholesky factor of the mass matrix."""
    joints, places = len(body.joints), len(body.links) + 2
    for j in range(joints):
        for a in range(places):
            columns[j, a] = 0.0
        columns[j, 2 + j], columns[j, 3 + j] = -1.0, 1.0
        solve(body, L, columns[j])
        w[j] = s.rate[3 + j] + dv[3 + j] - s.rate[2 + j] - dv[2 + j]
    for j in range(joints):
        for k in range(joints):
            mobility[j, k] = columns[k, 3 + j] - columns[k, 2 + j]
    stick_slip(w, mobility, bound, s.stuck, joints)
    for j in range(joints):
        for a in range(places):
            dv[a] += columns[j, a] * s.stuck[j]


@compiled
def write(body, record, step, s):
    """Writes one row of `simulate.columns`."""
    joints = len(body.joints)
    for a in range(3):
        record[step, a] = s.z[a]
        record[step, 3 + a] = s.rate[a]
    volts = 6 + 2 * joints
    for j in range(joints):
        record[step, 6 + j] = s.z[3 + j] - s.z[2 + j]
        record[step, 6 + joints + j] = s.rate[3 + j] - s.rate[2 + j]
        record[step, volts + 2 + j] = s.aim[j]
        record[step, volts + 2 + joints + j] = s.drive[j]
    record[step, volts], record[step, volts + 1] = s.battery[0], s.battery[1]
