"""Selects the terms that describe a gap: fits every term alone to the whitened residual, then applies four tests.

g_k    = dz/dc_k by a central difference                 signature of term k, (m,)
gain_k = sum_l |z_l|^2 - |z_l - c_k(-l) g_kl|^2          c_k(-l) fitted without record l (of few: a third of one)

The best to first order and the best at finite coefficients are fitted with the whole model, and ranked by the same gain
about each one's optimum.

null       gain of the same term on null runs, whitened by the others, and that of the best of all terms by chance: subtracted
decoys     g_k shifted along each record by a random time: same spectrum, same correlations, no relation to z. p-value of gain_k
           among all decoys' gains, Benjamini & Hochberg 1995 at 10 %
stability  share of half-samples of thirds of records in which it is one of the first two (Meinshausen & Buehlmann 2010)
sides      a term by which port and starboard differ must gain a tenth more than a mirror-symmetric one
"""

from dataclasses import asdict, dataclass

import numpy as np

from fishmj.effects.effect import Effect
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.null.whitening import leftover, whitening
from fishmj.gap.records.records import Record, ResidualLayout
from fishmj.gap.search.fit import Candidate, EffectFitter, bounds
from fishmj.gap.search.likelihood import Likelihood
from fishmj.gap.terms.library import library, model_with_terms, one_sided
from fishmj.gap.thresholds import thresholds

LIMITS = thresholds().terms


@dataclass(frozen=True)
class Term:
    """One term.

    name: "sway force ~ tail rate x yaw rate". id: of the provisional effect, X-.... coefficient: SI, of the refined fit. closure:
    share of the excess that it explains on all records. gain: on records outside its fit, less that of null runs.
    q: false-discovery rate at which it is accepted. stability: as above. alike: terms that these records cannot tell from it.
    """

    name: str
    id: str
    coefficient: float
    unit: str
    closure: float
    gain: float
    q: float
    stability: float
    one_sided: bool
    alike: tuple[str, ...]

    @property
    def firm(self) -> bool:
        """Returns True if it passes every test."""
        found = self.gain > 0 and self.q <= LIMITS.false_discovery
        return found and self.stability >= LIMITS.stability and self.closure >= LIMITS.closure


@np.errstate(over="ignore", invalid="ignore")  # a diverged rollout counts as a huge cost
def terms_of(model, records: list[Record], null: np.ndarray, seed: int = 0) -> tuple[Term, ...]:
    """The terms that describe the residual of `records`, from the fish with the library in it, best first.

    null: (n, m) residuals of null runs at the windows of `records`.
    """
    e = Likelihood(model, records, null)
    whole = e.subset()
    terms = [x for x in model.active.effects if x in library()]
    base = whole.base()
    g, probed = signatures(whole, terms)
    onto = groups(e.layout, 1 if len(records) >= LIMITS.whole_records else LIMITS.pieces)
    gains = held_out_gains(base.z, g, onto)
    # The best of ninety terms gains something by chance: the gain of the best term on null runs is subtracted from all.
    floor = null_gains(e, null, g, onto)
    sided = np.where([one_sided(t) for t in terms], LIMITS.one_sided_weight, 1.0)
    net = (gains - floor) * sided
    rng = np.random.default_rng(seed)
    # Decoys, not a chi-squared: neighbouring samples of z are alike, so a term has fewer degrees of freedom than samples.
    q = discovery(gains, decoy_gains(base.z, g, e.layout, onto, rng))
    # Pieces of records, because two or three whole records allow too few half-samples.
    stable = stability(base.z, g, groups(e.layout, LIMITS.pieces), net / np.maximum(gains, 1e-9), rng)
    # First order chooses among all terms. The remaining few are fitted with the whole model, since a fish that drifts far off
    # its path does not respond linearly to a coefficient.
    order = shortlist(net, probed)
    polished = {c.names[-1]: c for c in whole.refine(whole.screen(base, [terms[k] for k in order]), 3)}
    for k, gain in zip(order, held_out_gain_at(whole, base, [polished[terms[k].name] for k in order], onto), strict=True):
        net[k] = (gain - floor[k]) * sided[k]
    ranked = sorted(order, key=lambda k: -net[k])[: LIMITS.listed]
    return tuple(_term(terms, k, polished, base, net, q, stable, g, e.layout.size, model) for k in ranked)


def describe(e: Likelihood, null: SimulatedNull, seed: int) -> tuple[dict, ...]:
    """The terms of the records of `e` as plain dictionaries; none for a model that is no swimming fish."""
    if not isinstance(e.model, SwimmingFish):
        return ()
    residuals = null.residuals(e.model, e.records, e.layout)
    terms = terms_of(model_with_terms(e.model.robot), e.records, residuals, seed)
    return tuple(asdict(t) | {"firm": t.firm} for t in terms)


def shortlist(net: np.ndarray, probed: np.ndarray) -> list[int]:
    """Terms to refine: the best to first order, and the best at a finite size, since a large drift is not linear."""
    return list(dict.fromkeys([*np.argsort(-net)[: LIMITS.finalists], *np.argsort(probed)[: LIMITS.finalists]]))


def held_out_gain_at(whole: EffectFitter, base: Candidate, fitted: list[Candidate], onto: np.ndarray) -> np.ndarray:
    """(F,) gain of fitted terms on records left out: about each optimum c, c(-l) = c - sum_k g_k z_k / sum_k g_k^2, k not l."""
    _, _, size = bounds(whole.model)
    rows, steps = [], []
    for c in fitted:
        row = c.row.copy()
        place = c.places[-1]
        steps.append(0.02 * size[place])
        row[place] += steps[-1]
        rows.append(row)
    at = np.array([c.z for c in fitted])
    g = (whole.z(np.array(rows)) - at) / np.array(steps)[:, None]
    b, a = sums(at, g, onto)
    change = -(b.sum(1, keepdims=True) - b) / (a.sum(1, keepdims=True) - a + 1e-12)
    return np.sum(base.z**2) - np.sum(at**2, 1) - np.sum(2 * change * b + change**2 * a, 1)


def _term(terms, k, polished, base, net, q, stable, g, size, model) -> Term:
    effect = terms[k]
    c = polished[terms[k].name]
    norm = np.linalg.norm(g, axis=1) + 1e-300
    cos = np.abs(g @ g[k]) / norm / norm[k]
    alike = tuple(terms[j].formula for j in np.argsort(-cos) if cos[j] > LIMITS.cosine and j != k)
    p = effect.parameters[0]
    value = float(c.row[model.index(effect.name, p.name)])
    excess = base.cost - size
    closure = float((base.cost - c.cost) / excess) if excess > 0 else 0.0
    doubts = (float(net[k]), float(q[k]), float(stable[k]))
    return Term(effect.formula, effect.name, value, p.unit, closure, *doubts, one_sided(effect), alike)


def signatures(whole: EffectFitter, terms: list[Effect]) -> tuple[np.ndarray, np.ndarray]:
    """(K, m) change of z for the usual coefficient of each term, to first order; (K,) least |z|^2 at a few finite ones."""
    model = whole.model
    sizes = (LIMITS.probe, -LIMITS.probe, *LIMITS.finite_probes)
    rows = np.tile(model.null, (len(terms), len(sizes), 1))
    for k, term in enumerate(terms):
        p = term.parameters[0]
        rows[k, :, model.index(term.name, p.name)] = np.multiply(sizes, p.typical[1])
    z = whole.z(rows.reshape(-1, rows.shape[-1])).reshape(len(terms), len(sizes), -1)
    g = (z[:, 0] - z[:, 1]) / (2 * LIMITS.probe)
    g[np.abs(z[:, :2]).max((1, 2)) > LIMITS.diverged] = 0.0  # a rollout that left the finite numbers says nothing
    return g, np.einsum("kpm,kpm->kp", z, z).min(1)


def groups(layout: ResidualLayout, pieces: int) -> np.ndarray:
    """(m, L pieces) True for the entries of each record, or of each of its equal parts in time."""
    onto = np.zeros((layout.size, pieces * len(layout.records)))
    for b in layout.blocks:
        n = b.where.stop - b.where.start
        onto[np.arange(b.where.start, b.where.stop), pieces * b.record + pieces * np.arange(n) // max(n, 1)] = 1.0
    return onto


def sums(z: np.ndarray, g: np.ndarray, onto: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(g_k . z, g_k . g_k) by group, (K, G) each."""
    return (g * z) @ onto, (g * g) @ onto


def held_out_gains(z: np.ndarray, g: np.ndarray, onto: np.ndarray) -> np.ndarray:
    """(K,) gain of each term on groups outside its fit, one at a time."""
    b, a = sums(z, g, onto)  # c(-l) = b(-l) / a(-l), gain 2 c b_l - c^2 a_l
    c = (b.sum(1, keepdims=True) - b) / (a.sum(1, keepdims=True) - a + 1e-12)
    return np.sum(2 * c * b - c * c * a, 1)


def null_gains(e: Likelihood, null: np.ndarray, g: np.ndarray, onto: np.ndarray) -> np.ndarray:
    """(K,) possible gain of each term on null runs, those of one half whitened by the other half's scatter.

    The 95 % point of its own gain, times the excess of the luckiest of all terms over its own in 95 % of the runs.
    """
    whole = np.ones(len(null), bool)
    found = []
    for part in (0, 1):
        other = whole.copy()
        other[part::2] = False
        mine = null[other]
        w = whitening(mine / np.sqrt(len(mine)), leftover(mine, e.layout))
        for z in w(null[part::2]):
            found.append(held_out_gains(z, g, onto))
    each = np.maximum(np.percentile(np.array(found), 95, axis=0), LIMITS.free_gain)
    luckiest = np.max(np.array(found) / each, 1)
    return each * max(1.0, float(np.percentile(luckiest, 95)))


def decoy_gains(z: np.ndarray, g: np.ndarray, layout: ResidualLayout, onto: np.ndarray, rng) -> np.ndarray:
    """(decoys K,) gains of signatures shifted by a random share of each record, at least an eighth of it either way."""
    out = []
    for _ in range(LIMITS.decoys):
        moved = np.empty_like(g)
        shift = rng.uniform(0.125, 0.875, len(layout.records))
        for b in layout.blocks:
            n = b.where.stop - b.where.start
            moved[:, b.where] = np.roll(g[:, b.where], int(shift[b.record] * n), axis=1)
        out.append(held_out_gains(z, moved, onto))
    return np.concatenate(out)


def discovery(gains: np.ndarray, decoys: np.ndarray) -> np.ndarray:
    """(K,) false-discovery rate at which each term would be accepted (Benjamini & Hochberg)."""
    ordered = np.sort(decoys)
    p = (1 + len(ordered) - np.searchsorted(ordered, gains, side="left")) / (1 + len(ordered))
    order = np.argsort(p)
    q = p[order] * len(p) / (1 + np.arange(len(p)))
    out = np.empty_like(q)
    out[order] = np.minimum.accumulate(q[::-1])[::-1]
    return out


def stability(z, g, onto: np.ndarray, share, rng) -> np.ndarray:
    """(K,) share of half-samples of the groups in which each term is among the first two.

    share: (K,) rest of each term's gain after null runs and sides.
    """
    b, a = sums(z, g, onto)
    count = onto.shape[1]
    hits = np.zeros(len(g))
    for _ in range(LIMITS.half_samples):
        half = rng.permutation(count)[: max(2, count // 2)]
        gain = b[:, half].sum(1) ** 2 / (a[:, half].sum(1) + 1e-12) * np.clip(share, 0.0, 1.0)
        hits[np.argsort(-gain)[:2]] += 1
    return hits / LIMITS.half_samples
