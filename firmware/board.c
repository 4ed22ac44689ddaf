#include "board.h"

#include <math.h>
#include <string.h>

#include "ina226.h"
#include "servo_counts.h"

static uint64_t now_of(fj_board *it) {
    return it->hal.now_us(it->hal.at);
}

static void tell(fj_board *it, uint8_t servo, uint8_t code, uint8_t count, int32_t first, int32_t second) {
    lx_frame frame = {servo, code, count, false, {first, second, 0}};
    uint8_t out[LX_MAX_BYTES];
    size_t size = lx_encode(&frame, out);
    if (size > 0) it->hal.uart_write(it->hal.at, out, size);
}

/* Ask a servo for one number; false where it does not answer by `end`. */
static bool ask(fj_board *it, uint8_t servo, uint8_t code, uint64_t end, int32_t *value) {
    uint64_t now = now_of(it), until = now + FJ_ANSWER_US < end ? now + FJ_ANSWER_US : end;
    uint8_t data[LX_MAX_BYTES];
    lx_frame found;
    tell(it, servo, code, 0, 0, 0);
    for (now = now_of(it); now < until; now = now_of(it)) {
        size_t size = it->hal.uart_read(it->hal.at, data, sizeof data, (uint32_t)(until - now));
        for (size_t i = 0; i < size && i < sizeof data; i++) {
            if (lx_reader_push(&it->line, data[i], &found) && found.reply && found.servo == servo && found.code == code) {
                *value = found.value[0];
                return true;
            }
        }
    }
    while (lx_reader_silence(&it->line, &found)) {}
    return false;
}

/* Angles of all servos, rad; nan where one is silent. */
static void read_joints(fj_board *it, uint64_t end, float *joint) {
    for (uint8_t k = 0; k < it->parts.info.joints; k++) {
        int32_t counts = 0;
        uint8_t tries = 0, most = it->silent[k] ? 1u : FJ_TRIES; /* a servo that is gone must not take the others' time */
        bool heard = false;
        while (!heard && tries < most && now_of(it) < end) {
            heard = ask(it, it->parts.info.servo_id[k], LX_POS_READ, end, &counts);
            tries++;
        }
        uint64_t now = now_of(it);
        if (heard) {
            it->joint[k] = it->parts.sign[k] * lx_angle(counts, it->parts.zero[k]);
            it->heard_us[k] = now;
        }
        bool recent = it->heard_us[k] != 0 && now - it->heard_us[k] <= FJ_STALE_US;
        it->silent[k] = !heard && (tries == most || !recent); /* else nobody had time to ask: it is where it was */
        joint[k] = it->silent[k] ? NAN : it->joint[k];
    }
}

/* Voltage or temperature of one servo, in turn. */
static void read_slow(fj_board *it, const float *joint) {
    uint8_t k = (uint8_t)(it->ticks / 2 % it->parts.info.joints), servo = it->parts.info.servo_id[k];
    bool warm = it->ticks % 2 != 0;
    int32_t value = 0;
    if (!isfinite(joint[k]) || !ask(it, servo, warm ? LX_TEMP_READ : LX_VIN_READ, now_of(it) + FJ_ANSWER_US, &value)) return;
    if (warm) {
        it->temperature[k] = (int8_t)(value > 127 ? 127 : value);
        it->warm_us[k] = now_of(it);
    } else {
        it->servo_mv[k] = (uint16_t)value;
        it->volt_us[k] = now_of(it);
    }
}

static bool fresh(const uint64_t *since_us, uint8_t joints, uint64_t now) {
    for (uint8_t k = 0; k < joints; k++) {
        if (since_us[k] == 0 || now - since_us[k] > FJ_FORGOTTEN_US) return false;
    }
    return true;
}

/* The INA226's words; where they cannot be, there is no meter. */
static bool set_up_meter(fj_board *it) {
    uint16_t config = ina226_config(4, 2116, 2116); /* a new mean every 16.9 ms */
    uint16_t word = ina226_calibration(ina226_current_lsb(it->parts.most_ampere), it->parts.shunt_ohm);
    it->ampere_lsb = ina226_lsb_of(word, it->parts.shunt_ohm);
    return word != 0 && it->hal.i2c_write(it->hal.at, INA226_CONFIG, config) &&
           it->hal.i2c_write(it->hal.at, INA226_CALIBRATION, word);
}

static bool read_battery(fj_board *it, float *volts, float *amperes) {
    uint16_t bus = 0, current = 0;
    if (!it->meter) {
        if (it->ticks % FJ_METER_TICKS == 0) it->meter = set_up_meter(it);
        return false; /* its first mean is there at the next tick */
    }
    it->meter = it->hal.i2c_read(it->hal.at, INA226_BUS, &bus) && it->hal.i2c_read(it->hal.at, INA226_CURRENT, &current);
    *volts = ina226_bus_volts(bus);
    *amperes = ina226_amperes(current, it->ampere_lsb);
    return it->meter;
}

static void move(fj_board *it, bool torque) {
    for (uint8_t k = 0; k < it->parts.info.joints; k++) {
        uint8_t servo = it->parts.info.servo_id[k];
        if (!torque) { /* at every tick: a servo that began anew may have torque */
            tell(it, servo, LX_LOAD_OR_UNLOAD_WRITE, 1, 0, 0);
            continue;
        }
        if (!it->loaded) tell(it, servo, LX_LOAD_OR_UNLOAD_WRITE, 1, 1, 0);
        float angle = it->parts.sign[k] * it->robot.watchdog.target[k];
        tell(it, servo, LX_MOVE_TIME_WRITE, 2, lx_counts(angle, it->parts.zero[k]), 0);
    }
    it->loaded = torque;
}

bool fj_board_init(fj_board *it, const fj_hal *hal, const fj_parts *parts) {
    memset(it, 0, sizeof *it);
    it->hal = *hal;
    it->parts = *parts;
    for (uint8_t k = 0; k < parts->info.joints && k < FJ_MAX_JOINTS; k++) {
        bool turned = parts->sign[k] == 1.0f || parts->sign[k] == -1.0f;
        if (!turned || !isfinite(parts->zero[k])) return false;
    }
    if (!fj_robot_init(&it->robot, &parts->info, fj_default_limits())) return false;
    if (parts->low_battery > 0.0f) it->robot.guard.bounds.low = parts->low_battery;
    move(it, false);
    return true;
}

void fj_board_tick(fj_board *it) {
    uint8_t data[FJ_MAX_BYTES + 1], answer[FJ_MAX_BYTES]; /* one more: a longer datagram does not look like a whole one */
    float joint[FJ_MAX_JOINTS];
    size_t size;
    read_joints(it, now_of(it) + FJ_BUS_US, joint);
    read_slow(it, joint);
    for (uint8_t n = 0; n < FJ_DATAGRAMS && (size = it->hal.udp_receive(it->hal.at, data, sizeof data)) > 0; n++) {
        size_t bytes = fj_robot_hear(&it->robot, data, size, now_of(it), joint, answer, sizeof answer);
        if (bytes > 0) it->hal.udp_send(it->hal.at, answer, bytes);
    }
    uint64_t now = now_of(it);
    move(it, fj_robot_act(&it->robot, now, joint));

    fj_telemetry told;
    memset(&told, 0, sizeof told);
    memcpy(told.joint, joint, sizeof joint[0] * it->parts.info.joints);
    memcpy(told.servo_mv, it->servo_mv, sizeof told.servo_mv);
    memcpy(told.temperature, it->temperature, sizeof told.temperature);
    if (fresh(it->volt_us, it->parts.info.joints, now)) told.has |= FJ_HAS_SERVO_VOLTAGE;
    if (fresh(it->warm_us, it->parts.info.joints, now)) told.has |= FJ_HAS_TEMPERATURE;
    if (read_battery(it, &told.voltage, &told.current)) told.has |= FJ_HAS_POWER;
    size = fj_robot_report(&it->robot, now, &told, answer, sizeof answer);
    if (size > 0) it->hal.udp_send(it->hal.at, answer, size);
    it->ticks++;
}
