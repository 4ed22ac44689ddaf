"""The page of parts and its drawings say the pins that the firmware is built with."""

import re
import xml.etree.ElementTree as ET

from test_firmware_esp32s3 import flags

from tests.test_docs_prose import ROOT

PAGE = (ROOT / "docs" / "tank" / "parts.md").read_text(encoding="utf-8")
NAMES = {"TX": "SERVO_TX", "RX": "SERVO_RX", "send": "SERVO_SEND", "SDA": "SDA", "SCL": "SCL"}  # in the drawing, in the flags


def drawn(name: str) -> list[str]:
    """Texts of a drawing, in order."""
    return [text.text or "" for text in ET.parse(ROOT / "docs" / "figures" / name).iter("{http://www.w3.org/2000/svg}text")]


def test_page_and_drawing_of_the_wires_have_the_pins_of_platformio():
    pins = {name: value for name, value in flags().items() if name.startswith("FJ_PIN_")}
    assert dict((flag, pin) for pin, flag in re.findall(r"\| GPIO(\d+) \| `(FJ_PIN_\w+)` \|", PAGE)) == pins
    shown = dict(re.findall(r"(\w+), GPIO(\d+)", "\n".join(drawn("tank_wiring.svg"))))
    assert {f"FJ_PIN_{NAMES[name]}": pin for name, pin in shown.items()} == pins


def test_shunt_and_servos_of_the_drawing_are_those_of_the_firmware():
    texts = drawn("tank_wiring.svg")
    assert f"shunt {1000 * float(flags()['FJ_SHUNT_OHM'].rstrip('f')):g} mOhm" in texts
    numbers = flags()["FJ_SERVO_IDS"].split(",")
    for name in ("tank_wiring.svg", "tank_wiring_usb.svg"):
        assert [text.split()[-1] for text in drawn(name) if text.startswith("number ")] == numbers


def test_the_page_says_that_nothing_was_built():
    assert "Nothing on this page was built" in PAGE and "No target build of the firmware was made" in PAGE
    assert all(any("Not built" in text for text in drawn(name)) for name in ("tank_wiring.svg", "tank_wiring_usb.svg"))
