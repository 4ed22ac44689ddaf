#include "servo_counts.h"

#include <math.h>

#define SPAN 1000.0f
#define CENTRE 500
#define RAD_PER_COUNT 0.00418879020f /* 0.24 deg */
#define MOST_TIME 30000.0f           /* ms */

static int32_t nearest(float value) { /* of a value that is not negative */
    return (int32_t)(value + 0.5f);
}

int32_t lx_counts(float angle, float zero) {
    float exact = (float)CENTRE + (angle + zero) / RAD_PER_COUNT;
    if (!isfinite(exact)) return -1;
    return nearest(exact < 0.0f ? 0.0f : exact > SPAN ? SPAN : exact);
}

float lx_angle(int32_t position, float zero) {
    return (float)(position - CENTRE) * RAD_PER_COUNT - zero;
}

int32_t lx_move_time(float distance, float speed) {
    if (!isfinite(distance) || !isfinite(speed) || !(speed > 0.0f)) return -1;
    float time = (distance < 0.0f ? -distance : distance) / speed * 1000.0f;
    return nearest(time < MOST_TIME ? time : MOST_TIME);
}
