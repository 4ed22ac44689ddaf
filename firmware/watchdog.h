/* The robot's last guard: what it does when nobody commands it. Equal to fishmj/deploy/protocols/watchdog.py, which explains it.
 *
 *     IDLE -- arm --> ARMED -- no command for `hold` --> HOLD -- none for `neutral` --> NEUTRAL
 *                       ^------------ a command -----------'
 *     ARMED, HOLD -- fault --> NEUTRAL          any state -- disarm --> IDLE
 *
 * NEUTRAL brings the joints to zero, then takes the torque off; at the latest after `rest`.
 *
 * The caller gives the time, in us of one clock that never goes back, and calls fj_watchdog_step at each bus tick.
 */
#ifndef FJ_WATCHDOG_H
#define FJ_WATCHDOG_H

#include "fishmj1.h"

#ifdef __cplusplus
extern "C" {
#endif

#define FJ_LONGEST_US 2000000u /* that a robot may be asked to bear without a command */
#define FJ_LATE_US 100000u     /* the longest step: a late loop is not caught up */

typedef struct {
    float servo_range;  /* rad, targets stay within +- this */
    float rate;         /* rad/s, of targets that follow commands */
    float neutral_rate; /* rad/s, of joints on their way to zero */
    float lead;         /* rad, of the target before the measured joint */
    float near;         /* rad, a joint so close to its place is there */
    uint32_t rest_us;   /* in NEUTRAL, after which the torque goes off wherever the joints are */
} fj_limits;

typedef struct {
    fj_limits limits;
    uint8_t joints, state;
    uint32_t hold_us, neutral_us;
    bool resting, rested; /* NEUTRAL has begun to count, at rest_from_us; it has taken the torque off */
    uint64_t heard_us, stepped_us, rest_from_us;
    float target[FJ_MAX_JOINTS], goal[FJ_MAX_JOINTS], speed[FJ_MAX_JOINTS];
} fj_watchdog;

/* 60 deg, 300 deg/s (a LX-824's no-load speed), 60 deg/s, 30 deg, 2 deg, 5 s. */
fj_limits fj_default_limits(void);

/* False where joints, limits or times cannot be. The state is FJ_IDLE. */
bool fj_watchdog_init(fj_watchdog *it, uint8_t joints, fj_limits limits, uint32_t hold_us, uint32_t neutral_us);

/* FJ_IDLE -> FJ_ARMED, the target where the joints are; false, and nothing changes, where that cannot be: a joint silent, or
 * beyond the range by more than `near`. */
bool fj_watchdog_arm(fj_watchdog *it, uint64_t now_us, uint32_t hold_us, uint32_t neutral_us, const float *measured);
void fj_watchdog_disarm(fj_watchdog *it);
void fj_watchdog_fault(fj_watchdog *it);

/* Take joint angles, rad, and speeds, rad/s or NULL. False where they were not taken. */
bool fj_watchdog_command(fj_watchdog *it, uint64_t now_us, uint8_t joints, const float *joint, const float *speed);

/* Targets of the servos in it->target; false in FJ_IDLE and at the end of FJ_NEUTRAL: take their torque off. measured: rad, nan
 * where a servo is silent. */
bool fj_watchdog_step(fj_watchdog *it, uint64_t now_us, const float *measured);

#ifdef __cplusplus
}
#endif

#endif
