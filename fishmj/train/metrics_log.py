"""metrics.jsonl: one line of figures an iteration, whole or not at all; TensorBoard events where tensorboardX is installed."""

import errno
import json
import os
from pathlib import Path

from fishmj import store


class MetricsLog:
    """Figures of one run. A run that goes on from step `after` drops the lines beyond it: it will write them again.

    assessed: the step of the last assessment that the run goes on from; lines of later ones are dropped, too.
    """

    def __init__(self, folder: Path, after: int = 0, assessed: int = 0):
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / "metrics.jsonl"
        if self.path.exists():
            store.write_text(self.path, "".join(_until(after, assessed, self.path.read_text(encoding="utf-8"))))
        try:
            from tensorboardX import SummaryWriter
        except ImportError:
            self.events = None
        else:
            self.events = SummaryWriter(str(folder / "events"))

    def write(self, step: int, figures: dict) -> None:
        """Append one line. Raises OSError, with the file as it was, when there is no room for all of it."""
        line = (json.dumps({"step": step, **figures}) + "\n").encode()
        with open(self.path, "ab", buffering=0) as lines:
            size = os.fstat(lines.fileno()).st_size
            try:
                if lines.write(line) < len(line):
                    raise OSError(errno.ENOSPC, f"disk full: needs {len(line)} bytes", str(self.path))
            except OSError:
                lines.truncate(size)
                raise
        if self.events is not None:
            for name, value in figures.items():
                self.events.add_scalar(name, value, step)


def _until(step: int, assessed: int, text: str) -> list[str]:
    """The lines up to `step`, those of assessments up to `assessed`; a last line that a kill cut short is none."""
    whole = [line + "\n" for line in text.split("\n")[:-1]]
    rows = [json.loads(line) for line in whole]
    last = [assessed if any(key.startswith("tune_") for key in row) else step for row in rows]
    return [line for line, row, end in zip(whole, rows, last, strict=True) if row["step"] <= end]
