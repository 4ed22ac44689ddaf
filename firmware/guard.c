#include "guard.h"

#include <math.h>
#include <string.h>

#define DEGREE 0.01745329252f

static bool positive(float value) {
    return isfinite(value) && value > 0.0f;
}

static float apart(float a, float b) {
    return a < b ? b - a : a - b;
}

fj_bounds fj_default_bounds(void) {
    fj_bounds it = {10.0f * DEGREE, 1.0f * DEGREE, 300000u, 75.0f, 6.4f, 1000000u};
    return it;
}

bool fj_guard_init(fj_guard *it, uint8_t joints, fj_bounds bounds) {
    memset(it, 0, sizeof *it);
    if (joints < 1 || joints > FJ_MAX_JOINTS || bounds.stuck_us == 0 || bounds.sag_us == 0) return false;
    if (!positive(bounds.far_off) || !positive(bounds.still) || !positive(bounds.hot) || !positive(bounds.low)) return false;
    it->joints = joints;
    it->bounds = bounds;
    return true;
}

static bool is_stuck(fj_guard *it, uint8_t k, uint64_t now_us, const float *target, float angle) {
    if (target == NULL || !(apart(target[k], angle) > it->bounds.far_off)) { /* a silent servo is not known to be far */
        it->away[k] = false;
        return false;
    }
    if (!it->away[k] || apart(angle, it->place[k]) > it->bounds.still) {
        it->away[k] = true;
        it->away_us[k] = now_us;
        it->place[k] = angle;
    }
    return now_us - it->away_us[k] >= it->bounds.stuck_us;
}

void fj_guard_check(fj_guard *it, uint64_t now_us, const float *target, const float *measured, const int8_t *temperature,
                    float voltage, uint8_t *fault) {
    bool low = voltage < it->bounds.low; /* not nan */
    if (low && !it->low) it->low_us = now_us;
    it->low = low;
    bool sagged = low && now_us - it->low_us >= it->bounds.sag_us;
    for (uint8_t k = 0; k < it->joints; k++) {
        unsigned found = sagged ? FJ_VOLTAGE : 0;
        if (temperature != NULL && (float)temperature[k] >= it->bounds.hot) found |= FJ_HOT;
        if (is_stuck(it, k, now_us, target, measured[k])) found |= FJ_STUCK;
        fault[k] = (uint8_t)(fault[k] | found);
    }
}
