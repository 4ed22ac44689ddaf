"""The five answers, and the form in which they are written down."""

from dataclasses import asdict, dataclass, field

from fishmj.gap.wording import level, number, percent, sizes, title

ANSWERS = ("AGREES", "NAMED", "CLASS", "UNEXPLAINED", "NOT_REPEATABLE")


@dataclass(frozen=True)
class Value:
    """A parameter with its 90 % interval, SI."""

    value: float
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class Named:
    """One effect of the catalogue with its parameters."""

    name: str
    parameters: dict[str, Value]
    p_best: float
    closure: float


@dataclass(frozen=True)
class Verdict:
    """What a search found. Gaps are mean squares in units of the floor: agreement is about 1.

    effects: named or, with UNEXPLAINED, tentative. rivals: what else could be meant, and instead of which. tentative: further
    effects that helped a little, but that could be others. terms: with UNEXPLAINED, forces that would describe the gap, best
    first (terms/). gap_unseen_before, gap_after_unseen: on records that took no part in any decision. explained: share of the
    excess of twice the log likelihood, each record predicted without its fold, with what the formulas may be wrong by granted;
    it is no share of the gap, and the gap may grow beside it. steps: the rounds, decide.step_table.
    """

    answer: str
    effects: tuple[Named, ...] = ()
    rivals: tuple[dict, ...] = ()
    tentative: tuple[Named, ...] = ()
    terms: tuple[dict, ...] = ()
    gap_before: float = 1.0
    gap_after: float = 1.0
    gap_unseen_before: float | None = None
    gap_after_unseen: float | None = None
    explained: float = 0.0
    reason: str = ""
    warnings: tuple[str, ...] = ()
    next_experiment: str = ""
    patched_model: str = ""
    gates: dict = field(default_factory=dict)
    steps: tuple[dict, ...] = ()

    @property
    def searched(self) -> bool:
        """Whether rounds are told: a search made this, not the protocol of measured data (studies/measured_robots)."""
        return bool(self.steps)

    @property
    def taken(self) -> bool:
        """Whether the gap is told with what is listed in the model: it gained more than chance on records that did not see it."""
        return bool(self.effects) and "closure" in self.gates

    @property
    def shrinks(self) -> bool:
        """Whether the gap gets smaller with what was found, wherever it was measured."""
        rounds = [s["gap_unseen"] for s in self.steps if s["accepted"] and s.get("gap_unseen")]
        pairs = [(self.gap_before, self.gap_after), (self.gap_unseen_before, self.gap_after_unseen), *rounds[-1:]]
        return all(after < before for before, after in pairs if before is not None and after is not None)

    def plain(self) -> dict:
        """As nested dictionaries, for JSON. A round is `accepted` where it also lowers the gap on records that did not see it."""
        steps = [s | {"taken": s["accepted"], "accepted": s["accepted"] and lowers(s.get("gap_unseen"))} for s in self.steps]
        return asdict(self) | {"steps": steps}

    def told(self) -> str:
        """What it does that was found: a percentage with what it is of; none beside a gap that does not shrink."""
        if not self.shrinks:
            return LIKELIER if self.searched else "does not lower the gap"
        kind = LIKELIHOOD if self.searched else "what lies above the floor"
        return f"explains {percent(self.explained)} of {kind}, on records that it was not fitted to"

    def gaps(self) -> list[str]:
        """The gap in words, before and after what was taken; as it is where nothing was."""
        where = "on the records searched" if self.searched else "on records kept aside"
        out = [moved(self.gap_before, self.gap_after if self.taken else None, where)]
        if self.gap_unseen_before is not None:
            now = self.gap_after_unseen if self.taken else None
            out.append(moved(self.gap_unseen_before, now, "on records that no decision saw"))
        return out

    def text(self) -> str:
        """The answer in words, for a terminal."""
        lines = [f"{self.answer}: {self.reason}"]
        doubt = "tentative: " if self.answer == "UNEXPLAINED" else ""
        for e in self.effects:
            lines.append(f"  {doubt}{sizes(e.name, e.parameters)}")
            lines += [f"    P(best), largest first: {', '.join(f'{title(n)} {p:.2f}' for n, p in self.standing(e))}"] * self.taken
        if self.taken:
            lines += [f"  counted in, not named: {sizes(n.name, n.parameters)}" for n in self.tentative]
            lines.append(f"  {self.told()}")
        for t in self.terms[:3]:
            also = f"; or {t['alike'][0]}" if t["alike"] else ""
            share = f"takes off {percent(t['closure'])} of the excess of |z|^2 of the records that it was fitted to"
            lines.append(f"  as a force: {t['name']}, {share}, {'firm' if t['firm'] else 'weak'}{also}")
        lines += [f"  {gap}" for gap in self.gaps()]
        lines += [f"  warning: {w}" for w in self.warnings]
        if self.next_experiment:
            lines.append(f"  next: {self.next_experiment}")
        return "\n".join(lines)

    def standing(self, e: Named) -> list[tuple[str, float]]:
        """(name, P(best)) of an effect and of what could be meant instead of it, largest first."""
        mine = [r for r in self.rivals if r.get("instead_of", self.effects[-1].name) == e.name]
        rivals = [(str(r["name"]), float(r["p_best"])) for r in mine]
        return sorted([(e.name, e.p_best), *rivals], key=lambda pair: -pair[1])


LIKELIHOOD = "the excess log likelihood"
LIKELIER = "makes records that it was not fitted to likelier, its formula's error granted, but their gap does not shrink"


def lowers(gap: "tuple[float, float] | None") -> bool:
    """Whether a gap (before, after) got smaller; True where none was measured."""
    return gap is None or gap[1] < gap[0]


def moved(before: float, after: float | None, where: str) -> str:
    """A gap in words; after: None where nothing was changed."""
    if after is None:
        return f"gap {level(before)} {where} (mean square in units of the floor, 1 = agreement)"
    said = ", it grows" if after > before else ""
    if before > max(after, 1.0):
        said = f", {percent((before - max(after, 1.0)) / (before - 1.0))} of what is above 1 is gone"
    return f"gap {level(before)} -> {level(after)} {where} (mean square in units of the floor, 1 = agreement){said}"


def said(taken: bool, gain: float, gap: "tuple[float, float] | None") -> str:
    """One round in words. taken: into the model, for its gain. gap: before and after, of records predicted without their fold."""
    text = f"gain {number(gain)} in twice the log likelihood of records not seen"
    if not taken:
        return f"{text}, not enough"
    if gap is None:
        return f"{text}, accepted"
    if lowers(gap):
        return f"{text}, accepted: their gap falls from {level(gap[0])} to {level(gap[1])}"
    return f"{text}, taken though their gap does not fall ({level(gap[0])} before, {level(gap[1])} after)"
