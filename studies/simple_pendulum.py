"""Description of a measured pendulum with a quasi-direct-drive motor, without friction, for `fishmj gap find --model`.

    fishmj gap fetch simple_pendulum --out DIR
    python -m studies.simple_pendulum DIR --out OUT
    fishmj gap find OUT/logs --model OUT/pendulum_bare.xml --yes --out REPORT

The logs are of github.com/dfki-ric-underactuated-lab/torque_limited_simple_pendulum (BSD-3). Mass and length are those of the
authors' URDF. OUT/logs has two of the three logs: the torques of pd.csv do not fit its motion as those of the other two do.
"""

from collections.abc import Iterator
from pathlib import Path

from studies.robot_files import pendulum, write_robot_files

MASS, LENGTH = 0.6755, 0.5  # kg, m


def files(data: Path) -> Iterator[tuple[str, str]]:
    """The description, and the logs that are searched."""
    yield "pendulum_bare.xml", pendulum("joint", MASS, LENGTH, own=0.002)
    for name in ("ddp.csv", "direct_collocation.csv"):
        yield f"logs/{name}", (data / "measured" / name).read_text(encoding="utf-8")


if __name__ == "__main__":
    write_robot_files(__doc__, files)
