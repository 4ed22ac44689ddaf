#include "fishmj1.h"

#include <string.h>

static void put16(uint8_t *to, uint16_t value) {
    to[0] = (uint8_t)(value & 0xffu);
    to[1] = (uint8_t)(value >> 8);
}

static void put32(uint8_t *to, uint32_t value) {
    put16(to, (uint16_t)(value & 0xffffu));
    put16(to + 2, (uint16_t)(value >> 16));
}

static void put64(uint8_t *to, uint64_t value) {
    put32(to, (uint32_t)(value & 0xffffffffu));
    put32(to + 4, (uint32_t)(value >> 32));
}

static void put_float(uint8_t *to, float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits); /* the only conversion of types that C99 allows */
    put32(to, bits);
}

static uint16_t get16(const uint8_t *from) {
    return (uint16_t)(from[0] | (uint16_t)(from[1] << 8));
}

static uint32_t get32(const uint8_t *from) {
    return (uint32_t)get16(from) | ((uint32_t)get16(from + 2) << 16);
}

static uint64_t get64(const uint8_t *from) {
    return (uint64_t)get32(from) | ((uint64_t)get32(from + 4) << 32);
}

static float get_float(const uint8_t *from) {
    uint32_t bits = get32(from);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static bool within(float value, float low, float high) {
    return value >= low && value <= high; /* nan is not */
}

static bool waits_are_sound(uint32_t hold_us, uint32_t neutral_us) {
    return hold_us > 0 && hold_us < neutral_us && neutral_us <= FJ_MAX_WAIT_US;
}

uint32_t fj_crc32(const uint8_t *data, size_t size) {
    static const uint32_t nibble[16] = {
        0x00000000u, 0x1db71064u, 0x3b6e20c8u, 0x26d930acu, 0x76dc4190u, 0x6b6b51f4u, 0x4db26158u, 0x5005713cu,
        0xedb88320u, 0xf00f9344u, 0xd6d6a3e8u, 0xcb61b38cu, 0x9b64c2b0u, 0x86d3d2d4u, 0xa00ae278u, 0xbdbdf21cu,
    };
    uint32_t crc = 0xffffffffu;
    for (size_t i = 0; i < size; i++) {
        crc ^= data[i];
        crc = (crc >> 4) ^ nibble[crc & 15u];
        crc = (crc >> 4) ^ nibble[crc & 15u];
    }
    return ~crc;
}

size_t fj_close(uint8_t kind, uint8_t joints, uint32_t seq, uint64_t time_us, size_t length, uint8_t *out) {
    out[0] = 'F';
    out[1] = 'J';
    out[2] = FJ_VERSION;
    out[3] = kind;
    out[4] = joints;
    out[5] = 0;
    put16(out + 6, (uint16_t)length);
    put32(out + 8, seq);
    put64(out + 12, time_us);
    put32(out + FJ_HEADER_BYTES + length, fj_crc32(out, FJ_HEADER_BYTES + length));
    return FJ_HEADER_BYTES + length + FJ_CRC_BYTES;
}

static bool read_arm(const uint8_t *payload, size_t length, fj_message *it) {
    if (length != 8) return false;
    it->hold_us = get32(payload);
    it->neutral_us = get32(payload + 4);
    return waits_are_sound(it->hold_us, it->neutral_us);
}

static bool read_command(const uint8_t *payload, size_t length, fj_message *it) {
    size_t row = 4u * it->joints;
    if (it->joints < 1 || it->joints > FJ_MAX_JOINTS || (length != row && length != 2 * row)) return false;
    it->has_speed = length == 2 * row;
    for (size_t k = 0; k < it->joints; k++) {
        it->joint[k] = get_float(payload + 4 * k);
        if (!within(it->joint[k], -FJ_MAX_ANGLE, FJ_MAX_ANGLE)) return false;
        if (!it->has_speed) continue;
        it->speed[k] = get_float(payload + row + 4 * k);
        if (!within(it->speed[k], 0.0f, FJ_MAX_SPEED) || it->speed[k] <= 0.0f) return false;
    }
    return true;
}

fj_result fj_decode(const uint8_t *data, size_t size, fj_message *out) {
    if (size < FJ_HEADER_BYTES + FJ_CRC_BYTES || size > FJ_MAX_BYTES) return FJ_BAD_SIZE;
    if (data[0] != 'F' || data[1] != 'J') return FJ_BAD_MAGIC;
    if (data[2] != FJ_VERSION) return FJ_BAD_VERSION;
    size_t length = get16(data + 6);
    if (size != FJ_HEADER_BYTES + length + FJ_CRC_BYTES) return FJ_BAD_SIZE;
    if (get32(data + FJ_HEADER_BYTES + length) != fj_crc32(data, FJ_HEADER_BYTES + length)) return FJ_BAD_CRC;

    fj_message it;
    memset(&it, 0, sizeof it);
    it.kind = data[3];
    it.joints = data[4];
    it.seq = get32(data + 8);
    it.time_us = get64(data + 12);
    if (it.kind < FJ_HELLO || it.kind > FJ_COMMAND) return FJ_BAD_KIND;
    if (data[5] != 0 || it.time_us > FJ_MAX_TIME_US) return FJ_BAD_VALUE;
    if (it.kind != FJ_COMMAND && it.joints != 0) return FJ_BAD_VALUE;

    const uint8_t *payload = data + FJ_HEADER_BYTES;
    bool fine = it.kind == FJ_COMMAND ? read_command(payload, length, &it)
                : it.kind == FJ_ARM   ? read_arm(payload, length, &it)
                                      : length == 0;
    if (!fine) return FJ_BAD_VALUE;
    *out = it;
    return FJ_OK;
}

size_t fj_encode_telemetry(const fj_telemetry *it, uint8_t *out, size_t room) {
    size_t length = 24u + 8u * it->joints;
    if (it->joints < 1 || it->joints > FJ_MAX_JOINTS || room < FJ_HEADER_BYTES + length + FJ_CRC_BYTES) return 0;
    bool echo = (it->has & FJ_HAS_ECHO) != 0, power = (it->has & FJ_HAS_POWER) != 0;
    if (it->state > FJ_NEUTRAL || it->has > 31 || it->time_us > FJ_MAX_TIME_US) return 0;
    if (echo && it->echo_time_us > FJ_MAX_TIME_US) return 0;
    if (power && !(within(it->voltage, 0.0f, FJ_MAX_VOLTAGE) && within(it->current, -FJ_MAX_CURRENT, FJ_MAX_CURRENT))) return 0;

    uint8_t *to = out + FJ_HEADER_BYTES;
    memset(to, 0, length); /* of what is not there, the bytes are zero */
    to[0] = it->state;
    to[1] = it->has;
    if (echo) {
        put32(to + 4, it->echo);
        put64(to + 8, it->echo_time_us);
    }
    if (power) {
        put_float(to + 16, it->voltage);
        put_float(to + 20, it->current);
    }
    for (size_t k = 0; k < it->joints; k++) {
        uint8_t *row = to + 24 + 8 * k;
        if (!within(it->joint[k], -FJ_MAX_ANGLE, FJ_MAX_ANGLE)) return 0;
        put_float(row, it->joint[k]);
        if (it->has & FJ_HAS_SERVO_VOLTAGE) put16(row + 4, it->servo_mv[k]);
        if (it->has & FJ_HAS_TEMPERATURE) row[6] = (uint8_t)it->temperature[k];
        if (it->has & FJ_HAS_FAULT) {
            if (it->fault[k] > FJ_FAULTS) return 0;
            row[7] = it->fault[k];
        }
    }
    return fj_close(FJ_TELEMETRY, it->joints, it->seq, it->time_us, length, out);
}

/* Length of a name, 0 where it is none: letters, digits, '_', '.', '-', no '-' first, not dots alone. */
static size_t name_length(const char *text, size_t most) {
    size_t n = 0;
    bool only_dots = true;
    for (; n <= most && text[n] != '\0'; n++) {
        char c = text[n];
        bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' || c == '.' || c == '-';
        if (!plain) return 0;
        only_dots = only_dots && c == '.';
    }
    return n > most || only_dots || text[0] == '-' ? 0 : n;
}

size_t fj_encode_info(uint32_t seq, uint64_t time_us, const fj_info *it, uint8_t *out, size_t room) {
    size_t length = 108u + (1u + FJ_NAME) * it->joints;
    if (it->joints < 1 || it->joints > FJ_MAX_JOINTS || room < FJ_HEADER_BYTES + length + FJ_CRC_BYTES) return 0;
    size_t said = name_length(it->firmware, FJ_TEXT);
    if (said == 0 || time_us > FJ_MAX_TIME_US || !waits_are_sound(it->hold_us, it->neutral_us)) return 0;
    if (!within(it->servo_range, 0.0f, FJ_MAX_ANGLE) || it->servo_range <= 0.0f) return 0;

    uint8_t *to = out + FJ_HEADER_BYTES, *ids = to + 108, *names = ids + it->joints;
    memset(to, 0, length);
    put32(to, it->hold_us);
    put32(to + 4, it->neutral_us);
    put_float(to + 8, it->servo_range);
    memcpy(to + 12, it->firmware, said);
    memcpy(to + 44, it->firmware_sha256, 32);
    memcpy(to + 76, it->policy_sha256, 32);
    for (size_t k = 0; k < it->joints; k++) {
        size_t n = name_length(it->name[k], FJ_NAME);
        if (n == 0 || it->servo_id[k] > FJ_MAX_SERVO) return 0;
        ids[k] = it->servo_id[k];
        memcpy(names + FJ_NAME * k, it->name[k], n);
        for (size_t i = 0; i < k; i++) {
            if (ids[i] == ids[k] || memcmp(names + FJ_NAME * i, names + FJ_NAME * k, FJ_NAME) == 0) return 0;
        }
    }
    return fj_close(FJ_INFO, it->joints, seq, time_us, length, out);
}
