"""The moving picture of the README: a shipped policy holds station in the flow solver, beside the vorticity that it sheds.

    python -m studies.station_film             swims and draws; two cores
    python -m studies.station_film --drawn     draws the existing swim again

One trial of the judge's (0.2 m/s, target straight upstream), in a box that follows the fish: 128 x 56 x 30 cells of 2 cm.
That is too small and too coarse for a judgement, and enough for a picture. The policy sees neither the current nor the water.
"""

from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np

from fishmj.base import console
from fishmj.base.store import write_bytes
from fishmj.engines import Trace
from fishmj.engines.lbm import LbmEngine
from fishmj.evaluate import protocol, run_trials
from fishmj.evaluate.trial_logs import trial_of
from fishmj.lbm_oracle.fluid.domain_faces import SPONGE
from fishmj.lbm_oracle.output.record_fields import FieldRecorder
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import preset
from fishmj.log import read_trial, write_trial
from fishmj.mjcf import load_robot
from fishmj.mjcf.from_above import FromAbove, opencv
from fishmj.mjcf.skin import skin
from fishmj.view.replay.replay_data import ARRIVAL, colours, read_wake, track

POLICY, SPEED, SECONDS = "station", 0.2, 10.0  # m/s, s of the trial
BOX = replace(preset("laptop"), shape=(128, 56, 30))
EVERY, START = 0.08, 1.6  # s between two frames; s of the trial at which the picture begins
SIZE, WIDTH, AHEAD = (720, 400), 1.45, 0.45  # pixels; m across the picture; m of water in front of the target
STRONG = 5.0  # 1/s at the ends of the colour scale
INK = (250, 244, 236)  # BGR


class Filmed(LbmEngine):
    """The flow solver with one tank and a slice of its vorticity every `EVERY` s, into `folder`."""

    def __init__(self, robot, flows, folder: Path, device: str):
        super().__init__(robot, flows, device=device)
        self.domain, self.folder = BOX, folder
        self.recorder: FieldRecorder | None = None

    def _fill(self, state, params):
        """Fills the tanks as `LbmEngine`, without pipelining, because the recorder reads the water between two ticks."""
        tanks = yield from super()._fill(state, params)
        for run in tanks.runs:
            run.pipelined = False
        return tanks

    def advancing(self, state, commands, params, current, tick):
        """Advances as `LbmEngine.advancing`, one bus tick at a time, and records the water after each."""
        traces = []
        for k in range(commands.shape[1]):
            state, trace = yield from super().advancing(state, commands[:, k : k + 1], params, current, tick)
            traces.append(trace)
            (run,) = self.tanks.runs
            if self.recorder is None:
                self.recorder = FieldRecorder(self.folder, run, every=EVERY, overwrite=True)
                self.recorder.frames = 1  # the water before the first tick is not kept
            self.recorder.record(run)
        return state, Trace(*(np.concatenate(column, 1) for column in zip(*traces, strict=True)))


def swim(folder: Path, device: str, seconds: float = SECONDS) -> None:
    """Runs the trial in the solver; writes `folder`/trial and `folder`/fields."""
    plan = protocol.trials(speeds=[SPEED], los_deg=[0], repeats=1, duration=seconds)
    robot = load_robot("fish")
    engine = Filmed(robot, plan.flows(), folder / "fields", device)
    with console.Progress(seconds, f"{POLICY} in the flow solver", unit="s") as bar:
        result = run_trials.run(POLICY, robot, plan, engine, progress=lambda k: bar.update(k * robot.timing.control_dt))
    write_trial(folder / "trial", trial_of(result, 0), overwrite=True)


def drawn(folder: Path, start: float = START) -> list[np.ndarray]:
    """RGB frames of the swim in `folder`, in the colours of a replay; the camera is at rest, the sponge fades out."""
    cv2, trial, robot = opencv(), read_trial(folder / "trial"), load_robot("fish")
    path, body = track(trial, robot), skin(robot, spacing=0.012, around=12, smooth=True)
    wake, tones, target = read_wake(folder / "fields", trial, path), colours(), path.target[-1]
    scale, frames = SIZE[0] / WIDTH, []
    view = FromAbove(SIZE, target + [0.5 * WIDTH - AHEAD, 0.0], scale, (SIZE[0] / 2, SIZE[1] / 2))
    rows, columns = (np.minimum(np.arange(n), np.arange(n)[::-1]) / SPONGE for n in wake.values[0].shape)
    inside = np.clip(np.minimum(rows[:, None], columns) - 0.5, 0, 1)
    for time, rect, value in zip(wake.t, wake.rect, wake.values, strict=True):
        if time < start:
            continue
        west, east, _, north = rect
        cell = scale * (east - west) / value.shape[1]
        x, y = view.pixel((west, north)) + 0.5 * cell - 0.5  # middle of the first cell
        omega = ((value.astype(float) - 128) * inside * (wake.strong / STRONG)).astype(np.float32)
        omega = cv2.warpAffine(omega, np.array([[cell, 0, x], [0, cell, y]]), SIZE, flags=cv2.INTER_CUBIC)
        rgba = tones[np.clip(omega + 128.5, 1, 255).astype(np.uint8)].astype(np.float32)
        cover = rgba[..., 3:] / 255
        image = ((1 - cover) * view.water() + cover * rgba[..., 2::-1] + 0.5).astype(np.uint8)
        k = min(round(time / path.t[1]), len(path.t) - 1)
        view.target(image, target, ARRIVAL, bool(path.distance[k] <= ARRIVAL))
        view.fish(image, path.q[k], body)
        words(image, f"{time:4.1f} s   {100 * path.distance[k]:3.0f} cm from the target")
        frames.append(image[:, :, ::-1].copy())
    return frames


def words(image: np.ndarray, below: str) -> None:
    """Writes the caption, the line `below`, and the current with its arrow into the image."""
    cv2, low = opencv(), SIZE[1] - 12
    write = lambda text, at: cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.48, INK, 1, cv2.LINE_AA)
    write(f"policy '{POLICY}' in the flow solver: vorticity at mid-depth, red turns left (synthetic)", (12, 22))
    write(below, (12, low))
    write(f"current {SPEED:g} m/s", (SIZE[0] - 130, low))
    ends = [(SIZE[0] - x, low - 5) for x in (180, 140)]
    cv2.arrowedLine(image, *ends, INK, 2, cv2.LINE_AA, tipLength=0.3)


def animated(frames: list[np.ndarray], quality: int = 60) -> bytes:
    """An endless WebP of RGB frames (H, W, 3) uint8."""
    from PIL import Image

    first, *rest = map(Image.fromarray, frames)
    data, shown = BytesIO(), round(1000 * EVERY)
    first.save(data, "WEBP", save_all=True, append_images=rest, duration=shown, loop=0, quality=quality, method=4)
    return data.getvalue()


def options() -> console.Parser:
    """Parser of the study."""
    p = console.parser("studies.station_film", "The moving picture of the README.", json=False)
    p.add_argument("--device", default="auto", help="auto, cpu or cuda (default: %(default)s)")
    p.add_argument("--folder", type=console.out_folder, default="runs/station_film", help="of trial and fields")
    p.add_argument("--drawn", action="store_true", help="draw the swim that is in --folder; do not swim again")
    p.add_argument("--out", type=console.path, default="docs/figures/station.webp", help="(default: %(default)s)")
    return p


def main(argv: list[str]) -> int:
    """Swims, draws and writes; returns the exit code."""
    args = options().parse_args(argv)
    if not args.drawn:
        solver_cost.agree("station_film", args.device, [(BOX, SECONDS)], instead="take another machine")
        swim(Path(args.folder), args.device)
    out = write_bytes(args.out, animated(drawn(Path(args.folder))))
    console.say(f"wrote {out} ({out.stat().st_size / 1e6:.2f} MB)")
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
