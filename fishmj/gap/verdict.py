"""The five answers, and their form on disk."""

import math
from dataclasses import asdict, dataclass, field

from fishmj.gap.wording import level, number, pair, percent, quantity, sizes, title, untold

SENSORS = ("servo reading", "encoder reading", "joint log", "camera along")  # terms of the library that are no forces


@dataclass(frozen=True)
class PointValue:
    """A parameter, SI."""

    value: float
    unit: str


@dataclass(frozen=True)
class Value(PointValue):
    """A parameter with its 90 % interval, SI."""

    low: float
    high: float


@dataclass(frozen=True)
class NamedEffect:
    """One effect of the catalogue with its parameters.

    same: {another effect: its values} that does the same on this robot in any motion (decide/indistinguishable.py).
    """

    name: str
    parameters: dict[str, Value]
    p_best: float
    closure: float
    same: dict[str, dict[str, PointValue]] = field(default_factory=dict)

    def equals(self) -> list[str]:
        """The effects of `same` with their values, in words."""
        return [sizes(name, values) for name, values in self.same.items()]


@dataclass(frozen=True)
class Verdict:
    """Result of a search. A gap is |z|^2 / m (search/likelihood.py): about 1 for healthy robots; up to `gap_allowed` agrees.

    Gaps of measured robots (gap/measured) are mean squares in units of the floor instead.

    effects: named effects or, with UNEXPLAINED, tentative ones. rivals: alternatives, each with the effect that it would replace.
    tentative: further fitted effects, whose gain is too small to name them. terms: with UNEXPLAINED, forces that describe the
    gap, best first (terms/). explanations: with CLASS, the hypotheses that the next experiment separates, the found one first:
    [value, low, high] of each parameter, and a weight. gap_unseen_before, gap_after_unseen: on the records set
    aside. explained: share of the excess of twice the log likelihood, cross-validated, allowing for the error of the
    formulas; it is not a share of the gap, and the residual may grow all the same. over_floor: mean square of the residual over
    the floor, before and after, on the searched records and on those set aside. steps: the rounds, decide.step_table.
    missed: with AGREES, sizes of effects that could have been missed (decide/intervals.missed_sizes).
    """

    answer: str
    effects: tuple[NamedEffect, ...] = ()
    rivals: tuple[dict, ...] = ()
    tentative: tuple[NamedEffect, ...] = ()
    terms: tuple[dict, ...] = ()
    gap_before: float = 1.0
    gap_after: float = 1.0
    gap_allowed: float = 1.0
    gap_unseen_before: float | None = None
    gap_after_unseen: float | None = None
    explained: float = 0.0
    reason: str = ""
    warnings: tuple[str, ...] = ()
    explanations: tuple[dict, ...] = ()
    next_experiment: str = ""
    patched_model: str = ""
    gates: dict = field(default_factory=dict)
    over_floor: dict[str, tuple[float, float]] = field(default_factory=dict)
    steps: tuple[dict, ...] = ()
    missed: dict[str, dict] = field(default_factory=dict)

    @property
    def searched(self) -> bool:
        """Returns True for the verdict of a stepwise search, False for that of the protocol for measured data (gap/measured)."""
        return bool(self.steps)

    @property
    def implausible(self) -> bool:
        """Returns True for a CLASS without alternatives: one effect fits best, but its value is doubtful."""
        return self.answer == "CLASS" and self.reason == IMPLAUSIBLE

    @property
    def taken(self) -> bool:
        """Returns True if `gap_after` includes the listed effects: they gained more than chance on held-out records."""
        return bool(self.effects) and "closure" in self.gates

    @property
    def shrinks(self) -> bool:
        """Returns True if the found effects lower the gap of all measured records, and the residual over the floor.

        Both count, because the covariance of the gap grows with the found effects while the floor does not.
        """
        rounds = [s["over_floor"] for s in self.steps if s["accepted"] and s.get("over_floor")]
        gaps = [(self.gap_before, self.gap_after), (self.gap_unseen_before, self.gap_after_unseen)]
        pairs = [*gaps, *self.over_floor.values(), *rounds[-1:]]
        return all(after < before for before, after in pairs if before is not None and after is not None)

    @property
    def gap(self) -> tuple[float, float | None]:
        """(before, after): gap of all searched records with the present model, and with the accepted effects; None without any.

        Terminal, page, JSON and `gap apply` report this pair.
        """
        return self.gap_before, self.gap_after if self.taken else None

    def plain(self) -> dict:
        """Nested dictionaries, for JSON. A round is `accepted` only if the residual of held-out records shrinks, too."""
        before, after = self.gap
        steps = [s | {"taken": s["accepted"], "accepted": s["accepted"] and lowers(s.get("over_floor"))} for s in self.steps]
        return asdict(self) | {"steps": steps, "gap_after": before if after is None else after}

    def success_text(self) -> str:
        """Success of the found effects in words: the explained share and its reference; no share if the gap does not shrink."""
        if not self.shrinks:
            return LIKELIER if self.searched else "does not lower the gap"
        kind = LIKELIHOOD if self.searched else "what lies above the floor"
        return f"explains {percent(self.explained)} of {kind}, on records that it was not fitted to"

    def gaps(self) -> list[str]:
        """Sentences on the gap before and after the accepted effects, and on the change of the gap on records set aside."""
        where = "on the records searched" if self.searched else "on records kept aside"
        unit = f"|z|^2 / m; {self.yardstick()}" if self.searched else FLOOR
        return [moved(*self.gap, where, unit, self.shrinks), *self.unseen()]

    def yardstick(self) -> str:
        """Compares the gap with that of healthy robots. A gap as small as theirs is agreement only if no effect was found."""
        after = self.gap[1]
        if self.answer == "UNEXPLAINED" and after is not None and after <= self.gap_allowed < self.gap_before:
            return f"healthy robots leave up to {level(self.gap_allowed)}; it is that small now, but by no valid formula"
        if self.answer == "AGREES" or self.gap_before > self.gap_allowed:
            return f"up to {level(self.gap_allowed)} agrees"
        return f"no larger than the {level(self.gap_allowed)} of healthy robots, but of another form"

    def unseen(self) -> list[str]:
        """Sentence on the gap with the taken effects on records outside every decision; empty without such records."""
        if not (self.searched and self.taken) or self.gap_unseen_before is None or self.gap_after_unseen is None:
            return []
        does = "shrinks" if self.gap_after_unseen < self.gap_unseen_before else "does not shrink"
        return [f"the gap {does} on records that no decision used"]

    def text(self) -> str:
        """The answer in words, for a terminal."""
        lines = [f"{self.answer}: {self.reason}"]
        doubt = "tentative: " if self.answer == "UNEXPLAINED" else ""
        for e in self.effects:
            lines.append("; ".join(filter(None, (f"  {doubt}{sizes(e.name, e.parameters)}", *self.doubts(e)))))
            lines += [f"    or, the same on this robot in any motion: {alike}" for alike in e.equals()]
            lines += [f"    P(best), largest first: {self.ranking(e)}"] * self.taken
        if self.taken:
            lines += [f"  {P_BEST}"] * bool(self.rivals)
            lines += [f"  counted in, not named: {sizes(n.name, n.parameters)}" for n in self.tentative]
            lines.append(f"  {self.success_text()}")
        for t in self.terms[:3]:
            also = f"; or {t['alike'][0]}" if t["alike"] else ""
            share = f"removes {percent(t['closure'])} of the excess |z|^2 on the records that it was fitted to"
            about = "a sensor's error" if t["name"].startswith(SENSORS) else "a force"
            lines.append(f"  as {about}: {t['name']}, {share}, {'firm' if t['firm'] else 'weak'}{also}")
        lines += [f"  {gap}" for gap in self.gaps()]
        lines += missed_text(self.missed)
        lines += [f"  warning: {w}" for w in self.warnings]
        if self.next_experiment:
            lines.append(f"  next: {self.next_experiment}")
        return "\n".join(lines)

    def standing(self, e: NamedEffect) -> list[tuple[str, float]]:
        """(name, P(best)) of an effect and of its alternatives, largest first."""
        mine = [r for r in self.rivals if r.get("instead_of", self.effects[-1].name) == e.name]
        rivals = [(str(r["name"]), float(r["p_best"])) for r in mine]
        return sorted([(e.name, e.p_best), *rivals], key=lambda pair: -pair[1])

    def doubts(self, e: NamedEffect) -> list[str]:
        """Doubts about one effect: another effect wins more bootstrap draws, or the interval of its size contains 0."""
        (first, share), rest = self.standing(e)[0], untold(e.parameters)
        ahead = self.taken and share > e.p_best
        leads = [f"not the likeliest: {title(first)} wins {share:.2f} of the bootstrap draws, this one {e.p_best:.2f}"] * ahead
        return [*leads, rest] if rest else leads

    def ranking(self, e: NamedEffect) -> str:
        """`standing` in words."""
        return ", ".join(f"{title(n)} {p:.2f}" for n, p in self.standing(e))


MOST = 10  # possibly missed effects printed in a terminal; the page and the JSON list all
UP_TO = "not excluded: sizes up to which these logs would not have shown each effect, if present alone"
LIKELIHOOD = "the excess log likelihood"
IMPLAUSIBLE = "implausible value: one explanation fits best, but may imitate something else"
P_BEST = "P(best): share of bootstrap draws over the records that each effect wins; a rival at 0 is still too close to rule out"
FLOOR = "mean square in units of the floor, 1 = agreement"
LIKELIER = "raises the likelihood of held-out records, allowing for the error of its formula, but their residual does not shrink"


def least_detectable(missed: dict[str, dict]) -> list[str]:
    """Effects of `Verdict.missed`: first those undetectable at any size, then by detectable over typical size, largest first."""
    return sorted(missed, key=lambda name: -math.inf if (share := missed[name]["of_typical"]) is None else -share)


def missed_words(missed: dict[str, dict]) -> tuple[list[str], list[str]]:
    """`Verdict.missed` in words: (a text for each kind of effect, least detectable first; effects undetectable at any size)."""
    kinds: dict[str, list[str]] = {}
    for name in least_detectable(missed):
        if (told := missed[name])["value"] is not None:
            kind, at, site = name.partition("@")
            none, away = told["null"], told["value"] - told["null"]
            size = f"{number(none)} {'-' if away < 0 else '+'} {quantity(abs(away), told['unit'])}" if none else ""
            size = size or quantity(away, told["unit"])
            kinds.setdefault(title(kind), []).append(f"{size}{' at ' * bool(at)}{title(site)}")
    never = [title(name) for name, told in missed.items() if told["value"] is None]
    return [f"{kind}: {', '.join(sizes)}" for kind, sizes in kinds.items()], never


def missed_text(missed: dict[str, dict]) -> list[str]:
    """The `MOST` least detectable effects of `Verdict.missed` for a terminal; [] without any."""
    sizes, never = missed_words({name: missed[name] for name in least_detectable(missed)[:MOST]})
    lines = [f"  not excluded at any size that was tried: {', '.join(never)}"] if never else []
    lines += [f"  {UP_TO}"] * bool(sizes) + [f"    {text}" for text in sizes]
    return [*lines, f"    ... and {len(missed) - MOST} more in report.html"] if len(missed) > MOST else lines


def lowers(pair: "tuple[float, float] | None") -> bool:
    """Returns True if the value of (before, after) got smaller, or was not measured."""
    return pair is None or pair[1] < pair[0]


def moved(before: float, after: float | None, where: str, unit: str, shrinks: bool) -> str:
    """A gap in words; after: None if nothing was changed. shrinks: True if the residual does too."""
    if after is None:
        return f"{pair(before, None)} {where} ({unit})"
    message = ", it grows" if after > before else ""
    if shrinks and before > max(after, 1.0):
        message = f", {percent((before - max(after, 1.0)) / (before - 1.0))} of what is above 1 is gone"
    return f"{pair(before, after)} {where} ({unit}){message}"


def round_text(taken: bool, gain: float, over_floor: "tuple[float, float] | None") -> str:
    """One round in words.

    taken: True if the effect was added to the model for its gain. over_floor: mean square of the cross-validated residual over
    the floor, before and after.
    """
    if not taken and gain <= 0.0:
        return "adding it does not improve the fit"
    text = f"gain {number(gain)} in twice the log likelihood of records not seen"
    if not taken:
        return f"adding it improves the fit too little: {text}, not enough"
    return f"{text}, accepted" if lowers(over_floor) else f"{text}, kept although their residual does not shrink"
