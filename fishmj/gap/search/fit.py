"""Fits each effect to a set of records: probes of finite size, then damped Gauss-Newton on the whitened residual.

    screen        z at a few magnitudes of each parameter; the best secant combination in closed form
    grid_search   hundreds of values on one record, for a parameter that must be exact to explain anything, such as the step
                  of quantised commands
    refine        theta' = theta - (J^T J + P + m diag)^-1 (J^T z + P theta),  J by finite differences about theta, P the prior

The cost is |z|^2 with z from null/whitening.py, plus a weak Gaussian prior. The constants of the fish are not fitted: the
covariance of the null runs integrates them out.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fishmj.base.least_squares import damped_steps, differences, slopes
from fishmj.effects import Effect, Parameter
from fishmj.gap.thresholds import thresholds


@dataclass(frozen=True)
class Candidate:
    """One set of effects with its best parameters.

    names: effects, in order of acceptance. places: (K,) their entries in the parameter row. row: (P,) parameter row.
    cost: |z|^2 over all records and the prior's share; z: (m,). added: number of effects that its round added.
    """

    names: tuple[str, ...]
    places: tuple[int, ...]
    row: np.ndarray
    cost: float
    z: np.ndarray
    added: int = 1

    @property
    def newest(self) -> tuple[str, ...]:
        """The effects that its round added."""
        return self.names[len(self.names) - self.added :] if self.names else ()


@dataclass(frozen=True, eq=False)
class EffectFitter:
    """Candidates on one set of records. model: with `predict`, `active`, `index`; the others: the data and its null."""

    model: Any
    records: list
    layout: Any
    whiten: Any

    def z(self, rows) -> np.ndarray:
        """Whitened residuals (R, m) of parameter rows (R, P); diverged rollouts count as huge."""
        residuals = self.layout.residuals(self.model.predict(self.records, rows))
        return np.nan_to_num(self.whiten(residuals), nan=1e6, posinf=1e6, neginf=-1e6)

    def prior(self, rows) -> np.ndarray:
        """(R,) contribution of the prior to |z|^2 of parameter rows (R, P)."""
        size = bounds(self.model)[2]
        scaled = (np.asarray(rows) - self.model.null) / (thresholds().fit.prior_sd * size)
        return np.sum(scaled[:, len(self.model.constants) :] ** 2, 1)

    def costs(self, rows, z) -> np.ndarray:
        """(R,) |z|^2 of rows (R, P) with known z (R, m), plus the prior's share."""
        return np.einsum("rm,rm->r", z, z) + self.prior(rows)

    def loss(self, row) -> float:
        """Cost + log det S of one parameter row, twice the negative log likelihood: comparable between different S."""
        return self.at(row).cost + self.whiten.logdet

    def evidence(self, c: Candidate) -> float:
        """-2 log evidence of the records for a set of effects, its values integrated out: prefers fewer parameters at equal fit.

        loss + log det(1 + sd^2 J J^T)      Laplace's approximation (MacKay 1992), J per typical size, sd of the prior
        """
        (jac,) = self.slopes_of([c])
        width = np.linalg.slogdet(np.eye(len(jac)) + thresholds().fit.prior_sd ** 2 * jac @ jac.T)[1]
        return c.cost + self.whiten.logdet + float(width)

    def at(self, row, names: tuple[str, ...] = (), places: tuple[int, ...] = (), added: int = 1) -> Candidate:
        """Candidate of a parameter row."""
        z = self.z(np.asarray(row)[None])
        return Candidate(names, places, row, float(self.costs(np.asarray(row)[None], z)[0]), z[0], added)

    def base(self) -> Candidate:
        """Candidate of the present model."""
        return self.at(self.model.null)

    def grid_search(self, base: Candidate, effects) -> dict[str, tuple]:
        """{effect: its best few values} for effects with a parameter that must be exact to a fraction of a per cent.

        If that parameter only shapes the effect, such as the period of a torque ripple: its best few sets of all parameters.

        A quantised command jumps where c / step does, so the grid is even in 1 / step; a second grid refines the best values.
        """
        limits = thresholds().fit
        found = {}
        for effect, p in [(x, p) for x in effects for p in x.parameters if p.fine]:
            place = self.model.index(effect.name, p.name)
            if p.shape:
                found[effect.name] = self._waves(base, effect, p)
                continue
            # Even in 1 / step: the phase of the jumps is c / step, so a grid even in step would be too coarse for small steps
            # and too fine for large ones.
            last = 1.0 / min(abs(t - p.null) for t in p.typical)
            inverse, spacing = np.linspace(1.0 / max(p.high - p.null, p.null - p.low), last, limits.grid_values, retstep=True)
            beside = spacing * np.arange(-limits.grid_neighbours, limits.grid_neighbours + 1) / (limits.grid_neighbours + 1)
            for _ in range(2):
                rows = np.tile(base.row, (len(inverse), 1))
                rows[:, place] = p.null + 1.0 / inverse
                best = inverse[np.argsort(self.costs(rows, self.z(rows)))[: limits.grid_kept]]
                inverse = (best[:, None] + beside).ravel()
            found[effect.name] = tuple(p.null + 1.0 / best)
        return found

    def _waves(self, base: Candidate, effect: Effect, shape: Parameter) -> tuple[tuple[float, ...], ...]:
        """The best few sets of an effect's parameters, linear in all but `shape`, whose values lie evenly in its inverse."""
        limits = thresholds().fit
        own = [self.model.index(effect.name, p.name) for p in effect.parameters]
        linear = [p for p in effect.parameters if not p.shape]
        sizes = np.array([p.typical[0] for p in linear])
        inverse = np.linspace(1.0 / shape.typical[1], 1.0 / shape.typical[0], limits.wave_values)
        tried = np.array([[p.null for p in effect.parameters]] * (len(inverse) * len(linear)))
        tried[:, effect.parameters.index(shape)] = np.repeat(1.0 / inverse, len(linear))
        columns = [effect.parameters.index(p) for p in linear]
        tried[np.arange(len(tried)), np.tile(columns, len(inverse))] += np.tile(sizes, len(inverse))
        rows = np.tile(base.row, (len(tried), 1))
        rows[:, own] = tried
        change = (self.z(rows) - base.z).reshape(len(inverse), len(linear), -1)
        found = []
        for moved, value in zip(change, inverse, strict=True):
            best = -np.linalg.pinv(moved.T) @ base.z
            vector = np.array([p.null for p in effect.parameters])
            vector[effect.parameters.index(shape)] = 1.0 / value
            vector[columns] += best * sizes
            vector = np.clip(vector, [p.low for p in effect.parameters], [p.high for p in effect.parameters])
            found.append((float(np.sum((base.z + best @ moved) ** 2)), tuple(vector.tolist())))
        return tuple(vector for _, vector in sorted(found)[: limits.grid_kept])

    def screen(self, base: Candidate, effects, fine: dict[str, tuple] | None = None) -> list[Candidate]:
        """`base` plus each of `effects`, at the best probe or secant combination; best first.

        fine: more values, from `grid_search`.
        """
        waves = {x.name: (fine or {}).get(x.name, ()) for x in effects if any(p.fine and p.shape for p in x.parameters)}
        # Probes of finite size instead of a gradient at the null: a dead band, play or a speed limit has no derivative there.
        rows, owners = [], []
        for effect in effects:
            for k, value in probes(effect, () if effect.name in waves else (fine or {}).get(effect.name, ())):
                row = base.row.copy()
                row[self.model.index(effect.name, effect.parameters[k].name)] = value
                rows.append(row)
                owners.append((effect, k, value))
            waving = [base.row.copy() for _ in waves.get(effect.name, ())]
            for row, values in zip(waving, waves.get(effect.name, ()), strict=True):
                row[[self.model.index(effect.name, p.name) for p in effect.parameters]] = values
            for row in waving or shape_probes(self.model, base.row, effect):
                rows.append(row)
                owners.append((effect, -1, 0.0))
        tried = np.array(rows)
        z = self.z(tried)
        cost = self.costs(tried, z)
        found = []
        for effect in effects:
            mine = [i for i, owner in enumerate(owners) if owner[0] is effect]
            best = min(mine, key=lambda i: cost[i])
            choices = [tried[best]] + secants(self.model, base, effect, [(owners[i], z[i]) for i in mine])
            found.append((effect, choices))
        flat = np.array([row for _, choices in found for row in choices])
        z = self.z(flat)
        cost = self.costs(flat, z)
        out, at = [], 0
        for effect, choices in found:
            i = at + int(np.argmin(cost[at : at + len(choices)]))
            at += len(choices)
            places = tuple(self.model.index(effect.name, p.name) for p in effect.parameters)
            out.append(Candidate((*base.names, effect.name), (*base.places, *places), flat[i], float(cost[i]), z[i]))
        return sorted(out, key=lambda c: c.cost)

    def refine(self, candidates: list[Candidate], iterations: int | None = None, chord: bool = False) -> list[Candidate]:
        """Damped Gauss-Newton on all parameters of each candidate together (Levenberg 1944, Marquardt 1963); best first.

        chord: reuse the slopes at the start in all iterations.
        """
        low, high, size = bounds(self.model)
        prior = thresholds().fit.prior_sd
        best = list(candidates)
        damping = [1e-2] * len(best)
        found: list[np.ndarray] = []
        for _ in range(thresholds().fit.iterations if iterations is None else iterations):
            if not (chord and found):
                found = self.slopes_of(best)
            trials: list[np.ndarray] = []
            owner: list[int] = []
            for i, (c, jac) in enumerate(zip(best, found, strict=True)):
                places = list(c.places)
                away = (c.row - self.model.null)[places] / size[places]
                # The prior is also in the normal matrix: without it the step of a parameter that these records do not determine
                # would be arbitrary.
                normal = jac @ jac.T + np.eye(len(away)) / prior**2
                slope = jac @ c.z + away / prior**2
                # Two dampings at once instead of one and a retry: another row in a batch is cheap, another batch is not.
                for change in damped_steps(normal, slope, (damping[i], damping[i] * 30), 1e-9):
                    row = c.row.copy()
                    row[places] = np.clip(row[places] + change * size[places], low[places], high[places])
                    trials.append(row)
                    owner.append(i)
            z = self.z(np.array(trials))
            cost = self.costs(np.array(trials), z)
            for i, c in enumerate(best):
                mine = [j for j, o in enumerate(owner) if o == i]
                j = min(mine, key=lambda k: cost[k])
                # A step is accepted only if the true cost falls: the residual is not differentiable where a joint sticks, so the
                # predicted fall is unreliable.
                if cost[j] < c.cost:
                    best[i] = replace(c, row=trials[j], cost=float(cost[j]), z=z[j])
                    damping[i] = max(1e-4, damping[i] * (0.3 if j == mine[0] else 3))
                else:
                    damping[i] = min(1e4, damping[i] * 100)
        return sorted(best, key=lambda c: c.cost)

    def slopes_of(self, candidates: list[Candidate]) -> list[np.ndarray]:
        """(K, m) change of z with each parameter of each candidate, per typical size.

        Effects have units from rad to N s2/m2, and both the damping and the prior of `refine` need one scale.
        """
        # All candidates share one call of `z`: the compiled rollouts are vectorised over rows.
        steps = [difference_rows(self.model, c) for c in candidates]
        z = self.z(np.concatenate([rows for rows, _ in steps]))
        parts = np.split(z, np.cumsum([len(rows) for rows, _ in steps])[:-1])
        size = bounds(self.model)[2]
        given = zip(parts, candidates, steps, strict=True)
        return [slopes(part, c.z, moved, size[list(c.places)]) for part, c, (_, moved) in given]


def refine(search: EffectFitter, c: Candidate) -> Candidate:
    """The candidate with its parameters at their best on the fitter's records."""
    return search.refine([on_records(search, c)], 3)[0] if c.places else on_records(search, c)


def on_records(search: EffectFitter, c: Candidate) -> Candidate:
    """The same effects and parameters on another part of the records."""
    return search.at(c.row, c.names, c.places, c.added)


def drop_effect(search: EffectFitter, c: Candidate, name: str) -> Candidate:
    """The candidate with one effect at its null."""
    effect = search.model.active.effect(name)
    gone = {search.model.index(name, p.name) for p in effect.parameters}
    row = c.row.copy()
    row[list(gone)] = search.model.null[list(gone)]
    return search.at(row, tuple(n for n in c.names if n != name), tuple(p for p in c.places if p not in gone))


def difference_rows(model, c: Candidate) -> tuple[np.ndarray, np.ndarray]:
    """(K, P) the candidate's row with one parameter changed in each, for finite differences, and the changes (K,)."""
    _, high, size = bounds(model)
    places = list(c.places)
    rows = np.tile(c.row, (len(places), 1))
    rows[:, places], moved = differences(c.row[places], thresholds().fit.difference_step * size[places], high[places])
    return rows, moved


def probes(effect: Effect, fine: tuple[float, ...] = ()) -> list[tuple[int, float]]:
    """(parameter, value) pairs for trying an effect: several sizes, both sides if the parameter is signed.

    fine: further values of its fine parameter.
    """
    out = []
    for k, p in enumerate(effect.parameters):
        if p.shape:
            continue
        signs = (1.0, -1.0) if p.signed else ((1.0,) if p.high > p.null else (-1.0,))
        sizes = [*(m * _size(p) for m in thresholds().fit.probe_sizes), min(abs(t - p.null) for t in p.typical)]
        values = {float(np.clip(p.null + s * size, p.low, p.high)) for s in signs for size in sizes}
        values |= set(fine) if p.fine else set()
        out += [(k, v) for v in sorted(values - {p.null})]
    return out


def shape_probes(model, base: np.ndarray, effect: Effect) -> list[np.ndarray]:
    """Rows with the effect at its usual size and each shaping parameter on either side of its null."""
    out = []
    shapes = [p for p in effect.parameters if p.shape]
    for shape in shapes:
        for value in {float(np.clip(shape.null + s * _size(shape), shape.low, shape.high)) for s in (1.0, -1.0)} - {shape.null}:
            row = base.copy()
            for p in effect.parameters:
                if not p.shape:
                    usual = p.null + (1 if p.high > p.null else -1) * _size(p)
                    row[model.index(effect.name, p.name)] = np.clip(usual, p.low, p.high)
            row[model.index(effect.name, shape.name)] = value
            out.append(row)
    return out


def secants(model, base: Candidate, effect: Effect, tried) -> list[np.ndarray]:
    """Rows of the linear combination of each parameter's probes that lowers |z| most, one row a magnitude."""
    out = []
    for m in thresholds().fit.probe_sizes:
        columns, places, sizes = [], [], []
        for k, p in enumerate(effect.parameters):
            if p.shape:
                continue
            near = [(value, z) for (_, j, value), z in tried if j == k]
            value, z = min(near, key=lambda v: abs(abs(v[0] - p.null) - m * _size(p)))
            columns.append((z - base.z) / (value - p.null))
            places.append(model.index(effect.name, p.name))
            sizes.append(_size(p))
        jac = np.array(columns) * np.array(sizes)[:, None]
        normal = jac @ jac.T
        regular = normal + 1e-6 * np.trace(normal) * np.eye(len(normal)) + 1e-12 * np.eye(len(normal))
        change = -np.linalg.solve(regular, jac @ base.z)
        row = base.row.copy()
        for place, p, size, c in zip(places, [p for p in effect.parameters if not p.shape], sizes, change, strict=True):
            row[place] = np.clip(p.null + c * size, p.low, p.high)
        out.append(row)
    return out


def bounds(model) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(low, high, typical size) of every entry of a parameter row."""
    n = len(model.constants)
    entries = [p for e in model.active.effects for p in e.parameters]
    low = np.array([0.1] * n + [p.low for p in entries])
    high = np.array([10.0] * n + [p.high for p in entries])
    return low, high, np.array([1.0] * n + [_size(p) for p in entries])


def needs_fine_value(effect) -> bool:
    """Returns True if an effect's size must be exact to a fraction of a per cent, such as the step of quantised commands."""
    return any(p.fine and not p.shape for p in effect.parameters)


def limiting(model, c: Candidate) -> list[str]:
    """Names of the effects with a parameter on a bound that is not its null, where they become another law."""
    low, high, size = bounds(model)
    tolerance = thresholds().decide.bound_tolerance
    near = lambda place, edge: edge != model.null[place] and abs(c.row[place] - edge) < tolerance * size[place]
    own = {x.name: [model.index(x.name, p.name) for p in x.parameters] for x in model.active.effects if x.name in c.names}
    return [name for name in c.names if any(near(k, low[k]) or near(k, high[k]) for k in own.get(name, ()))]


def _size(parameter) -> float:
    """Typical departure from the null, at its large end."""
    return max(abs(t - parameter.null) for t in parameter.typical)
