"""What the sensors of one robot make of the truth: the measurement effects and delays of its description.

    poses     frames of the camera as the tracker finds them: camera_scale, marker_offset, ..
    joints    encoder readings: offset, and the delay of the clock `joint`, linear between bus ticks
    ticks     delays of the clocks `pose` and `velocity`, s, in whole bus ticks, rounded up as the camera's latency is

Without such effects every function returns what it was given. Rewards, ends of episodes and logs of the truth never pass here.
"""

from math import ceil

from fishmj.effects import EffectStack
from fishmj.effects.sites import Measured
from fishmj.engines.extensions import Extensions
from fishmj.mjcf.description import Robot


class Sensors:
    """The sensors of `robot`.

    Attributes:
        behind: bus ticks of encoder readings to keep besides the newest. frames: camera frames to keep besides the nominal ones.
    """

    def __init__(self, robot: Robot):
        self.added, self.tick = Extensions.of(robot), robot.timing.bus_dt
        whole = lambda seconds: ceil(seconds / self.tick - 1e-6)
        self.behind = whole(self.added.latest("joint"))
        self.slow = whole(self.added.latest("velocity"))
        self.frames = whole(self.added.latest("pose")) + self.slow
        active = self.added.active
        self.measured = active if active is not None and any(e.measure for e in active.effects) else None

    def ticks(self, xp, seconds, rows, clock: str):
        """A latency (B,) s and what the effects with parameters `rows` (B, P) add to it, in whole ticks, 0 at least."""
        return xp.maximum(xp.ceil((seconds + self.added.late(xp, rows, clock)) / self.tick - 1e-6), 0.0).astype("int32")

    def poses(self, xp, rows, history):
        """Poses (B, H, 3) as the tracker reports them."""
        if self.measured is None:
            return history
        zero = 0.0 * history[..., 0]
        seen = measure(
            self.measured, xp, rows, Measured(zero, history[..., 0], history[..., 1], history[..., 2], history * 0.0, zero)
        )
        return xp.stack([seen.x + zero, seen.y + zero, seen.yaw + zero], -1)

    def joints(self, xp, rows, recent):
        """Joint angles and rates (B, J) as the encoders report them now, from `recent` (B, behind + 1, 2 J), newest last."""
        joints = recent.shape[-1] // 2
        now = recent[:, -1]
        if self.behind:
            late = xp.minimum(xp.maximum(self.added.late(xp, rows, "joint") / self.tick, 0.0), float(self.behind))
            older = xp.minimum(xp.floor(late), self.behind - 1.0)
            share = (late - older)[:, None]
            row = xp.arange(recent.shape[0])
            newer = recent.shape[1] - 1 - older.astype("int32")
            now = (1.0 - share) * recent[row, newer] + share * recent[row, newer - 1]
        angle, rate = now[:, :joints], now[:, joints:]
        if self.measured is not None:
            zero = 0.0 * angle[:, None, 0]
            angle = measure(self.measured, xp, rows, Measured(zero, zero, zero, zero, angle[:, None], zero)).joint[:, 0]
        return angle, rate


def measure(active: EffectStack, xp, rows, seen: Measured) -> Measured:
    """What the effects with parameters `rows` (B, P) make of records (B, T)."""
    return active.measure(xp, [rows[:, i : i + 1] for i in range(rows.shape[1])], seen)


def readings(xp, joint, rate):
    """Encoder readings (B, T, 2 J) of a trace."""
    return xp.concatenate([joint, rate], -1)
