#include "ina226.h"

static const uint16_t AVERAGES[8] = {1, 4, 16, 64, 128, 256, 512, 1024};
static const uint16_t CONVERSION_US[8] = {140, 204, 332, 588, 1100, 2116, 4156, 8244};

#define ALWAYS 0x4000u     /* bit 14 reads 1 */
#define CONTINUOUS 0x0007u /* shunt and bus, again and again */

static int code_of(const uint16_t *table, uint16_t value) {
    for (int code = 0; code < 8; code++) {
        if (table[code] == value) return code;
    }
    return -1;
}

static int32_t signed_word(uint16_t word) {
    return word < 0x8000u ? (int32_t)word : (int32_t)word - 0x10000;
}

uint16_t ina226_config(uint16_t averages, uint16_t bus_us, uint16_t shunt_us) {
    int mean = code_of(AVERAGES, averages), bus = code_of(CONVERSION_US, bus_us), shunt = code_of(CONVERSION_US, shunt_us);
    if (mean < 0 || bus < 0 || shunt < 0) return 0;
    return (uint16_t)(ALWAYS | ((unsigned)mean << 9) | ((unsigned)bus << 6) | ((unsigned)shunt << 3) | CONTINUOUS);
}

uint32_t ina226_period_us(uint16_t config) {
    uint32_t once = (uint32_t)CONVERSION_US[(config >> 6) & 7u] + CONVERSION_US[(config >> 3) & 7u];
    return once * AVERAGES[(config >> 9) & 7u];
}

float ina226_current_lsb(float most) {
    return most / 32768.0f;
}

uint16_t ina226_calibration(float current_lsb, float shunt_ohm) {
    float product = current_lsb * shunt_ohm;
    if (!(product > 0.0f)) return 0;
    float exact = 0.00512f / product;
    if (!(exact >= 0.5f && exact < 32767.5f)) return 0; /* bit 15 is not there */
    return (uint16_t)(exact + 0.5f);
}

float ina226_lsb_of(uint16_t calibration, float shunt_ohm) {
    return calibration == 0 ? 0.0f : 0.00512f / ((float)calibration * shunt_ohm);
}

float ina226_bus_volts(uint16_t word) {
    return 1.25e-3f * (float)word;
}

float ina226_shunt_volts(uint16_t word) {
    return 2.5e-6f * (float)signed_word(word);
}

float ina226_amperes(uint16_t word, float current_lsb) {
    return current_lsb * (float)signed_word(word);
}

float ina226_watts(uint16_t word, float current_lsb) {
    return 25.0f * current_lsb * (float)word;
}
