"""A top-view film or still of the same scene as the page, drawn on the CPU: works without a screen or a browser."""

from pathlib import Path

import numpy as np

from fishmj.base.console import printable
from fishmj.base.errors import ConfigError, LogError, StoreError
from fishmj.base.store import temporary_beside, write_bytes
from fishmj.log import Trial
from fishmj.mjcf.description import Robot
from fishmj.mjcf.from_above import FromAbove, coarse_skin, opencv
from fishmj.view.replay.replay_data import ARRIVAL, TRACKS, Track, Wake, colours, read_wake, robot_of, tracks_of

INK = (250, 244, 236)  # BGR
WORDS = 120  # characters of a line
CHART = 120  # px, height of the distance strip


def write_mp4(
    trials: list[Trial],
    out: str | Path,
    robot: "Robot | str | None" = None,
    *,
    fps: float = 25.0,
    speed: float = 1.0,
    size: tuple[int, int] = (960, 720),
    title: str = "",
    fields: str | Path | None = None,
) -> Path:
    """Writes a film of one trial, or of several overlaid; `speed` times real time. The codec is mp4v.

    `fields`: folder with the vorticity slices of the first trial.

    Raises LogError: no trial, or one without a pose; StoreError: OpenCV could not write the file.
    """
    cv2 = opencv()
    out = Path(out)
    if not 0 < speed <= 100 or fps <= 0:
        raise ConfigError(f"speed = {speed}, fps = {fps}; expected a speed in (0, 100] and a positive frame rate")
    view = TopView(trials, robot, size=size, title=title, fields=fields)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{out}: its folder cannot be made ({error.strerror or error}); choose another place") from error
    temporary = temporary_beside(out, ".mp4")
    film = cv2.VideoWriter(str(temporary), cv2.VideoWriter_fourcc(*"mp4v"), fps, size)
    if not film.isOpened():
        raise StoreError(f"{out}: OpenCV cannot write mp4 here; check the folder, or install opencv-python-headless again")
    try:
        for time in np.arange(0, view.duration + 0.5 / fps, speed / fps):
            film.write(view.frame(time))
        film.release()
        if not temporary.is_file() or not temporary.stat().st_size:
            raise StoreError(f"{out}: OpenCV wrote no film; is the disk full?")
        temporary.replace(out)
    finally:
        film.release()
        temporary.unlink(missing_ok=True)
    return out


def write_png(trials: list[Trial], out: str | Path, time: float, robot: "Robot | str | None" = None, **options) -> Path:
    """Writes one picture at `time` [s] from the start; options as of `TopView`."""
    done, data = opencv().imencode(".png", TopView(trials, robot, **options).frame(time))
    if not done:
        raise StoreError(f"{out}: OpenCV could not encode a PNG")
    return write_bytes(out, data.tobytes())


class TopView:
    """Draws frames (H, W, 3) uint8 BGR of overlaid trials, seen from above with north (+y) up."""

    def __init__(self, trials, robot=None, *, size: tuple[int, int] = (960, 720), title: str = "", fields=None):
        if not trials:
            raise LogError("nothing to replay: give at least one trial")
        self.cv2, self.size, self.title = opencv(), size, title
        robots = [robot_of(trial, robot) for trial in trials]
        self.tracks = tracks_of(trials, robots)
        self.skins = [coarse_skin(one) for one in robots]
        self.colours = [tuple(int(TRACKS[i % len(TRACKS)][k : k + 2], 16) for k in (5, 3, 1)) for i in range(len(trials))]
        self.duration = max(float(t.t[-1]) for t in self.tracks)
        points = np.concatenate([a for t in self.tracks for a in (t.q[:, :2], t.target[np.isfinite(t.target).all(1)])])
        low, high = points.min(0) - 0.45, points.max(0) + 0.45
        width, height = size[0], size[1] - CHART
        self.scale = float(min(width / max(high[0] - low[0], 1.6), height / max(high[1] - low[1], 1.6)))  # px/m
        self.view = FromAbove(size, (low + high) / 2, self.scale, (width / 2, height / 2))
        self.still = self._background()
        self.wake = None if fields is None else read_wake(fields, trials[0], self.tracks[0])
        self.table = colours()

    def frame(self, time: float) -> np.ndarray:
        """The picture at `time`, s from the start."""
        image = self.still.copy()
        if self.wake is not None:
            self._vorticity(image, time, self.wake)
        for t, skin_, colour in reversed(list(zip(self.tracks, self.skins, self.colours, strict=True))):
            i = t.frame(time)
            self._trail(image, t, i, colour)
            self.view.swimmer(image, t.q[i], t.target[i], skin_, None if colour == self.colours[0] else colour)
            self._wind(image, t, i)
        self._chart(image, time)
        self._words(image, time)
        return image

    def _background(self) -> np.ndarray:
        image = self.view.water()
        flow = self.tracks[0].mean_flow
        if np.isfinite(flow).all() and np.hypot(*flow) > 1e-3:
            self._arrows(image, flow)
        return image

    def _vorticity(self, image, time: float, wake: Wake) -> None:
        """Draws the slices before and after `time`, mixed, over the water, and the colour scale in the corner."""
        size = (self.size[0], self.size[1] - CHART)
        a, share = wake.between(time)
        value, there = 0.0, 0.0
        for i, part in ((a, 1 - share), (min(a + 1, len(wake.t) - 1), share)):
            west, east, south, north = wake.rect[i]
            cell = self.scale * (east - west) / wake.values[i].shape[1]  # px
            corner = self.view.pixel((west, north)) + 0.5 * cell - 0.5  # middle of the first cell
            place = np.array([[cell, 0, corner[0]], [0, cell, corner[1]]])
            warp = lambda field, place=place: self.cv2.warpAffine(field, place, size, flags=self.cv2.INTER_LINEAR)
            there = there + part * warp(np.ones(wake.values[i].shape, np.float32))
            value = value + part * warp(wake.values[i].astype(np.float32) - 128)
        rgba = self.table[np.clip(value / np.maximum(there, 1e-3) + 128.5, 0, 255).astype(np.uint8)].astype(np.float32)
        cover = (there * rgba[..., 3] / 255)[..., None]
        water = image[: size[1]]
        water[:] = (1 - cover) * water + cover * rgba[..., 2::-1] + 0.5
        left, bar = size[0] - 224, np.linspace(1, 255, 208).astype(np.uint8)
        water[14:24, left : left + 208] = self.table[bar][:, 2::-1]
        for at, words in ((0, f"-{wake.strong:g}"), (88, "vorticity 1/s"), (176, f"+{wake.strong:g}")):
            self._text(image, words, (left + at - (36 if at == 88 else 0), 42), 0.45)

    def _arrows(self, image, flow) -> None:
        layer = image.copy()
        unit, pitch = flow / np.hypot(*flow), 130
        for px in range(pitch // 2, self.size[0], pitch):
            for py in range(pitch // 2, self.size[1] - CHART, pitch):
                tip = np.array([px, py]) + unit * [1, -1] * (12 + 90 * np.hypot(*flow))
                self.cv2.arrowedLine(layer, (px, py), tuple(int(v) for v in tip), INK, 2, self.cv2.LINE_AA, tipLength=0.3)
        self.cv2.addWeighted(layer, 0.35, image, 0.65, 0, dst=image)

    def _trail(self, image, t: Track, i: int, colour) -> None:
        if i > 1:
            layer = image.copy()
            self.view.line(layer, t.q[: i + 1 : 2, :2], colour, 2)
            self.cv2.addWeighted(layer, 0.6, image, 0.4, 0, dst=image)

    def _wind(self, image, t: Track, i: int) -> None:
        speed = np.hypot(*t.flow[i])
        if not speed > 1e-3:
            return
        start = self.view.pixel(t.q[i, :2]) - [0, 0.16 * self.scale]
        end = start + t.flow[i] * [1, -1] * (0.6 * self.scale)
        a, b = (tuple(int(v) for v in p) for p in (start, end))
        self.cv2.arrowedLine(image, a, b, (255, 240, 126), 3, self.cv2.LINE_AA, tipLength=0.35)

    def _chart(self, image, time: float) -> None:
        """Draws distance over time in the strip below; speed over ground if no log has a target."""
        w, top, h = self.size[0], self.size[1] - CHART, CHART
        image[top:] = (image[top:] * 0.1 + np.array([38, 26, 8])).astype(np.uint8)
        aimed = any(np.isfinite(t.distance).any() for t in self.tracks)
        curves = [t.distance if aimed else t.speed for t in self.tracks]
        high = 1.08 * max([0.2, *(float(np.nanmax(c)) for c in curves if np.isfinite(c).any())])
        x = lambda s: 56 + (w - 72) * np.asarray(s) / self.duration
        y = lambda d: top + h - 22 - (h - 34) * np.asarray(d) / high
        for d in np.linspace(0, high / 1.08, 3):
            self.cv2.line(image, (56, int(y(d))), (w - 16, int(y(d))), (88, 76, 58), 1)
            self._text(image, f"{d:.1f} {'m' if aimed else 'm/s'}", (8, int(y(d)) + 4), 0.4)
        if aimed:
            self.cv2.line(image, (56, int(y(ARRIVAL))), (w - 16, int(y(ARRIVAL))), (106, 212, 63), 1)
        for t, curve, colour in zip(self.tracks, curves, self.colours, strict=True):
            keep = np.isfinite(curve)
            line = np.stack([x(t.t[keep]), y(curve[keep])], -1)
            self.cv2.polylines(image, [np.round(line * 16).astype(np.int32)], False, colour, 2, self.cv2.LINE_AA, 4)
        at = int(x(min(time, self.duration)))
        self.cv2.line(image, (at, top + 6), (at, top + h - 20), INK, 1)
        self._text(image, "distance to the target" if aimed else "speed over ground", (60, top + 14), 0.42)
        self._text(image, f"{time:.1f} / {self.duration:.1f} s", (w - 130, top + h - 6), 0.45)

    def _words(self, image, time: float) -> None:
        lines = [self.title[:WORDS]] if self.title else []
        for t in self.tracks:
            i = t.frame(time)
            measured = [(t.distance[i], "m off", 2), (t.speed[i], "m/s", 2), (t.power[i], "W", 1)]
            figures = [f"{value:.{digits}f} {unit}" for value, unit, digits in measured if np.isfinite(value)]
            lines.append(f"{t.label[:WORDS]} ({t.origin[:WORDS]})  " + ", ".join(figures))
        box = image[6 : 16 + 22 * len(lines), 6 : 16 + max(9 * len(line) for line in lines)]
        box[:] = (box * 0.3 + np.array([24, 16, 5])).astype(np.uint8)
        for k, line in enumerate(lines):
            self._text(image, line, (14, 26 + 22 * k), 0.55, self.colours[k - len(lines)] if k >= bool(self.title) else INK)

    def _text(self, image, text: str, at, height: float, colour=INK) -> None:
        plain = printable(text)[:WORDS].encode("ascii", "replace").decode()  # OpenCV's built-in font has ASCII only
        self.cv2.putText(image, plain, at, self.cv2.FONT_HERSHEY_SIMPLEX, height, colour, 1, self.cv2.LINE_AA)
