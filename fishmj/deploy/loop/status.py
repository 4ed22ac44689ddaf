"""One live line during a swim: state, distance, age of the pose, battery, late ticks. On a pipe, a plain line now and then."""

from contextlib import suppress

from fishmj.base import console
from fishmj.deploy.loop.observation import ObservationBuilder
from fishmj.deploy.loop.supervisor import Condition, Decision, SwimState, named
from fishmj.deploy.loop.ticker import Ticker
from fishmj.deploy.loop.watch import ConditionWatch, supply

WAITING = (SwimState.DOWN, SwimState.LINKED, SwimState.ARMED)


class StatusLine:
    """A progress line over the seconds of a swim. seconds: of the swim. quiet: show nothing."""

    def __init__(self, seconds: float, quiet: bool = False):
        self._bar = None if quiet else console.Progress(seconds, "swim", "s")
        self._waits, self._told = "", -float("inf")
        self._most = 0.999 * seconds  # a bar that is full would print at every tick of the way home

    def show(
        self, seconds: float, now: float, decision: Decision, observer: ObservationBuilder, watch: ConditionWatch, ticker: Ticker
    ) -> None:
        """Reports the state at `now`, `seconds` into the swim; prints only when a line is due."""
        if self._bar is None:
            return
        fields: dict[str, object] = {"state": decision.state.name}
        if decision.because:
            fields["because"] = named(decision.because)
        if seconds <= 0.0 and decision.state in WAITING:
            self._wait(f"waiting for robot and camera, {decision.state.name}", named(decision.because & ~Condition.HEARD), now)
            return
        if (pose := observer.pose) is not None:
            x, y = observer.target
            fields["distance"] = f"{((pose.x - x) ** 2 + (pose.y - y) ** 2) ** 0.5:.2f} m"
            fields["pose"] = f"{1e3 * (now - pose.t):.0f} ms old"
        if watch.newest is not None and (volts := supply(watch.newest)) is not None:
            fields["battery"] = f"{volts:.2f} V"
        try:
            self._bar.update(min(seconds, self._most), **fields, late=ticker.late, dropped=ticker.dropped)
        except OSError:  # the terminal is gone: nobody looks, and the swim comes to its own end
            self._bar = None

    def _wait(self, text: str, because: str, now: float) -> None:
        """Names the cause of waiting, at most once a second and on changes."""
        message = text + (f": {because}" if because else "")
        if self._bar is None or message == self._waits or now - self._told < 1.0:
            return
        self._waits, self._told = message, now
        with suppress(OSError):
            self._bar.stage(message)

    def warn(self, text: str) -> None:
        """Prints a line of its own, even if nothing else is shown."""
        with suppress(OSError):
            self.close()
            console.warn(text)

    def close(self) -> None:
        """Ends the line and leaves it on the terminal."""
        if self._bar is not None:
            self._bar.__exit__(None, None, None)
