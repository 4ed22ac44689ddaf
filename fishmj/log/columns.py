"""What a column of the log measures: its unit, for files that carry units (MCAP schemas, Parquet fields)."""

import re

from fishmj.log.trial import table_spec

BY_KIND = {"angle": "rad", "heading": "rad", "rate": "rad/s", "position": "m", "speed": "m/s"}
BY_NAME = {
    **{"t": "s", "t_rx": "s", "V": "V", "I": "A", "frequency": "Hz", "ax": "m/s^2", "ay": "m/s^2", "az": "m/s^2"},
    **{"temp#": "deg C", "f#x": "N", "f#y": "N", "m#": "N m", "r#x": "N", "r#y": "N", "n#": "N m", "a#": "1"},
}


def unit(table: str, column: str) -> str:
    """Unit of a column; "" where the schema names none (counts, qualities, observations, columns beyond the schema).

    Raises:
        UnknownName: no such table.
    """
    return BY_KIND.get(table_spec(table).kind(column), "") or BY_NAME.get(re.sub(r"\d+", "#", column), "")
