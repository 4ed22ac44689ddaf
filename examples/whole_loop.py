"""A robot gets 150 ms more latency and a horn that is 10 deg off. Its user does not know, and goes the whole way.

    python examples/whole_loop.py [FOLDER]        some 20 minutes on two cores; the same command goes on where it stopped

Twelve experiments while the robot is healthy, its water calibrated to them. Then the fault: the same experiments, `gap find`,
`gap apply`, a training in the patched model, and swims before and after. The robot is the loopback robot of seed 0, in lockstep:
faster than real time. Everything is synthetic. Each command is shown as you would type it; on a robot in a tank leave out
--loopback and name --link and --camera.
"""

import sys
from pathlib import Path

from fishmj.base import console
from studies.whole_loop.robots import chain, row_of
from studies.whole_loop.steps import Fault, Loop

SEED = 0  # fixed before the first run


def tell(loop: Loop) -> dict:
    """The story of one robot; what came of it."""
    log = loop.folder(SEED) / "log.txt"
    for step in chain():
        begin = log.stat().st_size if log.exists() else 0
        step.do(loop, SEED)
        with log.open(encoding="utf-8") as text:
            text.seek(begin)
            console.say(*(line.rstrip() for line in text if line.startswith("$ ")))
    row, fault = row_of(loop, SEED), Fault.of(SEED)
    console.say("", f"hidden: latency {1e3 * fault.delay:.0f} ms, horn {fault.horn} {fault.angle_deg:g} deg")
    console.say(
        f"{row['answer']}: {', '.join(row['named']) or 'nothing'}; counted in: {', '.join(row['counted_in']) or 'nothing'}"
    )
    for what, unit in (("delay_ms", "ms"), ("zeros_deg", "deg, sum of the three zeros")):
        if row[what] is not None:
            console.say(f"  {row[what]:.1f} {unit}")
    for arm, about in (
        ("healthy", "before the fault"),
        ("before", "with the fault, the same policy"),
        ("unpatched", "a policy trained in the model as it was"),
        ("after", "a policy trained in the patched model"),
    ):
        if row[f"rmse_{arm}"] is not None:
            console.say(f"RMSE {row[f'rmse_{arm}']:.3f} m {about}")
    return row


if __name__ == "__main__":
    tell(Loop(out=Path(sys.argv[1] if len(sys.argv) > 1 else "runs/whole_loop_example")))
