"""Every effect's best value on a set of records: probes of finite size, then Gauss-Newton on the whitened residual.

    screen   z at a few magnitudes of each parameter; the best secant combination in closed form. Finite probes, not derivatives:
             a dead band or a speed limit has none at its null
    scan     hundreds of values on one record, where only the right one explains anything: the step that commands are counted in
    refine   theta' = theta + (J^T J + m)^-1 J^T z,  J by finite differences about theta, all candidates in one batch of rollouts

The cost is |z|^2 with z from null.py, plus a weak prior: constants of the fish need no fit, they are integrated out.
"""

from dataclasses import dataclass, replace

import numpy as np

from fishmj.effects import Effect

MAGNITUDES = (0.15, 0.5, 1.0, 2.0)  # of the typical size
FINE, AGAIN, KEPT = 300, 5, 6  # values where only the right one explains anything, more on either side of the best, those kept
STEP = 0.02  # of the typical size, for derivatives
PRIOR = 1.5  # typical sizes, standard deviation of an effect's parameters about their null: what records leave open stays small
ITERATIONS = 6


@dataclass(frozen=True)
class Candidate:
    """One set of effects with its best parameters.

    names: effects, in order of acceptance. places: (K,) entries of the parameter row that they own. row: (P,) whole row.
    cost: |z|^2 over all records and the prior's share; z: (m,).
    """

    names: tuple[str, ...]
    places: tuple[int, ...]
    row: np.ndarray
    cost: float
    z: np.ndarray


class EffectFitter:
    """Candidates on one set of records.

    Args:
        plant: with `predict`, `active`, `index`. records, layout, whiten: the data and its null.
    """

    def __init__(self, plant, records, layout, whiten):
        self.plant, self.records, self.layout, self.whiten = plant, records, layout, whiten

    def z(self, rows) -> np.ndarray:
        """Whitened residuals (R, m) of parameter rows (R, P); diverged rollouts count as huge."""
        residuals = self.layout.residuals(self.plant.predict(self.records, rows))
        return np.nan_to_num(self.whiten(residuals), nan=1e6, posinf=1e6, neginf=-1e6)

    def prior(self, rows) -> np.ndarray:
        """(R,) what the prior adds to |z|^2 of parameter rows (R, P)."""
        size = bounds(self.plant)[2]
        return np.sum(((np.asarray(rows) - self.plant.null) / (PRIOR * size))[:, len(self.plant.constants) :] ** 2, 1)

    def costs(self, rows, z) -> np.ndarray:
        """(R,) |z|^2 of rows (R, P) whose z (R, m) are known, and the prior's share."""
        return np.einsum("rm,rm->r", z, z) + self.prior(rows)

    def loss(self, row) -> float:
        """Cost + log det S of one parameter row, twice the negative log likelihood: comparable where S differs, too."""
        return self.at(row).cost + self.whiten.logdet

    def at(self, row, names: tuple[str, ...] = (), places: tuple[int, ...] = ()) -> Candidate:
        """The candidate that a parameter row is."""
        z = self.z(np.asarray(row)[None])
        return Candidate(names, places, row, float(self.costs(np.asarray(row)[None], z)[0]), z[0])

    def base(self, row=None) -> Candidate:
        """The model as it is."""
        return self.at(self.plant.null if row is None else row)

    def scan(self, base: Candidate, effects) -> dict[str, tuple[float, ...]]:
        """{effect: its best few values} for those of which only a value right to a fraction of a per cent explains anything.

        A command counted in steps jumps where c / step does: values lie evenly in 1 / step, and again around the best.
        """
        found = {}
        for effect, p in [(x, p) for x in effects for p in x.parameters if p.fine]:
            place = self.plant.index(effect.name, p.name)
            inverse, step = np.linspace(0.5 / _size(p), 1.0 / min(abs(t - p.null) for t in p.typical), FINE, retstep=True)
            for _ in range(2):
                rows = np.tile(base.row, (len(inverse), 1))
                rows[:, place] = p.null + 1.0 / inverse
                best = inverse[np.argsort(self.costs(rows, self.z(rows)))[:KEPT]]
                inverse = (best[:, None] + step * np.arange(-AGAIN, AGAIN + 1) / (AGAIN + 1)).ravel()
            found[effect.name] = tuple(p.null + 1.0 / best)
        return found

    def screen(self, base: Candidate, effects, fine: dict[str, tuple[float, ...]] | None = None) -> list[Candidate]:
        """`base` plus each of `effects`, at the best probe or secant combination; best first. fine: more values, from `scan`."""
        rows, owners = [], []
        for effect in effects:
            for k, value in probes(effect, (fine or {}).get(effect.name, ())):
                row = base.row.copy()
                row[self.plant.index(effect.name, effect.parameters[k].name)] = value
                rows.append(row)
                owners.append((effect, k, value))
            for row in shaped(self.plant, base.row, effect):
                rows.append(row)
                owners.append((effect, -1, 0.0))
        tried = np.array(rows)
        z = self.z(tried)
        cost = self.costs(tried, z)
        found = []
        for effect in effects:
            mine = [i for i, owner in enumerate(owners) if owner[0] is effect]
            best = min(mine, key=lambda i: cost[i])
            choices = [tried[best]] + secants(self.plant, base, effect, [(owners[i], z[i]) for i in mine])
            found.append((effect, choices))
        flat = np.array([row for _, choices in found for row in choices])
        z = self.z(flat)
        cost = self.costs(flat, z)
        out, at = [], 0
        for effect, choices in found:
            i = at + int(np.argmin(cost[at : at + len(choices)]))
            at += len(choices)
            places = tuple(self.plant.index(effect.name, p.name) for p in effect.parameters)
            out.append(Candidate((*base.names, effect.name), (*base.places, *places), flat[i], float(cost[i]), z[i]))
        return sorted(out, key=lambda c: c.cost)

    def refine(self, candidates: list[Candidate], iterations: int = ITERATIONS) -> list[Candidate]:
        """Polish all parameters of each candidate together; best first."""
        low, high, size = bounds(self.plant)
        best = list(candidates)
        damping = [1e-2] * len(best)
        for _ in range(iterations):
            rows, spans = [], []
            for c in best:
                first = len(rows)
                for place in c.places:
                    row = c.row.copy()
                    step = STEP * size[place]
                    row[place] += step if row[place] + step <= high[place] else -step
                    rows.append(row)
                spans.append((first, len(rows)))
            z = self.z(np.array(rows))
            trials, owner = [], []
            for i, c in enumerate(best):
                a, b = spans[i]
                moved = np.array([rows[a + j][p] - c.row[p] for j, p in enumerate(c.places)])
                jac = (z[a:b] - c.z) / moved[:, None] * size[list(c.places)][:, None]  # per typical size
                away = (c.row - self.plant.null)[list(c.places)] / size[list(c.places)]
                normal, slope = jac @ jac.T + np.eye(len(away)) / PRIOR**2, jac @ c.z + away / PRIOR**2
                for m in (damping[i], damping[i] * 30):
                    change = -np.linalg.solve(normal + m * np.diag(np.diag(normal)) + 1e-9 * np.eye(len(slope)), slope)
                    row = c.row.copy()
                    places = list(c.places)
                    row[places] = np.clip(row[places] + change * size[places], low[places], high[places])
                    trials.append(row)
                    owner.append(i)
            z = self.z(np.array(trials))
            cost = self.costs(np.array(trials), z)
            for i, c in enumerate(best):
                mine = [j for j, o in enumerate(owner) if o == i]
                j = min(mine, key=lambda k: cost[k])
                if cost[j] < c.cost:
                    best[i] = replace(c, row=trials[j], cost=float(cost[j]), z=z[j])
                    damping[i] = max(1e-4, damping[i] * (0.3 if j == mine[0] else 3))
                else:
                    damping[i] = min(1e4, damping[i] * 100)
        return sorted(best, key=lambda c: c.cost)


def probes(effect: Effect, fine: tuple[float, ...] = ()) -> list[tuple[int, float]]:
    """(parameter, value) pairs at which an effect is tried; several sizes, both sides where both make sense. fine: further values
    of its fine parameter."""
    out = []
    for k, p in enumerate(effect.parameters):
        if p.shape:
            continue
        signs = (1.0, -1.0) if p.signed else ((1.0,) if p.high > p.null else (-1.0,))
        sizes = [*(m * _size(p) for m in MAGNITUDES), min(abs(t - p.null) for t in p.typical)]
        values = {float(np.clip(p.null + s * size, p.low, p.high)) for s in signs for size in sizes}
        values |= set(fine) if p.fine else set()
        out += [(k, v) for v in sorted(values - {p.null})]
    return out


def shaped(plant, base: np.ndarray, effect: Effect) -> list[np.ndarray]:
    """Rows with the effect at its usual size and each shaping parameter on either side of its null."""
    out = []
    shapes = [p for p in effect.parameters if p.shape]
    for shape in shapes:
        for value in {float(np.clip(shape.null + s * _size(shape), shape.low, shape.high)) for s in (1.0, -1.0)} - {shape.null}:
            row = base.copy()
            for p in effect.parameters:
                if not p.shape:
                    row[plant.index(effect.name, p.name)] = np.clip(
                        p.null + (1 if p.high > p.null else -1) * _size(p), p.low, p.high
                    )
            row[plant.index(effect.name, shape.name)] = value
            out.append(row)
    return out


def secants(plant, base: Candidate, effect: Effect, tried) -> list[np.ndarray]:
    """Rows from the linear combination of each parameter's probes that lowers |z| most, one row a magnitude."""
    out = []
    for m in MAGNITUDES:
        columns, places, sizes = [], [], []
        for k, p in enumerate(effect.parameters):
            if p.shape:
                continue
            near = [(value, z) for (_, j, value), z in tried if j == k]
            value, z = min(near, key=lambda v: abs(abs(v[0] - p.null) - m * _size(p)))
            columns.append((z - base.z) / (value - p.null))
            places.append(plant.index(effect.name, p.name))
            sizes.append(_size(p))
        jac = np.array(columns) * np.array(sizes)[:, None]
        normal = jac @ jac.T
        change = -np.linalg.solve(
            normal + 1e-6 * np.trace(normal) * np.eye(len(normal)) + 1e-12 * np.eye(len(normal)), jac @ base.z
        )
        row = base.row.copy()
        for place, p, size, c in zip(places, [p for p in effect.parameters if not p.shape], sizes, change, strict=True):
            row[place] = np.clip(p.null + c * size, p.low, p.high)
        out.append(row)
    return out


def bounds(plant) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(low, high, typical size) of every entry of a parameter row."""
    n = len(plant.constants)
    entries = [p for e in plant.active.effects for p in e.parameters]
    low = np.array([0.1] * n + [p.low for p in entries])
    high = np.array([10.0] * n + [p.high for p in entries])
    return low, high, np.array([1.0] * n + [_size(p) for p in entries])


def _size(parameter) -> float:
    """Typical departure from the null, at its large end."""
    return max(abs(t - parameter.null) for t in parameter.typical)
