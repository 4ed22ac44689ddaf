"""One step ahead of the flow solver: what the servos' torque will be, as a line in the joint's rate.

    tau_j ~ a_j - D_j w_j      over one step of the water, a_j = P_j / dt + D_j w_j*

The solver finds fish and water together and needs each joint's torque in that form. Firmware, bridge, gears and friction of the
second robot run 1 ms at a time; they are sent ahead through the step with the second robot's own water as a guess of what the
joints will do. P_j is the impulse that they gave, friction included, w_j* the rate that they ended with, D_j the mean slope of
back-EMF and grease. Where the solver's water moves the joint otherwise, the slope answers, implicitly. A joint that friction
held all the way is not moved at all (`held`): its row of the solve is w_j = 0.
"""

from math import exp

from fishmj.virtual_robot.chain import assemble, factor, push_joint, solve
from fishmj.virtual_robot.loop import H, blow, rub, write
from fishmj.virtual_robot.numba_entry import entry
from fishmj.virtual_robot.servo import battery, firmware, friction_bound, motor_torque, spring_torque
from fishmj.virtual_robot.water import friction_speed

IMPULSE, SLOPE, END, FASTEST, TORQUE = range(5)  # columns of `law`
STILL = 1e-8  # rad/s: friction holds


@entry
def ahead(body, water, motor, tank, odd, zero, gust, arrivals, commands, s, record, work, law):
    """Send the servos len(record) milliseconds ahead; moves `s` on, its places and rates only as a guess.

    Args:
        as `virtual_robot.loop.advance`; a joint's rotor counts in the guess and belongs into the solver's mass matrix, too.
        law: (3, 5) written: impulse N m s, slope summed over time N m s^2/rad, rate at the end, greatest rate rad/s, scratch.
    """
    A, f, mobility, columns, bound, w, stream, sprung = work
    fresh = 1.0 - exp(-H / motor.inductive_time)
    nxt = 0
    law[:, :] = 0.0
    for step in range(record.shape[0]):
        time = s.clock[0]
        while nxt < arrivals.shape[0] and arrivals[nxt] <= time + 1e-9:
            for j in range(3):
                s.goal[j] = commands[nxt, j]
            nxt += 1
        blow(gust, tank, time, stream)
        if time >= s.clock[1] - 1e-9:
            firmware(motor, odd, zero, s)
            friction_speed(body, s, stream)
            s.clock[1] += motor.period
        assemble(body, water, tank, odd, s, stream, A, f, H)
        for j in range(3):
            angle, rate = s.z[3 + j] - s.z[2 + j], s.rate[3 + j] - s.rate[2 + j]
            torque, damping = motor_torque(motor, s, j, rate, fresh, H)
            bound[j] = H * friction_bound(motor, rate, torque)
            slow = motor.viscous + motor.damping
            sprung[j] = spring_torque(motor, odd, water, zero, s, j, angle, rate, H)
            push_joint(A, f, j, torque + sprung[j] - slow * rate, motor.armature + H * (damping + slow))
            law[j, TORQUE] = torque + sprung[j] - slow * rate
            law[j, END] = H * (damping + slow)
        battery(motor, s, H)
        write(record, step, s, zero)
        factor(A)
        for a in range(6):
            f[a] *= H
        solve(A, f)
        rub(A, f, s, mobility, columns, bound, w)
        for j in range(3):
            change = f[3 + j] - f[2 + j]
            law[j, IMPULSE] += H * law[j, TORQUE] - law[j, END] * change + s.stuck[j]
            law[j, SLOPE] += law[j, END]
            law[j, FASTEST] = max(law[j, FASTEST], abs(s.rate[3 + j] - s.rate[2 + j] + change))
        for a in range(6):
            s.rate[a] += f[a]
            s.z[a] += H * s.rate[a]
        s.clock[0] = time + H
    for j in range(3):
        law[j, END] = s.rate[3 + j] - s.rate[2 + j]


@entry
def forces(body, water, tank, odd, gust, s, stream, A, f, h):
    """Mass matrix A (6, 6), lower half, and forces f (6,) of fish and water as the second robot has them, without its joints."""
    blow(gust, tank, s.clock[0], stream)
    assemble(body, water, tank, odd, s, stream, A, f, h)
