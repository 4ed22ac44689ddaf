#include "lx_bus.h"

#include <string.h>

typedef struct {
    int8_t bytes; /* 1, 2 unsigned; -1, -2 two's complement; 0: no field */
    int32_t least, most;
} field;

typedef struct {
    uint8_t code;
    bool reply, ordered; /* ordered: the first value must be below the second */
    field fields[LX_MAX_VALUES];
} row;

#define NONE {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}}
#define MOVE {{2, 0, 1000}, {2, 0, 30000}, {0, 0, 0}}
#define ANGLES {{2, 0, 1000}, {2, 0, 1000}, {0, 0, 0}}
#define VOLTS {{2, 4500, 12000}, {2, 4500, 12000}, {0, 0, 0}}
#define MODE {{1, 0, 1}, {1, 0, 0}, {-2, -1000, 1000}}
#define BYTE(least, most) {{1, least, most}, {0, 0, 0}, {0, 0, 0}}
#define OFFSET {{-1, -125, 125}, {0, 0, 0}, {0, 0, 0}}

static const row TABLE[] = {
    {LX_MOVE_TIME_WRITE, false, false, MOVE},
    {LX_MOVE_TIME_READ, false, false, NONE},
    {LX_MOVE_TIME_READ, true, false, MOVE},
    {LX_MOVE_TIME_WAIT_WRITE, false, false, MOVE},
    {LX_MOVE_TIME_WAIT_READ, false, false, NONE},
    {LX_MOVE_TIME_WAIT_READ, true, false, MOVE},
    {LX_MOVE_START, false, false, NONE},
    {LX_MOVE_STOP, false, false, NONE},
    {LX_ID_WRITE, false, false, BYTE(0, 253)},
    {LX_ID_READ, false, false, NONE},
    {LX_ID_READ, true, false, BYTE(0, 253)},
    {LX_ANGLE_OFFSET_ADJUST, false, false, OFFSET},
    {LX_ANGLE_OFFSET_WRITE, false, false, NONE},
    {LX_ANGLE_OFFSET_READ, false, false, NONE},
    {LX_ANGLE_OFFSET_READ, true, false, OFFSET},
    {LX_ANGLE_LIMIT_WRITE, false, true, ANGLES},
    {LX_ANGLE_LIMIT_READ, false, false, NONE},
    {LX_ANGLE_LIMIT_READ, true, true, ANGLES},
    {LX_VIN_LIMIT_WRITE, false, true, VOLTS},
    {LX_VIN_LIMIT_READ, false, false, NONE},
    {LX_VIN_LIMIT_READ, true, true, VOLTS},
    {LX_TEMP_MAX_LIMIT_WRITE, false, false, BYTE(50, 100)},
    {LX_TEMP_MAX_LIMIT_READ, false, false, NONE},
    {LX_TEMP_MAX_LIMIT_READ, true, false, BYTE(50, 100)},
    {LX_TEMP_READ, false, false, NONE},
    {LX_TEMP_READ, true, false, BYTE(0, 255)},
    {LX_VIN_READ, false, false, NONE},
    {LX_VIN_READ, true, false, {{2, 0, 20000}, {0, 0, 0}, {0, 0, 0}}},
    {LX_POS_READ, false, false, NONE},
    {LX_POS_READ, true, false, {{-2, -125, 1125}, {0, 0, 0}, {0, 0, 0}}},
    {LX_OR_MOTOR_MODE_WRITE, false, false, MODE},
    {LX_OR_MOTOR_MODE_READ, false, false, NONE},
    {LX_OR_MOTOR_MODE_READ, true, false, MODE},
    {LX_LOAD_OR_UNLOAD_WRITE, false, false, BYTE(0, 1)},
    {LX_LOAD_OR_UNLOAD_READ, false, false, NONE},
    {LX_LOAD_OR_UNLOAD_READ, true, false, BYTE(0, 1)},
    {LX_LED_CTRL_WRITE, false, false, BYTE(0, 1)},
    {LX_LED_CTRL_READ, false, false, NONE},
    {LX_LED_CTRL_READ, true, false, BYTE(0, 1)},
    {LX_LED_ERROR_WRITE, false, false, BYTE(0, 7)},
    {LX_LED_ERROR_READ, false, false, NONE},
    {LX_LED_ERROR_READ, true, false, BYTE(0, 7)},
};

static size_t width(field f) {
    return (size_t)(f.bytes < 0 ? -f.bytes : f.bytes);
}

static size_t parameters(const row *kind) {
    return width(kind->fields[0]) + width(kind->fields[1]) + width(kind->fields[2]);
}

static uint8_t values(const row *kind) {
    uint8_t count = 0;
    while (count < LX_MAX_VALUES && kind->fields[count].bytes != 0) count++;
    return count;
}

static const row *find_length(uint8_t code, size_t length) {
    for (size_t i = 0; i < sizeof TABLE / sizeof TABLE[0]; i++) {
        if (TABLE[i].code == code && 3 + parameters(&TABLE[i]) == length) return &TABLE[i];
    }
    return NULL;
}

static const row *find_direction(uint8_t code, bool reply) {
    for (size_t i = 0; i < sizeof TABLE / sizeof TABLE[0]; i++) {
        if (TABLE[i].code == code && TABLE[i].reply == reply) return &TABLE[i];
    }
    return NULL;
}

static uint8_t checksum(const uint8_t *body, size_t size) {
    unsigned sum = 0;
    for (size_t i = 0; i < size; i++) sum += body[i];
    return (uint8_t)(~sum & 0xffu);
}

static bool sound(const row *kind, const lx_frame *it) {
    if (it->servo > (kind->reply ? LX_BROADCAST - 1 : LX_BROADCAST) || it->count != values(kind)) return false;
    for (uint8_t k = 0; k < it->count; k++) {
        if (it->value[k] < kind->fields[k].least || it->value[k] > kind->fields[k].most) return false;
    }
    return !kind->ordered || it->value[0] < it->value[1];
}

size_t lx_encode(const lx_frame *it, uint8_t *out) {
    const row *kind = find_direction(it->code, it->reply);
    if (kind == NULL || !sound(kind, it)) return 0;
    size_t at = 5;
    out[0] = out[1] = 0x55;
    out[2] = it->servo;
    out[3] = (uint8_t)(3 + parameters(kind));
    out[4] = it->code;
    for (uint8_t k = 0; k < it->count; k++) {
        uint32_t bits = (uint32_t)it->value[k];
        out[at++] = (uint8_t)(bits & 0xffu);
        if (width(kind->fields[k]) == 2) out[at++] = (uint8_t)((bits >> 8) & 0xffu);
    }
    out[at] = checksum(out + 2, at - 2);
    return at + 1;
}

bool lx_decode(const uint8_t *data, size_t size, lx_frame *out) {
    if (size < 6 || size > LX_MAX_BYTES || data[0] != 0x55 || data[1] != 0x55 || (size_t)data[3] + 3 != size) return false;
    const row *kind = find_length(data[4], data[3]);
    if (kind == NULL || data[size - 1] != checksum(data + 2, size - 3)) return false;
    lx_frame it;
    memset(&it, 0, sizeof it);
    it.servo = data[2];
    it.code = data[4];
    it.reply = kind->reply;
    it.count = values(kind);
    size_t at = 5;
    for (uint8_t k = 0; k < it.count; k++) {
        int8_t bytes = kind->fields[k].bytes;
        int32_t value = data[at++];
        if (width(kind->fields[k]) == 2) value += 256 * (int32_t)data[at++];
        if (bytes == -1 && value >= 0x80) value -= 0x100;
        if (bytes == -2 && value >= 0x8000) value -= 0x10000;
        it.value[k] = value;
    }
    if (!sound(kind, &it)) return false;
    *out = it;
    return true;
}

static void drop(lx_reader *it, uint8_t bytes) {
    it->count = (uint8_t)(it->count - bytes);
    memmove(it->waiting, it->waiting + bytes, it->count);
}

/* Bytes of the frame that could begin the waiting ones; 0: none could; -1: too few to tell, or to have all of it. */
static int frame_size(const lx_reader *it) {
    const uint8_t *from = it->waiting;
    if ((it->count > 0 && from[0] != 0x55) || (it->count > 1 && from[1] != 0x55)) return 0;
    if (it->count > 3 && (from[3] < 3 || from[3] > LX_MAX_BYTES - 3)) return 0;
    if (it->count < 5) return -1;
    if (find_length(from[4], from[3]) == NULL) return 0;
    return it->count >= from[3] + 3 ? from[3] + 3 : -1;
}

static bool scan(lx_reader *it, lx_frame *out) {
    while (it->count > 0) {
        int size = frame_size(it);
        if (size < 0) return false;
        if (size > 0 && lx_decode(it->waiting, (size_t)size, out)) {
            if (!out->reply) it->echoes++;
            drop(it, (uint8_t)size);
            return true;
        }
        if (size > 0) it->damaged++;
        it->skipped++;
        drop(it, 1); /* not `size`: a frame may begin inside a damaged one */
    }
    return false;
}

bool lx_reader_push(lx_reader *it, uint8_t byte, lx_frame *out) {
    if (it->count >= LX_MAX_BYTES) { /* cannot be: a whole frame never waits */
        it->skipped++;
        drop(it, 1);
    }
    it->waiting[it->count++] = byte;
    return scan(it, out);
}

bool lx_reader_silence(lx_reader *it, lx_frame *out) {
    while (it->count > 0) {
        it->skipped++;
        drop(it, 1);
        if (scan(it, out)) return true;
    }
    return false;
}
