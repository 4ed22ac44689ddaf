"""Cases of a benchmark, drawn from its seed, so that another seed is a fresh benchmark."""

from typing import NamedTuple

import numpy as np

from fishmj.log import excitation

KINDS = {"single": 0.4, "pair": 0.15, "none": 0.28, "off": 0.17}  # shares
NOISE = (0.5, 1.0, 3.0)
BUDGETS = (2, 6, 12)  # logs
SMALL = 6  # logs of a case for a quick look
SHARES = (0.15, 0.25, 0.6)  # of the budgets
STRENGTH = (0.3, 1.5)  # of an effect's typical magnitude, log-uniform
CASUAL = 0.2  # share of data sets whose commands are whatever a policy did, not designed experiments


class BenchCase(NamedTuple):
    """One hidden data set."""

    id: str
    kind: str  # single, pair, none, off
    effects: dict  # {name: {parameter: value}}
    noise: float  # factor on the sensors' noise
    logs: tuple[str, ...]  # experiments
    seed: int  # of the fish, its network and noise
    times: float = 0.0  # strength to which its effect is scaled before it is hidden (power.py); 0: as it is


def draw(count: int, seed: int, kinds: dict[str, float] | None = None, *, small: bool = False) -> list[BenchCase]:
    """Draws `count` cases. small: only usual noise and half a session, for a quick look."""
    from fishmj.gap.laboratory.virtual_robot import EFFECTS

    shares = kinds or KINDS
    named = [n for n, e in EFFECTS.items() if e.catalogued and not e.stochastic]
    odd = [n for n, e in EFFECTS.items() if not e.catalogued]
    out, decks = [], {"single": [], "off": []}
    order = spread(count, shares, np.random.default_rng([seed, 1]))
    for i, kind in enumerate(order):
        rng = np.random.default_rng([seed, 2, i])
        noise = 1.0 if small else float(rng.choice(NOISE))
        budget = SMALL if small else int(rng.choice(BUDGETS, p=SHARES))
        session = excitation.CASUAL if not small and rng.random() < CASUAL else excitation.DESIGNED
        logs = [session[k] for k in sorted(rng.permutation(len(session))[:budget])]
        chosen: list[str] = []
        if kind in decks:
            pool = named if kind == "single" else odd
            chosen = [draw_card(decks[kind], pool, rng)]
        elif kind == "pair":
            chosen = [str(n) for n in rng.choice(named, 2, replace=False)]
        effects = {n: EFFECTS[n].draw(rng, float(np.exp(rng.uniform(*np.log(STRENGTH))))) for n in chosen}
        out.append(BenchCase(f"{seed}-{i:04d}", kind, effects, noise, tuple(logs), 1000 * (seed + 1) + i))
    return out


def spread(count: int, shares: dict[str, float], rng) -> list[str]:
    """Kinds in their shares, as evenly as `count` allows, shuffled."""
    total = sum(shares.values())
    edges = np.round(np.cumsum([0.0, *(s / total for s in shares.values())]) * count).astype(int)
    kinds = [k for k, n in zip(shares, np.diff(edges), strict=True) for _ in range(n)]
    return [kinds[i] for i in rng.permutation(count)]


def draw_card(deck: list[str], pool: list[str], rng) -> str:
    """Next card of a shuffled deck: every effect comes up before one comes up twice."""
    if not deck:
        deck.extend(str(n) for n in rng.permutation(pool))
    return deck.pop()
