/* Servo counts and radians. Equal to fishmj/deploy/protocols/servo_counts.py: 0 to 1000 counts are 0 to 240 deg, 500 is the middle.
 *
 * zero: rad, where the servo stands, from its middle, when the joint is straight. A servo that turns the other way round gets the
 * angle with the other sign: lx_counts(-angle, zero), and -lx_angle(counts, zero).
 */
#ifndef LX_SERVO_COUNTS_H
#define LX_SERVO_COUNTS_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* 0 to 1000, the position nearest to a joint angle, rad; beyond the servo's travel the end of it. -1 where it is not finite. */
int32_t lx_counts(float angle, float zero);

/* rad of a position; servos report some counts below 0 and above 1000, too. */
float lx_angle(int32_t position, float zero);

/* ms of a move over `distance`, rad, at `speed`, rad/s; 30000 at most. -1 where the speed is not positive. */
int32_t lx_move_time(float distance, float speed);

#ifdef __cplusplus
}
#endif

#endif
