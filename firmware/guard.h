/* What is wrong with servos and battery, as fault bits. Equal to fishmj/deploy/protocols/firmware_guard.py, which explains it.
 *
 *     FJ_STUCK     a joint under torque has been further than `far` from its target for `stuck` and moved less than `still`
 *     FJ_HOT       a servo is at `hot` or above
 *     FJ_VOLTAGE   each reading of the battery has been below `low` for `sag`; all joints get the bit
 *
 * It reports and does nothing else; the host decides what a fault ends.
 */
#ifndef FJ_GUARD_H
#define FJ_GUARD_H

#include "fishmj1.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    float far_off, still; /* rad */
    uint32_t stuck_us;
    float hot; /* deg C */
    float low; /* V */
    uint32_t sag_us;
} fj_bounds;

typedef struct {
    fj_bounds bounds;
    uint8_t joints;
    bool away[FJ_MAX_JOINTS]; /* off its target, since away_us, at place */
    uint64_t away_us[FJ_MAX_JOINTS];
    float place[FJ_MAX_JOINTS];
    bool low; /* the battery, since low_us */
    uint64_t low_us;
} fj_guard;

/* 10 deg, 1 deg, 0.3 s, 75 deg C, 6.4 V (two LiPo cells under load), 1 s. */
fj_bounds fj_default_bounds(void);

/* False where joints or bounds cannot be. */
bool fj_guard_init(fj_guard *it, uint8_t joints, fj_bounds bounds);

/* Add the faults found to fault[k]; once for each reading of the servos. target: rad, NULL where the servos have no torque.
 * measured: rad, nan where a servo is silent. temperature: deg C, or NULL. voltage: V, nan where it was not read. */
void fj_guard_check(fj_guard *it, uint64_t now_us, const float *target, const float *measured, const int8_t *temperature,
                    float voltage, uint8_t *fault);

#ifdef __cplusplus
}
#endif

#endif
