"""The localisation as a paragraph. Every number in it is a field of the localisation; every sentence has a condition."""

import math

import numpy as np

from fishmj.gap.localise.residual_patterns import compatible, significant
from fishmj.gap.wording import level, number, percent, sentence

LITTLE, MOST = 0.1, 0.5  # share of the gap


def paragraph(p) -> str:
    """Paragraph that localises the gap."""
    if nothing(p):
        return f"The residual is no larger than that of healthy robots (gap {level(p.gap)}): too small to localise."
    return " ".join(s for s in (where(p), beat(p), lag(p), frame(p), side(p), growth(p), speed(p), session(p)) if s)


def nothing(p) -> bool:
    """Returns True if there is no significant gap."""
    return p.gap <= p.allowed or p.share.sum() == 0


def where(p) -> str:
    """Sentence on the channel, and its regime."""
    by_channel = p.share.sum(1)
    order = np.argsort(-by_channel)
    parts = []
    for i in order[:2]:
        if by_channel[i] < 0.15 and parts:
            continue
        inside = p.share[i] / max(by_channel[i], 1e-12)
        k = int(np.argmax(inside))
        of = f"{percent(by_channel[i])} of the gap is in the {noun(p.channels[i])}"
        parts.append(f"{of}, {percent(inside[k])} of that in {p.kinds[k]} ({percent(p.time[i, k])} of the time)")
    rest = [noun(p.channels[i]) for i in order if by_channel[i] < 0.02 and np.nanmax(p.level[i]) < 3.0]
    text = "; ".join(parts)
    if rest:
        text += f"; the {listed(rest)} {'agrees' if len(rest) == 1 else 'agree'}"
    return text + "."


def beat(p) -> str:
    """Sentence on a lock to the tail beat."""
    parts = []
    for name, b in p.locked.items():
        channel = p.channels.index(name)
        if p.share[channel].sum() < 0.05:
            continue
        if b.locked >= MOST:
            degrees = math.degrees(b.behind) % 360
            how = f"{percent(b.locked)} of it, {degrees:.0f} deg after the command"
            parts.append(f"the {name} residual is locked to the beat ({how})")
        elif b.locked < 0.2:
            parts.append(f"the {name} residual does not follow the beat ({percent(b.locked)} of it does)")
    return sentence("; ".join(parts))


def lag(p) -> str:
    """Sentence on delayed channels, and on the place of the delay."""
    joint = p.lags.joint
    heading = p.lags.heading
    if joint is None and heading is None:
        return ""
    parts = []
    if significant(joint):
        left = p.lags.joint_after
        remains = p.gap_after < p.gap and significant(left) and abs(left.lag) < abs(joint.lag)
        after = f", {ms(left)} of it with the found effects" if remains else ""
        behind = ""
        if p.lags.command is not None and p.lags.model is not None:
            behind = f" ({1e3 * p.lags.command.lag:.0f} ms behind the command instead of {1e3 * p.lags.model.lag:.0f})"
        parts.append(f"the joints come {ms(joint)} {sense(joint)} than the model's{behind}{after}")
    elif joint is not None:
        parts.append(f"the joints are on time ({ms(joint)})")
    if significant(heading):
        parts.append(f"the heading {ms(heading)} {sense(heading)}")
    elif heading is not None:
        parts.append(f"the heading is on time ({ms(heading)})")
    return sentence(", ".join(parts) + conclusion(p))


def conclusion(p) -> str:
    """Clause on the place of the delay between command and camera."""
    joint = p.lags.joint
    heading = p.lags.heading
    if joint is None or heading is None:
        return ""
    if significant(joint) and significant(heading) and compatible(joint, heading):
        return "; equal within their intervals, so the delay is upstream of the joint"
    if significant(joint) and not significant(heading):
        return ": the delay is in the joint's sensor, or the water smooths it"
    if significant(heading) and not significant(joint):
        return ": the delay is downstream of the joint, in the water or the camera's clock"
    return ""


def frame(p) -> str:
    """Sentence on world or body."""
    f = p.frame
    if f is None or p.share[p.channels.index("position")].sum() < LITTLE or f.points == "neither":
        return ""
    vector, sd = (f.world, f.world_sd) if f.points == "world" else (f.body, f.body_sd)
    if np.hypot(*vector) < 2 * np.hypot(*sd):
        return ""
    size = 1e3 * np.hypot(*vector)
    angle = math.degrees(math.atan2(vector[1], vector[0]))
    if f.points == "world":
        what = f"{number(size)} mm/s towards {angle:.0f} deg of the tank, independent of the heading"
        against = f"{percent(f.world_share)} of its drift, against {percent(f.body_share)} on the body"
        return f"The position drifts by {what} ({against}): a current, or the camera's axes."
    where_to = "ahead" if abs(angle) < 45 else "astern" if abs(angle) > 135 else "left" if angle > 0 else "right"
    own = "to the robot's own " if where_to in ("left", "right") else ""
    what = f"{number(size)} mm/s {own}{where_to}"
    against = f"{percent(f.body_share)} of its drift, against {percent(f.world_share)} in the tank"
    return f"The position drifts by {what}, in a direction that turns with the robot ({against}): thrust, drag or an offset."


def side(p) -> str:
    """Sentence on left and right."""
    s = p.side
    if s is None or p.share[p.channels.index("heading")].sum() < LITTLE:
        return ""
    if abs(s.even) > 3 * s.even_sd and abs(s.even) > math.radians(0.3):
        to = "left" if s.even > 0 else "right"
        rate = abs(math.degrees(s.even))
        return f"The robot turns {rate:.1f} deg/s more to the {to} in turns to both sides, as with an offset or asymmetry."
    if abs(s.odd) > 3 * s.odd_sd and abs(s.odd) > 0.1:
        return f"Turns are {percent(abs(s.odd))} {'stronger' if s.odd > 0 else 'weaker'} than the model's, equally to both sides."
    return ""


def growth(p) -> str:
    """Sentence on the growth within a record."""
    grown = [
        f"the {noun(name)} from {number(v[0])} to {number(v[-1])} times the floor"
        for name, v in p.thirds.items()
        if v[-1] > 3 * max(v[0], 1.0) and p.share[p.channels.index(name)].sum() > LITTLE
    ]
    return sentence(f"over a record it grows: {listed(grown)}") if grown else ""


def speed(p) -> str:
    """Sentence on the dependence on the command's rate."""
    r = p.rates
    if r is None or p.share[p.channels.index("joint")].sum() < LITTLE:
        return ""
    if r.ratio > 4:
        times = f"{number(r.ratio)} times from the slowest fifth to the fastest"
        return f"The joint residual grows with the speed of the command ({times})."
    if r.ratio < 1.5:
        return "The joint residual does not grow with the speed of the command."
    return ""


def session(p) -> str:
    """Sentence on changes over the session."""
    drifting = [noun(name) for name, s in p.session.items() if math.isfinite(s) and abs(s) > 1e-3]
    return f"The residual changes over the session in the {listed(drifting)}." if drifting else ""


def ms(lag) -> str:
    """A lag with its interval in ms, as text."""
    half = 0.5e3 * (lag.high - lag.low)
    return f"{abs(1e3 * lag.lag):.0f} ± {max(half, 1.0):.0f} ms"


def sense(lag) -> str:
    """Direction of a lag: "later" or "earlier"."""
    return "later" if lag.lag > 0 else "earlier"


def noun(channel: str) -> str:
    """Noun of a channel for a sentence."""
    return {"joint": "joints", "power": "power"}.get(channel, channel)


def listed(parts: list[str]) -> str:
    """Words as a list: a, b and c."""
    return parts[0] if len(parts) == 1 else ", ".join(parts[:-1]) + " and " + parts[-1]
