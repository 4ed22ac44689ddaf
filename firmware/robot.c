#include "robot.h"

#include <math.h>
#include <string.h>

bool fj_robot_init(fj_robot *it, const fj_info *info, fj_limits limits) {
    uint8_t spare[FJ_MAX_BYTES];
    memset(it, 0, sizeof *it);
    it->info = *info;
    it->info.servo_range = limits.servo_range;
    if (!fj_watchdog_init(&it->watchdog, info->joints, limits, info->hold_us, info->neutral_us)) return false;
    if (!fj_guard_init(&it->guard, info->joints, fj_default_bounds())) return false;
    return fj_encode_info(0, 0, &it->info, spare, sizeof spare) > 0; /* what INFO cannot say now it could not say later */
}

size_t fj_robot_hear(fj_robot *it, const uint8_t *data, size_t size, uint64_t now_us, const float *measured, uint8_t *answer,
                     size_t room) {
    fj_message message;
    if (fj_decode(data, size, &message) != FJ_OK) {
        it->bad++;
        return 0;
    }
    if (!fj_gate_accept(&it->gate, message.seq, message.time_us)) return 0;
    switch (message.kind) {
        case FJ_COMMAND:
            if (fj_watchdog_command(&it->watchdog, now_us, message.joints, message.joint, message.has_speed ? message.speed : NULL)) {
                it->commanded = true;
                it->echo = message.seq;
                it->echo_time_us = message.time_us;
            }
            return 0;
        case FJ_DISARM:
            fj_watchdog_disarm(&it->watchdog);
            return 0;
        case FJ_ARM:
            (void)fj_watchdog_arm(&it->watchdog, now_us, message.hold_us, message.neutral_us, measured);
            break; /* the answer and the state in telemetry say whether it is armed, and with which times */
        default:
            break;
    }
    it->info.hold_us = it->watchdog.hold_us;
    it->info.neutral_us = it->watchdog.neutral_us;
    return fj_encode_info(++it->sent, now_us, &it->info, answer, room);
}

bool fj_robot_act(fj_robot *it, uint64_t now_us, const float *measured) {
    it->torque = fj_watchdog_step(&it->watchdog, now_us, measured);
    return it->torque;
}

static float within(float value, float low, float high) {
    return value < low ? low : value > high ? high : value;
}

/* What the datagram can say of the battery. */
static void bound_power(fj_telemetry *it) {
    if (isnan(it->voltage) || isnan(it->current)) it->has = (uint8_t)(it->has & ~(unsigned)FJ_HAS_POWER);
    it->voltage = within(it->voltage, 0.0f, FJ_MAX_VOLTAGE);
    it->current = within(it->current, -FJ_MAX_CURRENT, FJ_MAX_CURRENT);
}

size_t fj_robot_report(fj_robot *it, uint64_t now_us, fj_telemetry *measured, uint8_t *out, size_t room) {
    measured->seq = ++it->sent;
    measured->time_us = now_us;
    measured->joints = it->info.joints;
    measured->state = it->watchdog.state;
    measured->has = (uint8_t)((measured->has & FJ_HAS_ALL & ~(unsigned)FJ_HAS_ECHO) | (it->commanded ? FJ_HAS_ECHO : 0u));
    measured->echo = it->echo;
    measured->echo_time_us = it->echo_time_us;
    bound_power(measured);
    for (uint8_t k = 0; k < it->info.joints; k++) {
        measured->fault[k] = (uint8_t)((measured->has & FJ_HAS_FAULT) != 0 ? measured->fault[k] & FJ_FAULTS : 0u);
        if (!(measured->joint[k] >= -FJ_MAX_ANGLE && measured->joint[k] <= FJ_MAX_ANGLE)) measured->joint[k] = NAN;
    }
    bool power = (measured->has & FJ_HAS_POWER) != 0, heat = (measured->has & FJ_HAS_TEMPERATURE) != 0;
    fj_guard_check(&it->guard, now_us, it->torque ? it->watchdog.target : NULL, measured->joint, heat ? measured->temperature : NULL,
                   power ? measured->voltage : NAN, measured->fault);
    for (uint8_t k = 0; k < it->info.joints; k++) {
        if (isfinite(measured->joint[k])) {
            it->last[k] = measured->joint[k];
        } else {
            measured->joint[k] = it->last[k];
            measured->fault[k] |= FJ_NO_REPLY;
        }
    }
    measured->has |= FJ_HAS_FAULT;
    return fj_encode_telemetry(measured, out, room);
}
