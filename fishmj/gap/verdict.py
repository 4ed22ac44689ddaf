"""The five answers, and the form in which they are written down."""

from dataclasses import asdict, dataclass, field

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
    first (fallback/). gap_unseen_before, gap_after_unseen: on records that took no part in any decision.
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

    def plain(self) -> dict:
        """As nested dictionaries, for JSON."""
        return asdict(self)

    def text(self) -> str:
        """The answer in words, for a terminal."""
        lines = [f"{self.answer}: {self.reason}"]
        for e in self.effects:
            values = ", ".join(f"{k} = {v.value:.4g} ({v.low:.4g} to {v.high:.4g}) {v.unit}" for k, v in e.parameters.items())
            lines.append(f"  {e.name}: {values}; P(best) = {e.p_best:.2f}, closes {e.closure:.0%} of what is unexpected")
        for r in self.rivals:
            lines.append(f"  rival {r['name']}: P(best) = {r['p_best']:.2f}")
        for t in self.terms[:3]:
            also = f"; or {t['alike'][0]}" if t["alike"] else ""
            lines.append(f"  as a force: {t['name']}, closes {t['closure']:.0%}, {'firm' if t['firm'] else 'weak'}{also}")
        lines.append(f"  gap {self.gap_before:.2f} -> {self.gap_after:.2f} (1 = agreement)")
        lines += [f"  warning: {w}" for w in self.warnings]
        if self.next_experiment:
            lines.append(f"  next: {self.next_experiment}")
        return "\n".join(lines)
