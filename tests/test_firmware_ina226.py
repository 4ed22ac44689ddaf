"""The battery's monitor: register words to V, A and W, against the worked example of its data sheet."""

import pytest
from firmware_library import firmware, needs_compiler

__all__ = ["firmware"]  # a fixture
pytestmark = needs_compiler
SHUNT = 0.002  # ohm, of the data sheet's example (SBOS547, section 8.2.2): 10 A at 12 V, 1 mA in a count


def test_the_example_of_the_data_sheet(firmware):
    calibration = firmware.ina226_calibration(1e-3, SHUNT)
    lsb = firmware.ina226_lsb_of(calibration, SHUNT)
    assert calibration == 2560 and lsb == pytest.approx(1e-3)
    assert firmware.ina226_shunt_volts(8000) == pytest.approx(20e-3)
    assert firmware.ina226_bus_volts(9584) == pytest.approx(11.98)
    assert firmware.ina226_amperes(10_000, lsb) == pytest.approx(10.0)
    assert firmware.ina226_watts(4792, lsb) == pytest.approx(119.8)


def test_full_scales_are_those_of_the_chip(firmware):
    assert firmware.ina226_bus_volts(0x7FFF) == pytest.approx(40.96, abs=2e-3)
    assert firmware.ina226_shunt_volts(0x7FFF) == pytest.approx(81.92e-3, abs=5e-6)
    assert firmware.ina226_shunt_volts(0x8000) == pytest.approx(-81.92e-3, abs=5e-6)


def test_a_current_that_flows_back_is_negative(firmware):
    assert firmware.ina226_amperes(0xFFFF, 1e-3) == pytest.approx(-1e-3)


def test_the_power_on_word_is_made_of_its_settings(firmware):
    assert firmware.ina226_config(1, 1100, 1100) == 0x4127


def test_eight_means_of_1_1_ms_do_not_exist_and_four_fit_a_bus_tick(firmware):
    assert firmware.ina226_config(8, 1100, 1100) == 0
    word = firmware.ina226_config(4, 2116, 2116)
    assert word != 0 and firmware.ina226_period_us(word) == 4 * 2 * 2116 < 20_000


@pytest.mark.parametrize("averages", [1, 4, 16, 64, 128, 256, 512, 1024])
@pytest.mark.parametrize("conversion", [140, 204, 332, 588, 1100, 2116, 4156, 8244])
def test_each_setting_of_the_chip_comes_back_as_its_period(firmware, averages, conversion):
    assert firmware.ina226_period_us(firmware.ina226_config(averages, conversion, 140)) == averages * (conversion + 140)


@pytest.mark.parametrize(("lsb", "shunt"), [(0.0, 0.002), (-1.0, 0.002), (1e-9, 1e-3), (1e3, 1.0), (float("nan"), 0.1)])
def test_a_calibration_that_the_chip_cannot_hold_is_refused(firmware, lsb, shunt):
    assert firmware.ina226_calibration(lsb, shunt) == 0


def test_the_lsb_follows_the_whole_word_and_not_the_wish(firmware):
    """3.2 A over 0.1 ohm: the word is rounded by up to half a count, and so is every reading."""
    wish = firmware.ina226_current_lsb(3.2)
    word = firmware.ina226_calibration(wish, 0.1)
    lsb = firmware.ina226_lsb_of(word, 0.1)
    assert word == round(0.00512 / (wish * 0.1)) == 524 and lsb == pytest.approx(0.00512 / (524 * 0.1), rel=1e-6)
    assert lsb != wish and firmware.ina226_lsb_of(0, 0.1) == 0.0


def test_current_and_power_are_the_chips_own_arithmetic(firmware):
    """The chip computes current = shunt x CAL / 2048 and power = current x bus / 20000, in whole numbers."""
    word = firmware.ina226_calibration(firmware.ina226_current_lsb(5.0), 0.01)
    lsb, shunt, bus = firmware.ina226_lsb_of(word, 0.01), 5_000, 5_920  # 12.5 mV over 0.01 ohm, 7.4 V
    current = shunt * word // 2048
    assert firmware.ina226_amperes(current, lsb) == pytest.approx(1.25, rel=1e-3)
    assert firmware.ina226_watts(current * bus // 20_000, lsb) == pytest.approx(1.25 * 7.4, rel=2e-3)
