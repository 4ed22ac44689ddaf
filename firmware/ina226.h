/* INA226: register words <-> V, A, W. Register map, scales and codes: Texas Instruments SBOS547, sections 7.5 and 7.6.
 *
 *     V_bus   = 1.25 mV x register          V_shunt = 2.5 uV x register (two's complement)
 *     CAL     = 0.00512 / (LSB_I x R_shunt)
 *     I       = LSB_I x register (two's complement)
 *     P       = 25 LSB_I x register
 *
 * The chip sends words with the high byte first.
 */
#ifndef FJ_INA226_H
#define FJ_INA226_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum {
    INA226_CONFIG = 0x00,
    INA226_SHUNT = 0x01,
    INA226_BUS = 0x02,
    INA226_POWER = 0x03,
    INA226_CURRENT = 0x04,
    INA226_CALIBRATION = 0x05,
    INA226_MANUFACTURER = 0xfe, /* reads 0x5449, "TI" */
    INA226_DIE = 0xff           /* reads 0x2260 */
};

/* The word of INA226_CONFIG: measure shunt and bus without pause, mean of `averages` (1, 4, 16, 64, 128, 256, 512, 1024), each
 * conversion `bus_us` and `shunt_us` long (140, 204, 332, 588, 1100, 2116, 4156, 8244 us). 0 where the chip has no such code. */
uint16_t ina226_config(uint16_t averages, uint16_t bus_us, uint16_t shunt_us);

/* us between two new readings of a configuration. */
uint32_t ina226_period_us(uint16_t config);

/* A in one count of INA226_CURRENT where `most`, A, shall just fit. */
float ina226_current_lsb(float most);

/* The word of INA226_CALIBRATION; 0, with which the chip measures no current, where none fits. */
uint16_t ina226_calibration(float current_lsb, float shunt_ohm);

/* A in one count of INA226_CURRENT that a calibration word really gives: the word is a whole number. */
float ina226_lsb_of(uint16_t calibration, float shunt_ohm);

float ina226_bus_volts(uint16_t word);
float ina226_shunt_volts(uint16_t word);
float ina226_amperes(uint16_t word, float current_lsb);
float ina226_watts(uint16_t word, float current_lsb);

#ifdef __cplusplus
}
#endif

#endif
