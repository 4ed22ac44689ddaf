/* Damaged frames against the firmware's readers, on the host, under the address and undefined-behaviour sanitizers.
 *
 *     make fuzz            100,000 frames for each protocol
 *
 * Each frame lies in memory of exactly its size, so that reading one byte beyond it is found. Wrong is
 *     fishmj-1   accepted with other bytes than the encoding of what was read; or accepted, with bytes that nobody sent, where the
 *                fuzzer did not write a checksum that fits
 *     LX         a frame comes out that is not byte for byte in the stream, in the table of codes, in range and with its checksum
 *     robot      a target that is not finite or out of range, torque without being armed, or no telemetry
 * Prints one line for each; exits 1 where anything is wrong.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fishmj1.h"
#include "lx_bus.h"
#include "robot.h"

static uint64_t state = 88172645463325252u;

static uint32_t chance(uint32_t below) { /* xorshift64 */
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (uint32_t)((state >> 16) % below);
}

static float angle(float most) {
    return ((float)chance(2000001) / 1e6f - 1.0f) * most;
}

static void put_float(uint8_t *to, float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    for (int i = 0; i < 4; i++) to[i] = (uint8_t)(bits >> (8 * i));
}

static void put32(uint8_t *to, uint32_t value) {
    for (int i = 0; i < 4; i++) to[i] = (uint8_t)(value >> (8 * i));
}

/* A datagram of the host, as it would send it. */
static size_t host_datagram(uint8_t *out, uint32_t seq, uint64_t time_us) {
    uint8_t *payload = out + FJ_HEADER_BYTES, kind = (uint8_t)(FJ_HELLO + chance(4)), joints = 0;
    size_t length = 0;
    if (kind == FJ_ARM) {
        uint32_t hold = 1 + chance(1000000);
        put32(payload, hold);
        put32(payload + 4, hold + 1 + chance(1000000));
        length = 8;
    }
    if (kind == FJ_COMMAND) {
        joints = (uint8_t)(1 + chance(FJ_MAX_JOINTS));
        uint32_t rows = 1 + chance(2);
        for (uint32_t k = 0; k < rows * joints; k++) put_float(payload + 4 * k, k < joints ? angle(3.0f) : 0.1f + (float)chance(8));
        length = 4u * rows * joints;
    }
    return fj_close(kind, joints, seq, time_us, length, out);
}

/* The one encoding of what was read. */
static size_t again(const fj_message *it, uint8_t *out) {
    uint8_t *payload = out + FJ_HEADER_BYTES;
    size_t length = 0;
    if (it->kind == FJ_ARM) {
        put32(payload, it->hold_us);
        put32(payload + 4, it->neutral_us);
        length = 8;
    }
    for (size_t k = 0; k < it->joints; k++, length += 4) put_float(payload + length, it->joint[k]);
    for (size_t k = 0; it->has_speed && k < it->joints; k++, length += 4) put_float(payload + length, it->speed[k]);
    return fj_close(it->kind, it->joints, it->seq, it->time_us, length, out);
}

static size_t damage(uint8_t *data, size_t size, size_t room) {
    switch (chance(7)) {
        case 0: /* noise */
            size = chance((uint32_t)room);
            for (size_t i = 0; i < size; i++) data[i] = (uint8_t)chance(256);
            return size;
        case 1: /* bits */
            for (uint32_t n = 1 + chance(8); n > 0; n--) data[chance((uint32_t)size)] ^= (uint8_t)(1u << chance(8));
            return size;
        case 2: /* bytes */
            for (uint32_t n = 1 + chance(4); n > 0; n--) data[chance((uint32_t)size)] = (uint8_t)chance(256);
            return size;
        case 3: /* cut */
            return chance((uint32_t)size);
        case 4: { /* longer */
            size_t more = size + 1 + chance(20);
            if (more > room) more = room;
            for (size_t i = size; i < more; i++) data[i] = (uint8_t)chance(256);
            return more;
        }
        case 5: { /* two bytes change places */
            size_t i = chance((uint32_t)size), j = chance((uint32_t)size);
            uint8_t kept = data[i];
            data[i] = data[j];
            data[j] = kept;
            return size;
        }
        default: { /* a number that is none */
            static const float bad[5] = {NAN, INFINITY, -INFINITY, 1e30f, -0.0f};
            if (size >= 8) put_float(data + chance((uint32_t)size - 4), bad[chance(5)]);
            return size;
        }
    }
}

static uint8_t *exactly(const uint8_t *data, size_t size) {
    uint8_t *copy = malloc(size ? size : 1);
    if (copy == NULL) exit(2);
    memcpy(copy, data, size);
    return copy;
}

static long fuzz_fishmj1(long count) {
    long accepted = 0, wrong = 0;
    uint8_t data[400], sent[400], back[400];
    for (long n = 0; n < count; n++) {
        memset(data, 0, sizeof data);
        size_t sent_size = host_datagram(data, chance(UINT32_MAX), ((uint64_t)chance(1u << 18) << 32) | chance(UINT32_MAX));
        memcpy(sent, data, sizeof sent);
        size_t size = damage(data, sent_size, 300);
        bool sealed = n % 3 == 0 && size >= FJ_HEADER_BYTES + FJ_CRC_BYTES && size <= FJ_MAX_BYTES;
        if (sealed) {
            size_t length = size - FJ_HEADER_BYTES - FJ_CRC_BYTES;
            data[6] = (uint8_t)(length & 0xffu);
            data[7] = (uint8_t)(length >> 8);
            put32(data + size - FJ_CRC_BYTES, fj_crc32(data, size - FJ_CRC_BYTES));
        }
        uint8_t *copy = exactly(data, size);
        fj_message message;
        if (fj_decode(copy, size, &message) == FJ_OK) {
            accepted++;
            bool same = again(&message, back) == size && memcmp(back, data, size) == 0;
            bool unsent = size != sent_size || memcmp(sent, data, size) != 0;
            wrong += !same || (!sealed && unsent);
        }
        free(copy);
    }
    printf("fishmj-1: %ld frames, %ld accepted, %ld wrong\n", count, accepted, wrong);
    return wrong;
}

static bool contains(const uint8_t *data, size_t size, const uint8_t *part, size_t length) {
    for (size_t at = 0; at + length <= size; at++) {
        if (memcmp(data + at, part, length) == 0) return true;
    }
    return false;
}

static size_t lx_sent(uint8_t *out) {
    lx_frame it;
    size_t size = 0;
    while (size == 0) {
        memset(&it, 0, sizeof it);
        it.servo = (uint8_t)chance(254);
        it.code = (uint8_t)(1 + chance(36));
        it.reply = chance(2) == 1;
        it.count = (uint8_t)chance(LX_MAX_VALUES + 1);
        for (uint8_t k = 0; k < it.count; k++) it.value[k] = (int32_t)chance(1100) - (int32_t)(chance(4) == 0 ? 100 : 0);
        size = lx_encode(&it, out);
    }
    return size;
}

static long fuzz_lx(long count) {
    long accepted = 0, unsent = 0, wrong = 0;
    uint8_t data[64], sent[LX_MAX_BYTES], back[LX_MAX_BYTES];
    for (long n = 0; n < count; n++) {
        size_t sent_size = lx_sent(sent);
        memcpy(data, sent, sent_size);
        size_t size = damage(data, sent_size, 40);
        lx_reader reader;
        lx_frame frame;
        memset(&reader, 0, sizeof reader);
        for (size_t i = 0; i <= size; i++) {
            bool out = i < size ? lx_reader_push(&reader, data[i], &frame) : lx_reader_silence(&reader, &frame);
            if (!out) continue;
            size_t length = lx_encode(&frame, back);
            accepted++;
            wrong += length == 0 || !contains(data, size, back, length);
            unsent += length != sent_size || memcmp(back, sent, length) != 0;
        }
        uint8_t *copy = exactly(data, size);
        if (lx_decode(copy, size, &frame)) wrong += lx_encode(&frame, back) != size || memcmp(back, data, size) != 0;
        free(copy);
        wrong += reader.count >= LX_MAX_BYTES;
    }
    printf("LX: %ld frames, %ld accepted, %ld of them never sent (a checksum of 8 bits), %ld wrong\n", count, accepted, unsent, wrong);
    return wrong;
}

static long fuzz_robot(long count) {
    long wrong = 0, armed = 0;
    fj_info info;
    fj_robot robot;
    memset(&info, 0, sizeof info);
    info.joints = 3;
    info.hold_us = 100000;
    info.neutral_us = 300000;
    memcpy(info.firmware, "fuzz", 5);
    for (uint8_t k = 0; k < 3; k++) {
        info.servo_id[k] = k;
        info.name[k][0] = 'j';
        info.name[k][1] = (char)('1' + k);
    }
    if (!fj_robot_init(&robot, &info, fj_default_limits())) return 1;
    uint64_t now = 0;
    uint32_t seq = 0;
    uint8_t data[400], answer[FJ_MAX_BYTES];
    for (long n = 0; n < count; n++) {
        now += chance(40000);
        float measured[3] = {angle(1.2f), angle(1.2f), chance(20) == 0 ? NAN : angle(1.2f)};
        memset(data, 0, sizeof data);
        size_t size = host_datagram(data, ++seq, now);
        if (chance(2) == 0) size = damage(data, size, 300);
        uint8_t *copy = exactly(data, size);
        size_t said = fj_robot_hear(&robot, copy, size, now, measured, answer, sizeof answer);
        free(copy);
        bool moves = fj_robot_act(&robot, now, measured);
        bool torque = robot.watchdog.state != FJ_IDLE && !(robot.watchdog.state == FJ_NEUTRAL && robot.watchdog.rested);
        wrong += said > sizeof answer || moves != torque;
        for (uint8_t k = 0; moves && k < 3; k++) {
            float target = robot.watchdog.target[k];
            wrong += !isfinite(target) || fabsf(target) > robot.watchdog.limits.servo_range;
        }
        fj_telemetry telemetry;
        memset(&telemetry, 0, sizeof telemetry);
        memcpy(telemetry.joint, measured, sizeof measured);
        if (chance(20) == 0) telemetry.joint[chance(3)] = angle(40.0f);
        telemetry.has = (uint8_t)chance(256);
        telemetry.voltage = chance(20) == 0 ? NAN : angle(50.0f);
        telemetry.current = angle(200.0f);
        for (uint8_t k = 0; k < 3; k++) telemetry.fault[k] = (uint8_t)chance(256);
        size_t sent = fj_robot_report(&robot, now, &telemetry, answer, sizeof answer);
        wrong += sent == 0 || sent > sizeof answer; /* a host that hears nothing takes the robot for gone */
        armed += robot.watchdog.state == FJ_ARMED;
    }
    printf("robot: %ld datagrams, armed after %ld of them, %ld wrong\n", count, armed, wrong);
    return wrong;
}

int main(int argc, char **argv) {
    long count = argc > 1 ? strtol(argv[1], NULL, 10) : 100000;
    if (argc > 2) state += strtoull(argv[2], NULL, 10);
    long wrong = fuzz_fishmj1(count) + fuzz_lx(count) + fuzz_robot(count);
    return wrong ? 1 : 0;
}
