/* The robot between its radio and its servos: gate, watchdog, guard and datagrams put together. Three calls a bus tick:
 *
 *     fj_robot_hear     for each datagram that came in; sends back what it answers
 *     fj_robot_act      targets for the servos, or torque off
 *     fj_robot_report   one packet of telemetry
 *
 * The board's own part is a clock in us, a UDP socket, the servo bus (lx_bus.h) and I2C (ina226.h): see README.md.
 */
#ifndef FJ_ROBOT_H
#define FJ_ROBOT_H

#include "fishmj1.h"
#include "guard.h"
#include "sequence.h"
#include "watchdog.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    fj_info info;
    fj_watchdog watchdog;
    fj_guard guard;
    fj_gate gate;
    bool torque;   /* what fj_robot_act said last */
    uint32_t sent; /* number of the newest datagram of the robot */
    uint32_t bad;  /* datagrams that were none of the host's */
    bool commanded;
    uint32_t echo; /* number and time of the newest command that was taken */
    uint64_t echo_time_us;
    float last[FJ_MAX_JOINTS]; /* rad, where each joint was when its servo last answered */
} fj_robot;

/* info: joints, watchdog times before any ARM, names, servo ids, hashes; servo_range is that of the limits. False where they cannot
 * be, as an info is that was not filled in: the board must not go on then. it->guard.bounds may be changed afterwards. */
bool fj_robot_init(fj_robot *it, const fj_info *info, fj_limits limits);

/* A datagram that arrived. measured: rad, nan where a servo is silent. Returns bytes of `answer` to send back, 0 for none. */
size_t fj_robot_hear(fj_robot *it, const uint8_t *data, size_t size, uint64_t now_us, const float *measured, uint8_t *answer,
                     size_t room);

/* Targets in it->watchdog.target; false: take the torque off. */
bool fj_robot_act(fj_robot *it, uint64_t now_us, const float *measured);

/* Telemetry. The caller fills in what is measured: joint, FJ_HAS_... of the rest with its values. The guard adds its fault bits. A
 * joint that is no angle (nan, beyond +- pi) is sent with its last angle and FJ_NO_REPLY; a voltage or a current beyond the datagram's
 * range as the end of it; without both where one is nan. So the host hears something whatever was measured. Returns its size, 0
 * where `out` has no room. */
size_t fj_robot_report(fj_robot *it, uint64_t now_us, fj_telemetry *measured, uint8_t *out, size_t room);

#ifdef __cplusplus
}
#endif

#endif
