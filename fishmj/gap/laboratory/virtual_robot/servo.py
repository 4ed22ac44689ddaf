"""Bus servos: firmware at 200 Hz, motor dynamics in between, and dry friction with stick-slip.

    firmware   drive = clip(g e - g_d de/dt, +-limit),  e = aim - angle in whole counts
    bridge     V = drive R/K V_battery / V_nominal
    motor      i' = (V - K w - R i) / L,  torque K i         exactly over a step, back-EMF taken implicitly
    friction   |p| <= h F,  w+ = w* + W p,  p opposes w+     Coulomb's law on impulses: a joint at rest stays locked up to F

The aim is the latest command after gain error, counts, clamp, motion-time ramp (restarted by each new command) and rate limit.
"""

from math import exp

from fishmj.gap.laboratory.virtual_robot.loop_compiler import compiled

SWEEPS = 4  # of the friction solver per joint; three joints converge in a few


@compiled
def counts(value, step):
    """Value rounded to whole steps."""
    return round(value / step) * step


@compiled
def shaped(motor, s, j, command):
    """Target of joint j: its command after gain error, counts, clamp, ramp and rate limit."""
    c = command * (1.0 + motor.command_gain)
    if motor.command_step > 0.0:
        c = counts(c, motor.command_step)
    c = counts(min(max(c, -motor.range), motor.range), motor.step)
    if motor.move_time > 0.0:
        if c != s.ramp[j, 1]:
            s.ramp[j, 0], s.ramp[j, 1], s.ramp[j, 2] = s.aim[j], c, s.clock[0]
        part = min((s.clock[0] + motor.period - s.ramp[j, 2]) / motor.move_time, 1.0)
        c = s.ramp[j, 0] + part * (c - s.ramp[j, 0])
    if motor.command_slowness > 0.0:
        most = motor.period / motor.command_slowness
        c = s.aim[j] + min(max(c - s.aim[j], -most), most)
    return c


@compiled
def firmware(body, motor, odd, zero, s):
    """Runs one tick of all servos: reads angles, writes s.aim and s.drive."""
    time = s.clock[0]
    if odd.reset > 0.0 and s.battery[1] > odd.reset_current and time > s.clock[2] + 1.0:
        s.clock[2] = time + odd.reset
    gain, rate_gain = motor.gain * (1.0 + motor.gain_error), motor.rate_gain * (1.0 + motor.gain_error)
    worn = exp(-motor.derating * time) if motor.derating > 0.0 else 1.0
    for j in range(len(body.joints)):
        s.aim[j] = shaped(motor, s, j, s.goal[j])
        angle = s.z[3 + j] - s.z[2 + j] - zero[j]
        if odd.eccentric != 0.0:
            angle += odd.eccentric * _sine(3.0 * angle)
        angle = counts(angle, motor.step)
        error = s.aim[j] - angle
        if abs(error) < motor.deadband:
            error = 0.0
        request = gain * error - rate_gain * (angle - s.seen[j]) / motor.period
        rate = s.rate[3 + j] - s.rate[2 + j]
        if motor.slowness > 0.0 and request * rate > 0.0:  # a steeper torque-speed line through the same stall torque
            spare = motor.torque * max(1.0 - abs(rate) * motor.slowness, 0.0)
            most = spare + motor.constant * motor.constant / motor.resistance * min(abs(rate), 1.0 / motor.slowness)
            request = min(max(request, -most), most)
        s.seen[j] = angle
        s.drive[j] = min(max(request, -motor.limit), motor.limit) * worn
        if time < s.clock[2]:
            s.drive[j] = 0.0
    if odd.crosstalk != 0.0:
        last, before = len(body.joints) - 1, 0.0
        for j in range(len(body.joints)):
            mine, after = s.drive[j], s.drive[min(j + 1, last)] if j < last else 0.0
            s.drive[j] += odd.crosstalk * (before + after)
            before = mine


@compiled
def _sine(x):
    """Sine by its power series on [-pi, pi], without a library call."""
    x2 = x * x
    return x * (1.0 - x2 / 6.0 * (1.0 - x2 / 20.0 * (1.0 - x2 / 42.0 * (1.0 - x2 / 72.0))))


@compiled
def motor_torque(motor, s, j, rate, fresh, h):
    """(torque N m, implicit damping N m s/rad) of motor j. fresh = 1 - e^(-h R/L). Advances current and gap."""
    volts = s.drive[j] * motor.resistance / motor.constant * (s.battery[0] / motor.nominal_voltage)
    held = (1.0 - fresh) * s.amps[j] + fresh * volts / motor.resistance
    damping = fresh * motor.constant * motor.constant / motor.resistance
    torque = motor.constant * held - damping * rate
    if motor.half_gap > 0.0:
        gap = s.gap[j]
        pushing = (gap >= motor.half_gap and torque > 0.0) or (gap <= -motor.half_gap and torque < 0.0)
        if not pushing:  # the motor crosses the backlash at no-load speed, without torque
            gap += h * (volts / motor.constant - rate)
            s.gap[j] = min(max(gap, -motor.half_gap), motor.half_gap)
            s.amps[j] = 0.0
            return 0.0, 0.0
    s.amps[j] = held - damping * rate / motor.constant
    return torque, damping


@compiled
def spring_torque(motor, odd, water, zero, s, j, angle, rate, h):
    """Torque of skin, water and bad teeth on joint j. Advances the skin's memory."""
    torque = -motor.skin * angle - odd.cubic * angle * angle * angle - water.joint * water.active * rate * abs(rate)
    if motor.branch > 0.0:
        s.branch[j] += h * (rate - s.branch[j] / motor.branch_time)
        torque -= motor.branch * s.branch[j]
    if odd.bouc_torque > 0.0:  # Bouc-Wen, n = 2
        z = s.bouc[j] / odd.bouc_angle
        s.bouc[j] += h * rate * (1.0 - z * z * (1.0 if rate * z > 0.0 else 0.0))
        torque -= odd.bouc_torque * s.bouc[j] / odd.bouc_angle
    if odd.tooth > 0.0:
        off = (angle - odd.tooth_angle) / 0.03
        torque -= odd.tooth * off * 2.3 * exp(-off * off)
    return torque


@compiled
def friction_bound(motor, rate, torque):
    """Largest friction torque of a gear train, N m."""
    bound = motor.dry + motor.coulomb + motor.load * abs(torque)
    if motor.stribeck > 0.0:
        slow = rate / motor.stribeck_speed
        bound += motor.stribeck * exp(-slow * slow)
    return bound


@compiled
def stick_slip(w, mobility, bound, impulse, joints):
    """Friction impulses (J,) by projected Gauss-Seidel; w (J,) rates without friction, mobility (J, J), bound (J,) N m s."""
    for _ in range(SWEEPS * joints):
        moved = 0.0
        for j in range(joints):
            rate = w[j]
            for k in range(joints):
                rate += mobility[j, k] * impulse[k]
            wanted = impulse[j] - rate / mobility[j, j]
            wanted = min(max(wanted, -bound[j]), bound[j])
            moved += abs(wanted - impulse[j])
            impulse[j] = wanted
        if moved < 1e-12:
            break


@compiled
def battery(body, motor, s, h):
    """Advances terminal voltage and current of the common battery by one step."""
    amps = motor.idle / motor.nominal_voltage
    for j in range(len(body.joints)):
        amps += max(s.drive[j] / motor.torque * s.amps[j], 0.0)  # no current flows back into the battery
    s.battery[1] = amps
    s.battery[2] += amps * h
    open_circuit = motor.voltage - motor.droop * s.battery[2] / motor.capacity
    sag = open_circuit - motor.source_resistance * max(amps, 0.0)
    s.battery[0] += (sag - s.battery[0]) * 0.5  # bridge capacitors smooth over two steps
