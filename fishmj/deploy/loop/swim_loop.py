"""The swim, tick by tick: listen, look, decide, command, record.

    tick     on the 20 ms grid (`ticker`)
    listen   packets of the robot, fixes of the tracker -> observation (`observer`), ages and faults (`watch`)
    decide   state and action from the conditions (`supervisor`)
    command  of the policy, held, or on the way to zero; within the joints' limits (`limits`); over the link (`links`)
    write    requests, commands, packets and fixes (`trial_log`)

It ends in NEUTRAL in every case: joints to zero, torque off, log closed. If a servo is hot, jammed or silent, or the
operator stops the way to zero, the torque goes off at once.
"""

import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from math import hypot

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.control.learned import LearnedController
from fishmj.deploy.camera.localiser import Localiser
from fishmj.deploy.link.links import RobotLink
from fishmj.deploy.loop.arming import Refusal, asked_at_the_tank, examine, servos_at_fault, why_not_armed
from fishmj.deploy.loop.clock import Clock
from fishmj.deploy.loop.command_limits import Limiter, towards_zero
from fishmj.deploy.loop.observation import ObservationBuilder
from fishmj.deploy.loop.pilot import Pilot, PolicyPilot
from fishmj.deploy.loop.status import StatusLine
from fishmj.deploy.loop.supervisor import NONE, Action, Condition, Decision, Supervisor, SwimState, decide, named
from fishmj.deploy.loop.ticker import Tick, Ticker
from fishmj.deploy.loop.trial_log import TrialLog
from fishmj.deploy.loop.watch import ConditionWatch, Thresholds
from fishmj.deploy.loop.wiring import Wired
from fishmj.deploy.protocols.messages import RobotInfo, RobotState
from fishmj.engines import command_latency
from fishmj.mjcf.description import Robot

GREET, ASK = 10, 5  # ticks between two greetings, and between two requests to arm
GUARDS = 0.5  # s from the first packet that arming waits for slow measurements which a guard wants
HOME = 2.0  # s that the way to zero may take
LET_GO = 10  # ticks in which the robot is told to let go, until it says that it has
RECENT = 10.0  # s at the end of a swim, whose distance from the target is said by itself
POSE = Condition.POSE_OLD | Condition.POSE_LOST | Condition.POSE_JUMP | Condition.LEFT_TANK


@dataclass(kw_only=True)
class Rig:
    """Opened devices around the tank, kept for several swims.

    Attributes:
        examine: reasons against arming, from the robot's identification (`arming.examine`); None before it arrived.
    """

    robot: Robot
    link: RobotLink
    localiser: Localiser
    clock: Clock
    examine: Callable[[RobotInfo | None], Refusal]
    supervisor: Supervisor = field(default_factory=Supervisor)

    @classmethod
    def of(
        cls, wired: Wired, robot: Robot, controller: LearnedController | None, said: bool, ask: Callable[[str], bool],
        session: str = "",
    ) -> "Rig":  # fmt: skip
        """Opened devices as a rig that arms for this robot and policy (None: no policy), by the rules of `arming`.

        said, ask: as of `arming.asked_at_the_tank`.

        Raises ConfigError: no watchdog and no person at the tank, named by `session`, whose other swims would not arm either.
        """
        link, there = wired.link, wired.loopback or asked_at_the_tank(wired.link, said, ask)
        if session and not (link.watched or there):
            raise ConfigError(f"{session}: {link.name} has no watchdog; add --i-am-at-the-tank once a person stands there")
        arms = lambda info: examine(link, info, robot, controller, there)
        return cls(robot=robot, link=link, localiser=wired.localiser, clock=wired.clock, examine=arms)


@dataclass(frozen=True, kw_only=True)
class SwimPlan:
    """One swim. target: m, tank frame. wait: s to wait for robot and camera.

    hold, neutral: s without a command after which the firmware holds and goes to neutral. pose: the pilot needs the camera.
    bound: m, the fish may swim within |x| and |y| of at most this. thresholds: of the watch; None: with the robot's low voltage.
    """

    target: tuple[float, float] = (0.0, 0.0)
    seconds: float = 30.0
    wait: float = 10.0
    hold: float = 0.1
    neutral: float = 0.3
    pose: bool = True
    bound: float = float("inf")
    thresholds: Thresholds | None = None


@dataclass(frozen=True, kw_only=True)
class SwimOutcome:
    """Result of a swim.

    Attributes:
        cause: conditions that led to NEUTRAL; NONE if it never was armed. refused: reasons against arming, permanent or
            momentary.
        swim_seconds: time under the policy, s. figures: counts and times for the log and for people.
        released: True if the robot reported its torque off; None if its protocol cannot, or it never was armed.
        lets_go: True if the protocol can switch the torque off. camera: reason for the end of the poses, "" while they came.
        faulty: servos with a fault at the end, and the voltage of a low battery; "" for none.
        off_target: RMS distance from the target, m, over the poses of the swim, and over those of its last `RECENT` s if it was
            longer; empty for a pilot without a target.
    """

    cause: Condition
    refused: tuple[str, ...]
    swim_seconds: float
    figures: dict
    released: bool | None = None
    lets_go: bool = True
    camera: str = ""
    faulty: str = ""
    off_target: tuple[float, ...] = ()

    @property
    def complete(self) -> bool:
        """Returns True if the swim ended only because its time was over."""
        return self.cause == Condition.FINISHED and self.swim_seconds > 0.0

    @property
    def words(self) -> str:
        """One line for people."""
        if self.cause:
            faulty = f" ({self.faulty})" if self.faulty else ""
            return f"swam {self.swim_seconds:.1f} s; ended by {named(self.cause)}{faulty}{self._blind}{self._off}{self._torque}"
        return f"not armed: {'; '.join(self.refused) or 'stopped'}{self._blind}"

    @property
    def _blind(self) -> str:
        return f" (camera: {self.camera})" if self.camera else ""

    @property
    def _off(self) -> str:
        recent = "".join(f" ({rms:.3f} in the last {RECENT:g} s)" for rms in self.off_target[1:])
        return f"; {self.off_target[0]:.3f} m RMS from the target{recent}" if self.off_target else ""

    @property
    def _torque(self) -> str:
        """Advice about the torque, "" if it is off."""
        if not self.lets_go:
            return "; this robot cannot be told to let go and keeps its torque: use the switch"
        if self.released is None:
            return "; torque off was sent, which this robot cannot confirm"
        return "" if self.released else "; torque NOT confirmed off: use the switch"


class SwimLoop:
    """One swim of a rig under a pilot.

    Args:
        stop: asked at every tick; True if the operator wants an end. person: a person has checked the fish since the last swim.

    Raises ConfigError: the last swim ended in NEUTRAL, and no person has checked the fish.
    """

    def __init__(
        self, rig: Rig, pilot: Pilot, plan: SwimPlan, log: TrialLog, *, stop: Callable[[], bool] = lambda: False,
        person: bool = False, status: StatusLine | None = None,
    ):  # fmt: skip
        if rig.supervisor.state is SwimState.NEUTRAL and not person:
            raise ConfigError("swim: the last swim ended in NEUTRAL; look at the fish, then confirm that it may go on")
        self.rig, self.pilot, self.plan, self.log, self.stop = rig, pilot, plan, log, stop
        self.status = status or StatusLine(plan.seconds, quiet=True)
        self.supervisor, self.dt = rig.supervisor, rig.robot.timing.bus_dt
        thresholds = plan.thresholds or Thresholds(battery_low=rig.robot.low_voltage)
        self.observer, self.watch = ObservationBuilder(rig.robot, plan.target), ConditionWatch(thresholds)
        self.latency = command_latency(rig.robot)
        self.limiter = Limiter(rig.robot.servo.range, self.latency + self.dt, oldest=thresholds.silent)
        self.last = np.zeros(rig.robot.n_joints)  # the command on the bus
        self.info: RobotInfo | None = None
        self.refusal: Refusal | None = None if rig.link.greets else rig.examine(None)
        self.sent: deque[tuple[float, np.ndarray]] = deque(maxlen=50)
        self.latencies: list[float] = []
        self.off: list[tuple[float, float]] = []  # s, m from the target: of the poses while it swims
        self.began: float | None = None  # of SWIMMING
        self.home: float | None = None  # of NEUTRAL
        self.swim_seconds, self.letting_go, self.over = 0.0, 0, False
        self._let_go_at: float | None = None
        self._asked_arm = self._stopped = False
        self._unguarded: tuple[str, ...] = ()
        self._trouble, self._ask_again, self._told = NONE, 0.0, False
        self._faulty = ""
        self._person = person

    def run(self) -> SwimOutcome:
        """Swims to the end. Afterwards the robot is without torque, if its protocol can switch it off.

        A swim that never armed leaves no trial.
        """
        link, clock = self.rig.link, self.rig.clock
        ticker, begun, used = Ticker(clock, self.dt), time.perf_counter(), time.process_time()
        self.start = clock.now()
        link.forget()
        self.pilot.reset()
        try:
            while not self.over:
                tick = ticker.wait()
                self.listen(tick.began)
                decision = self.decide(tick.began)
                self.command(tick, decision)
                self.write(tick.began)
                self.status.show(self.swim_seconds, tick.began, decision, self.observer, self.watch, ticker)
        except BaseException:
            self._let_go_blindly()
            raise
        finally:
            link.disarm(clock.now())
            self.status.close()
        share = (time.process_time() - used) / max(time.perf_counter() - begun, 1e-9)
        outcome = self._outcome(ticker, share)
        if not outcome.cause:
            self.log.discard()
        return outcome

    def _let_go_blindly(self) -> None:
        """Requests torque off ten times after an exception in the loop: no answer is read, and single datagrams may be lost."""
        for _ in range(LET_GO):
            with suppress(Exception):
                self.rig.link.disarm(self.rig.clock.now())
            with suppress(Exception):
                self.rig.clock.sleep_until(self.rig.clock.now() + self.dt / 2)

    def listen(self, now: float) -> None:
        """Reads the packets of the robot and the fixes of the tracker."""
        for t, value in self.rig.link.receive(now):
            if isinstance(value, RobotInfo):
                self.info, self.refusal = value, self.rig.examine(value)
                told = {name: getattr(value, name) for name in ("firmware", "firmware_sha256", "policy_sha256")}
                if (clock := self.rig.link.robot_clock) is not None:
                    told["clock"] = clock._asdict()
                self.log.meta["host"] = {**self.log.meta.get("host", {}), "robot": told}
                continue
            acted = [command for sent, command in self.sent if sent <= t - self.latency]
            self.watch.hear(t, value, acted[-1] if acted else None)
            self.observer.telemetry(t, value)
            self.log.heard(t, value)
        if (failed := getattr(self.rig.localiser, "failed", None)) is not None and not self._told:
            self._told = True
            self.log.say(now, f"camera: {failed}")
        for fix in self.rig.localiser.fixes(now):
            if (pose := self.observer.fix(fix, now)) is not None:
                self.log.fix(pose, float(fix.quality))
                if self.began is not None and self.home is None and pose.t >= self.began:
                    self.off.append((pose.t, hypot(pose.x - self.plan.target[0], pose.y - self.plan.target[1])))

    def decide(self, now: float) -> Decision:
        """Decision of the supervisor from the conditions at `now` [s]."""
        state = self.supervisor.state
        true = self.watch.conditions(now, state, self.observer) | self._trouble
        if (pose := self.observer.pose) is not None and max(abs(pose.x), abs(pose.y)) > self.plan.bound:
            true |= Condition.LEFT_TANK
        if not self.plan.pose:
            true &= ~POSE
        elif Condition.POSE_LOST in true and state in (SwimState.DOWN, SwimState.LINKED):
            self.observer.forget_poses()
        if self.rig.link.greets and self.info is None:
            true &= ~Condition.HEARD
        true |= self.refusal.conditions if self.refusal is not None else NONE
        true |= self._operator(state)
        true |= Condition.PERSON_LEAVES if self._person else NONE
        self._person = False
        if state is SwimState.LINKED and self._may_arm(now, true):
            true |= Condition.ASK_ARM
        if state is SwimState.ARMED and (not self.plan.pose or self.observer.vector() is not None):
            true |= Condition.ASK_SWIM
        if self.began is not None and now - self.began > self.plan.seconds - 1e-9:
            true |= Condition.FINISHED
        waited = now - self.watch.armed if state is SwimState.ARMED and self.watch.armed is not None else 0.0
        if waited > self.plan.wait:  # poses that come, and always too late
            true |= Condition.FINISHED
        decision = self.supervisor.step(now, true)
        self._changed(state, decision.state, now)
        if decision.state in (SwimState.ARMED, SwimState.SWIMMING):
            self._tell_unguarded(now)
        if decision.state in (SwimState.DOWN, SwimState.LINKED):
            self._wait_or_end(now, true)
        return decision

    def _operator(self, state: SwimState) -> Condition:
        """Condition of the operator's stop; a stop on the way to zero means at once."""
        asked = self.stop()
        if state is not SwimState.NEUTRAL or not asked:
            self._stopped = asked
        if not asked:
            return NONE
        return Condition.OPERATOR_STOP if self._stopped else Condition.STOP_NOW

    def _may_arm(self, now: float, true: Condition) -> bool:
        """Asks the robot to arm unless there is an objection; returns True once it reports that it has, if its protocol can.

        A robot with torque from another host is disarmed first, since its firmware leaves NEUTRAL only that way.
        """
        newest = self.watch.newest
        if newest is None or self.observer.reading is None:
            return False
        if decide(SwimState.LINKED, true | Condition.ASK_ARM).state is not SwimState.ARMED:
            return False
        if self.watch.undecided(now):
            return False
        if self.watch.unguarded(now) and self.watch.first is not None and now - self.watch.first < GUARDS:
            return False
        if newest.state is RobotState.ARMED and self._asked_arm:
            return True
        if now < self._ask_again:
            return False
        self._ask_again = now + ASK * self.dt
        if newest.state is None or newest.state is RobotState.IDLE:
            self._asked_arm = True
            self.rig.link.arm(now, self.plan.hold, self.plan.neutral)
            return newest.state is None
        self._asked_arm = False
        self.rig.link.disarm(now)
        return False

    def _tell_unguarded(self, now: float) -> None:
        """Prints the missing guards of the swim, once, and again if one is lost on the way."""
        lacking = self.watch.unguarded(now)
        if set(lacking) - set(self._unguarded):
            self._unguarded = tuple(dict.fromkeys((*self._unguarded, *lacking)))
            self.log.meta["host"] = {**self.log.meta.get("host", {}), "unguarded": list(self._unguarded)}
            text = f"nothing guards against {', '.join(lacking)}"
            self.log.say(now, text)
            self.status.warn(f"{text}: keep an eye on it")

    def _changed(self, before: SwimState, after: SwimState, now: float) -> None:
        """Reacts once to every change of state."""
        if before is after:
            return
        if after is SwimState.ARMED and self.observer.reading is not None:
            self.last = np.array(self.observer.reading.joint)
            self.log.target(now, *self.plan.target)
        if after is SwimState.SWIMMING:
            self.began = now
        if after is SwimState.NEUTRAL:
            self.home, self._faulty = now, self._at_fault(self.supervisor.cause)
            self.swim_seconds = now - self.began if self.began is not None else 0.0
        self.log.event(self.supervisor.events[-1])

    def _wait_or_end(self, now: float, true: Condition) -> None:
        """Before arming: ends the swim on a permanent refusal, on the operator's stop, or after too long a wait."""
        if self.refusal is not None and self.refusal.reasons or Condition.OPERATOR_STOP in true:
            self.over = True
        elif now - self.start > self.plan.wait:
            because = decide(SwimState.LINKED, true).because & ~Condition.HEARD
            reasons = named(because)
            if reasons and (faulty := self._at_fault(because)):
                reasons += f" ({faulty})"
            if self.supervisor.state is SwimState.DOWN:
                reasons = f"nothing heard of the robot in {self.plan.wait:g} s"
                if silence := self.rig.link.silence():
                    reasons = f"{silence}; waited {self.plan.wait:g} s"
            why = why_not_armed(self.watch.newest, self.rig.robot.servo.range, self.plan.hold, self.plan.neutral)
            self.refusal = Refusal(NONE, (reasons or f"the robot did not arm in {self.plan.wait:g} s{why}",))
            self.over = True

    def _at_fault(self, because: Condition) -> str:
        """Servos that report a fault, by their numbers on the bus, and the voltage of a low battery."""
        ids = self.info.servo_ids if self.info is not None else self.rig.robot.servo_ids
        servos = servos_at_fault(self.watch.newest, ids, self.watch.limits)
        battery = self.watch.battery() if Condition.BATTERY_LOW in because else ""
        return "; ".join(told for told in (servos, battery) if told)

    def command(self, tick: Tick, decision: Decision) -> None:
        """Sends the commands of the action."""
        now, link = tick.began, self.rig.link
        if decision.action is Action.LISTEN:
            if self.info is None and tick.slot % GREET == 0:
                link.hello(now)
            return
        asked = self.last
        if decision.action is Action.SWIM:
            asked, decision = self._steered(tick, decision)
        else:
            self.pilot.pause()
        if decision.state is SwimState.NEUTRAL and self._let_go(now, decision):
            return
        if decision.action is Action.RETURN:
            asked = towards_zero(self.last, self.dt)
        reading = self.observer.reading
        if reading is None:
            return
        command = self.limiter(asked, np.array(reading.joint), now - reading.heard)
        t = self.rig.clock.now()
        sent = link.send(command, t)
        self.last = command
        self.sent.append((t, command))
        self.log.command(t, command, asked, sent.seq, decision.state)

    def _steered(self, tick: Tick, decision: Decision) -> tuple[np.ndarray, Decision]:
        """The pilot's command of this tick; if its answer is not finite, the last command, and the decision that follows."""
        found, fresh = self.pilot.command(tick.slot, self.observer.vector, self.last)
        if fresh:
            self.log.decided(tick.began, self.pilot.obs, self.pilot.action)
            if (pose := self.observer.pose) is not None:
                self.latencies.append(self.rig.clock.now() - pose.t)
        if found is not None:
            return found, decision
        self._trouble |= Condition.ACTION_NAN
        self.log.say(tick.began, f"{self.pilot.trouble}; observation {np.array2string(np.asarray(self.pilot.obs), precision=5)}")
        return self.last, self.decide(tick.began)

    def _let_go(self, now: float, decision: Decision) -> bool:
        """In NEUTRAL: disarms once the way to zero is over or broken off; returns True then."""
        at_once = decision.action is Action.LET_GO
        there = bool(np.all(self.last == 0.0)) or self.observer.reading is None
        late = self.home is not None and now - self.home > HOME
        if not (there or late or at_once) and not self.letting_go:
            return False
        if self._let_go_at is None:
            self._let_go_at = now
            if at_once:
                self.log.say(now, f"torque off at once: {named(decision.because)}")
        self.rig.link.disarm(now)
        self.letting_go += 1
        self.over = self._released() is True or self.letting_go >= LET_GO
        return True

    def _released(self) -> bool | None:
        """Returns True if the robot has reported torque off since the request; None if its protocol cannot."""
        newest, heard = self.watch.newest, self.watch.heard
        if self._let_go_at is None or newest is None or heard is None or newest.state is None:
            return None
        return newest.state is RobotState.IDLE and heard > self._let_go_at

    def write(self, now: float) -> None:
        """Updates the figures for the status line and the log."""
        if self.began is not None and self.home is None:
            self.swim_seconds = now - self.began

    def _off_target(self) -> tuple[float, ...]:
        """RMS distances from a policy's target, as of `SwimOutcome`."""
        if not isinstance(self.pilot, PolicyPilot) or not self.off:
            return ()
        t, off = np.array(self.off).T
        spans = [off] if t[-1] - t[0] <= RECENT else [off, off[t > t[-1] - RECENT]]
        return tuple(round(float(np.sqrt(np.mean(span**2))), 4) for span in spans)

    def _outcome(self, ticker: Ticker, share: float) -> SwimOutcome:
        late = np.array(self.latencies or [np.nan]) * 1e3
        figures = {
            "loop": ticker.figures(),
            "cpu_share": round(share, 4),
            "camera_to_command_ms": {"p50": round(float(np.median(late)), 2), "p99": round(float(np.percentile(late, 99)), 2)},
            "link": dict(self.rig.link.counts),
            "camera": dict(self.rig.localiser.counts),
            "fixes_refused": self.observer.jumps,
            "commands_limited": self.limiter.acted,
            "rows_dropped": self.log.dropped,
        }
        off = self._off_target()
        if off:
            figures["off_target_m"] = dict(zip(("rms", f"rms_last_{RECENT:g}_s"), off, strict=False))
        if not self.latencies:
            figures.pop("camera_to_command_ms")
        refused = self.refusal.reasons if self.refusal is not None else ()
        released, lets_go = self._released(), "letting go" not in self.rig.link.lacks
        if self._let_go_at is not None:
            figures["released"] = "not known" if released is None else released
        self.log.meta["host"] = {**self.log.meta.get("host", {}), **figures}
        return SwimOutcome(
            cause=self.supervisor.cause, refused=refused, swim_seconds=self.swim_seconds, figures=figures, released=released,
            lets_go=lets_go, camera=str(getattr(self.rig.localiser, "failed", None) or ""), faulty=self._faulty, off_target=off,
        )  # fmt: skip
