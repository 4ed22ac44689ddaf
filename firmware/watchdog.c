#include "watchdog.h"

#include <math.h>
#include <string.h>

#define DEGREE 0.01745329252f
#define AT_ZERO 1e-3f /* rad, what rounding leaves of a target that is on its way to zero */

static float within(float value, float low, float high) {
    return value < low ? low : value > high ? high : value;
}

static bool times_are_sound(uint32_t hold_us, uint32_t neutral_us) {
    return hold_us > 0 && hold_us < neutral_us && neutral_us <= FJ_LONGEST_US;
}

/* Also false of nan. */
static bool within_of_zero(float value, float most) {
    return value >= -most && value <= most;
}

static bool positive(float value) {
    return isfinite(value) && value > 0.0f;
}

fj_limits fj_default_limits(void) {
    fj_limits it = {60.0f * DEGREE, 300.0f * DEGREE, 60.0f * DEGREE, 30.0f * DEGREE, 2.0f * DEGREE, 5000000u};
    return it;
}

bool fj_watchdog_init(fj_watchdog *it, uint8_t joints, fj_limits limits, uint32_t hold_us, uint32_t neutral_us) {
    memset(it, 0, sizeof *it);
    bool bounded = positive(limits.servo_range) && positive(limits.rate) && positive(limits.neutral_rate) && positive(limits.lead);
    bounded = bounded && positive(limits.near) && limits.rest_us > 0;
    if (joints < 1 || joints > FJ_MAX_JOINTS || !bounded || !times_are_sound(hold_us, neutral_us)) return false;
    it->joints = joints;
    it->limits = limits;
    it->state = FJ_IDLE;
    it->hold_us = hold_us;
    it->neutral_us = neutral_us;
    return true;
}

static void expire(fj_watchdog *it, uint64_t now_us) {
    uint64_t silent = now_us > it->heard_us ? now_us - it->heard_us : 0;
    if (it->state != FJ_ARMED && it->state != FJ_HOLD) return;
    if (silent >= it->neutral_us) it->state = FJ_NEUTRAL;
    else if (silent >= it->hold_us) it->state = FJ_HOLD;
}

bool fj_watchdog_arm(fj_watchdog *it, uint64_t now_us, uint32_t hold_us, uint32_t neutral_us, const float *measured) {
    if (it->state != FJ_IDLE || !times_are_sound(hold_us, neutral_us)) return false;
    for (uint8_t k = 0; k < it->joints; k++) {
        if (!within_of_zero(measured[k], it->limits.servo_range + it->limits.near)) return false;
    }
    for (uint8_t k = 0; k < it->joints; k++) {
        it->target[k] = it->goal[k] = within(measured[k], -it->limits.servo_range, it->limits.servo_range);
        it->speed[k] = it->limits.rate;
    }
    it->hold_us = hold_us;
    it->neutral_us = neutral_us;
    it->heard_us = it->stepped_us = now_us;
    it->resting = it->rested = false;
    it->state = FJ_ARMED;
    return true;
}

void fj_watchdog_disarm(fj_watchdog *it) {
    it->state = FJ_IDLE;
}

void fj_watchdog_fault(fj_watchdog *it) {
    if (it->state == FJ_ARMED || it->state == FJ_HOLD) it->state = FJ_NEUTRAL;
}

bool fj_watchdog_command(fj_watchdog *it, uint64_t now_us, uint8_t joints, const float *joint, const float *speed) {
    expire(it, now_us);
    if ((it->state != FJ_ARMED && it->state != FJ_HOLD) || joints != it->joints) return false;
    for (uint8_t k = 0; k < joints; k++) {
        if (!isfinite(joint[k]) || (speed != NULL && !positive(speed[k]))) {
            fj_watchdog_fault(it);
            return false;
        }
    }
    for (uint8_t k = 0; k < joints; k++) {
        it->goal[k] = within(joint[k], -it->limits.servo_range, it->limits.servo_range);
        it->speed[k] = speed != NULL && speed[k] < it->limits.rate ? speed[k] : it->limits.rate;
    }
    it->heard_us = now_us;
    it->state = FJ_ARMED;
    return true;
}

/* Whether NEUTRAL has done what it can; once it has, it stays so until somebody arms anew. */
static void rest(fj_watchdog *it, uint64_t now_us, const float *measured) {
    if (!it->resting) it->rest_from_us = now_us;
    it->resting = true;
    bool there = true;
    for (uint8_t k = 0; k < it->joints; k++) {
        there = there && within_of_zero(it->target[k], AT_ZERO) && within_of_zero(measured[k], it->limits.near);
    }
    it->rested = it->rested || there || (now_us > it->rest_from_us && now_us - it->rest_from_us >= it->limits.rest_us);
}

bool fj_watchdog_step(fj_watchdog *it, uint64_t now_us, const float *measured) {
    expire(it, now_us);
    uint64_t passed = now_us > it->stepped_us ? now_us - it->stepped_us : 0;
    float dt = (float)(passed < FJ_LATE_US ? passed : FJ_LATE_US) * 1e-6f;
    it->stepped_us = now_us;
    if (it->state == FJ_IDLE) return false;
    if (it->state == FJ_NEUTRAL) rest(it, now_us, measured);
    if (it->rested) return false;
    for (uint8_t k = 0; k < it->joints; k++) {
        float before = it->target[k], goal = it->goal[k], speed = it->speed[k];
        if (it->state == FJ_HOLD) goal = before;
        if (it->state == FJ_NEUTRAL) {
            goal = 0.0f;
            speed = it->limits.neutral_rate;
        }
        float angle = before + within(goal - before, -speed * dt, speed * dt);
        if (within_of_zero(measured[k], FJ_MAX_ANGLE)) angle = within(angle, measured[k] - it->limits.lead, measured[k] + it->limits.lead);
        it->target[k] = within(angle, -it->limits.servo_range, it->limits.servo_range);
    }
    return true;
}
