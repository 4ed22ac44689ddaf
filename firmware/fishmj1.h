/* fishmj-1: the datagram between host and robot, as docs/tank/protocols.md has it. The robot's side of it.
 *
 * Portable C99. No allocation, no state; nothing of the standard library but string.h. Any byte order of the machine.
 * The same bytes as fishmj/deploy/protocols/fishmj1.py, which the tests compare.
 */
#ifndef FJ_FISHMJ1_H
#define FJ_FISHMJ1_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define FJ_VERSION 1u
#define FJ_MAX_JOINTS 8u
#define FJ_MAX_BYTES 272u
#define FJ_HEADER_BYTES 20u
#define FJ_CRC_BYTES 4u
#define FJ_TEXT 32u
#define FJ_NAME 16u
#define FJ_MAX_ANGLE 3.14159274f /* rad, pi as a float */
#define FJ_MAX_SPEED 50.0f       /* rad/s */
#define FJ_MAX_VOLTAGE 41.0f     /* V */
#define FJ_MAX_CURRENT 100.0f    /* A */
#define FJ_MAX_WAIT_US 60000000u
#define FJ_MAX_TIME_US (UINT64_C(1) << 50) /* 35 years */
#define FJ_MAX_SERVO 253u
#define FJ_FAULTS 31u

enum { FJ_HELLO = 1, FJ_ARM, FJ_DISARM, FJ_COMMAND, FJ_TELEMETRY, FJ_INFO };
enum { FJ_HAS_ECHO = 1, FJ_HAS_POWER = 2, FJ_HAS_SERVO_VOLTAGE = 4, FJ_HAS_TEMPERATURE = 8, FJ_HAS_FAULT = 16, FJ_HAS_ALL = 31 };
enum { FJ_IDLE = 0, FJ_ARMED, FJ_HOLD, FJ_NEUTRAL };
enum { FJ_HOT = 1, FJ_VOLTAGE = 2, FJ_LOCKED = 4, FJ_NO_REPLY = 8, FJ_STUCK = 16 };

typedef enum {
    FJ_OK = 0,
    FJ_BAD_SIZE,
    FJ_BAD_MAGIC,
    FJ_BAD_VERSION,
    FJ_BAD_CRC,
    FJ_BAD_KIND, /* of nobody, or of a robot */
    FJ_BAD_VALUE
} fj_result;

/* A datagram of the host. */
typedef struct {
    uint8_t kind;     /* FJ_HELLO, FJ_ARM, FJ_DISARM, FJ_COMMAND */
    uint8_t joints;   /* of FJ_COMMAND, else 0 */
    bool has_speed;   /* of FJ_COMMAND */
    uint32_t seq;
    uint64_t time_us; /* the host's clock */
    uint32_t hold_us, neutral_us;    /* of FJ_ARM */
    float joint[FJ_MAX_JOINTS];      /* rad */
    float speed[FJ_MAX_JOINTS];      /* rad/s, 0 where has_speed is false */
} fj_message;

typedef struct {
    uint32_t seq;
    uint64_t time_us; /* the robot's clock */
    uint8_t joints, state, has;
    uint32_t echo;         /* number of the newest command that was taken */
    uint64_t echo_time_us; /* its time, of the host's clock */
    float voltage, current; /* V, A */
    float joint[FJ_MAX_JOINTS];            /* rad */
    uint16_t servo_mv[FJ_MAX_JOINTS];      /* mV */
    int8_t temperature[FJ_MAX_JOINTS];     /* deg C */
    uint8_t fault[FJ_MAX_JOINTS];
} fj_telemetry;

typedef struct {
    uint8_t joints;
    uint32_t hold_us, neutral_us;
    float servo_range; /* rad */
    char firmware[FJ_TEXT + 1];
    uint8_t firmware_sha256[32], policy_sha256[32]; /* zeros: none */
    uint8_t servo_id[FJ_MAX_JOINTS];
    char name[FJ_MAX_JOINTS][FJ_NAME + 1];
} fj_info;

/* CRC-32 of IEEE 802.3: polynomial 0x04C11DB7 reflected, begun with and closed by all ones. */
uint32_t fj_crc32(const uint8_t *data, size_t size);

/* Read a datagram of the host. `out` is written only where FJ_OK is returned. Never reads beyond data[size - 1]. */
fj_result fj_decode(const uint8_t *data, size_t size, fj_message *out);

/* Write a datagram to `out`, which has `room` bytes. Returns its size, 0 where it has no room or a value is out of its range. */
size_t fj_encode_telemetry(const fj_telemetry *it, uint8_t *out, size_t room);
size_t fj_encode_info(uint32_t seq, uint64_t time_us, const fj_info *it, uint8_t *out, size_t room);

/* Close a datagram whose payload lies at out + FJ_HEADER_BYTES already: header and checksum. Returns its size. */
size_t fj_close(uint8_t kind, uint8_t joints, uint32_t seq, uint64_t time_us, size_t length, uint8_t *out);

#ifdef __cplusplus
}
#endif

#endif
