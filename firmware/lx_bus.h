/* Frames of LX-series bus servos. Equal to fishmj/deploy/protocols/lx_bus.py, which explains them; table: docs/tank/protocols.md. */
#ifndef FJ_LX_BUS_H
#define FJ_LX_BUS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define LX_MAX_BYTES 10u
#define LX_MAX_VALUES 3u
#define LX_BROADCAST 254u

enum {
    LX_MOVE_TIME_WRITE = 1,
    LX_MOVE_TIME_READ = 2,
    LX_MOVE_TIME_WAIT_WRITE = 7,
    LX_MOVE_TIME_WAIT_READ = 8,
    LX_MOVE_START = 11,
    LX_MOVE_STOP = 12,
    LX_ID_WRITE = 13,
    LX_ID_READ = 14,
    LX_ANGLE_OFFSET_ADJUST = 17,
    LX_ANGLE_OFFSET_WRITE = 18,
    LX_ANGLE_OFFSET_READ = 19,
    LX_ANGLE_LIMIT_WRITE = 20,
    LX_ANGLE_LIMIT_READ = 21,
    LX_VIN_LIMIT_WRITE = 22,
    LX_VIN_LIMIT_READ = 23,
    LX_TEMP_MAX_LIMIT_WRITE = 24,
    LX_TEMP_MAX_LIMIT_READ = 25,
    LX_TEMP_READ = 26,
    LX_VIN_READ = 27,
    LX_POS_READ = 28,
    LX_OR_MOTOR_MODE_WRITE = 29,
    LX_OR_MOTOR_MODE_READ = 30,
    LX_LOAD_OR_UNLOAD_WRITE = 31,
    LX_LOAD_OR_UNLOAD_READ = 32,
    LX_LED_CTRL_WRITE = 33,
    LX_LED_CTRL_READ = 34,
    LX_LED_ERROR_WRITE = 35,
    LX_LED_ERROR_READ = 36
};

typedef struct {
    uint8_t servo, code, count;
    bool reply; /* a servo sent it */
    int32_t value[LX_MAX_VALUES];
} lx_frame;

typedef struct {
    uint8_t waiting[LX_MAX_BYTES];
    uint8_t count;
    uint32_t skipped, damaged, echoes;
} lx_reader;

/* Bytes of a frame in `out`, which has LX_MAX_BYTES; 0 where the table of codes has no such frame or a value is out of its range. */
size_t lx_encode(const lx_frame *it, uint8_t *out);

/* The one frame that `data` is; false for any other bytes. */
bool lx_decode(const uint8_t *data, size_t size, lx_frame *out);

/* Give the reader (begin with zeros) one byte of the line; true where it completes a frame, the host's own echo as well. */
bool lx_reader_push(lx_reader *it, uint8_t byte, lx_frame *out);

/* The line fell silent: what waits is truncated. Call until false; true where a frame began inside it. */
bool lx_reader_silence(lx_reader *it, lx_frame *out);

#ifdef __cplusplus
}
#endif

#endif
