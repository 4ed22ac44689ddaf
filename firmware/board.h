/* The robot's program on a board: servos, battery and radio through eight functions that the board supplies (fj_hal).
 *
 *     fj_board_init     once
 *     fj_board_tick     every 20 ms: asks the servos, hears the host, moves, reads the battery, reports
 *
 * No board has run it. The tests give it a clock, a servo bus, an INA226 and a radio of their own, and let the host swim it.
 */
#ifndef FJ_BOARD_H
#define FJ_BOARD_H

#include "lx_bus.h"
#include "robot.h"

#ifdef __cplusplus
extern "C" {
#endif

#define FJ_ANSWER_US 3000u    /* that a servo has to answer */
#define FJ_BUS_US 12000u      /* of a tick for questions to the servos */
#define FJ_TRIES 3u           /* of a question for an angle */
#define FJ_STALE_US 100000u   /* after which a servo that nobody had time to ask is silent */
#define FJ_FORGOTTEN_US 3000000u /* after which a voltage or temperature that was not read again is none */
#define FJ_DATAGRAMS 8u       /* that one tick hears at most: a flood must not stop the servos */
#define FJ_METER_TICKS 50u    /* between two tries to set up a meter that does not answer */

/* What a board supplies. `at` is handed back in every call; nothing may wait but uart_read. */
typedef struct {
    void *at;
    uint64_t (*now_us)(void *at);                                              /* a clock that never goes back */
    size_t (*udp_receive)(void *at, uint8_t *data, size_t room);               /* a datagram that waits; 0: there is none */
    void (*udp_send)(void *at, const uint8_t *data, size_t size);              /* to who sent the newest one */
    void (*uart_write)(void *at, const uint8_t *data, size_t size);            /* 115200 baud, 8N1, half duplex */
    size_t (*uart_read)(void *at, uint8_t *data, size_t room, uint32_t wait_us); /* what came; waits for the first byte so long */
    bool (*i2c_write)(void *at, uint8_t reg, uint16_t word);                   /* to the INA226, the high byte first; whether it took it */
    bool (*i2c_read)(void *at, uint8_t reg, uint16_t *word);
} fj_hal;

/* What the robot is built of. */
typedef struct {
    fj_info info;                /* joints, names and servo ids from the head to the tail, watchdog times, firmware, hashes */
    float zero[FJ_MAX_JOINTS];   /* rad: lx_angle(counts, 0) of the straight joint, measured at assembly */
    float sign[FJ_MAX_JOINTS];   /* 1, or -1: the servo is mounted the other way round */
    float shunt_ohm, most_ampere; /* of the INA226; 0: there is none */
    float low_battery;           /* V; 0: 6.4, two LiPo cells */
} fj_parts;

typedef struct {
    fj_robot robot;
    fj_hal hal;
    fj_parts parts;
    lx_reader line;
    bool loaded;      /* the servos were given torque */
    bool meter;       /* the INA226 is set up */
    uint32_t ticks;
    float ampere_lsb;
    float joint[FJ_MAX_JOINTS];                                 /* rad, the newest answer of each servo */
    uint64_t heard_us[FJ_MAX_JOINTS], volt_us[FJ_MAX_JOINTS], warm_us[FJ_MAX_JOINTS]; /* 0: never */
    bool silent[FJ_MAX_JOINTS];
    uint16_t servo_mv[FJ_MAX_JOINTS];
    int8_t temperature[FJ_MAX_JOINTS];
} fj_board;

/* False where the parts cannot be; the board must not go on then. The torque is off. */
bool fj_board_init(fj_board *it, const fj_hal *hal, const fj_parts *parts);

/* One bus tick. It takes FJ_BUS_US and the answer to one question at most, and what the radio and I2C take. */
void fj_board_tick(fj_board *it);

#ifdef __cplusplus
}
#endif

#endif
