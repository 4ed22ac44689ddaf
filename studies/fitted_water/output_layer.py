"""Output layer of the learnt residual among the unknowns of the hybrid's correction: does it help on segments not seen?

    python -m studies.fitted_water.output_layer --out output_layer.json          hours on one core, most of it derivatives

The fish swims in `swift` under the policy `station` in 0.2 m/s of turbulence. A made-up better water is `swift` with another
residual, or with other strips. Segments of 2 s begin every 10 s. The first two correct the water, one after the other, by

    none      nothing
    strips    factors, stream or both, by the greatest evidence, as `fishmj.engines.hybrid.online_correction` does
    best      the same with two more beliefs: the output layer alone (D, d, P), and everything

as recursive least squares with x ~ N(x', P); the weights have the standard deviation `--sd` in units of their rms. Held out are
the segments after the second: rms of the misses by window and channel over the irreducible error, which is 3 % of the speed
through the water and 4 mm/s, 5 % of the yaw rate and 1 deg/s, times the root of `own`. No forgetting, no noise. *synthetic*
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from fishmj import control, engines
from fishmj.base import console
from fishmj.engines import planar
from fishmj.engines.hybrid import HybridOptions, online_correction
from fishmj.engines.hybrid.engine import HybridEngine
from fishmj.engines.hybrid.hybrid import OWN
from fishmj.evaluate import protocol, run_trials
from fishmj.mjcf.reading import load_robot
from fishmj.water import choice
from fishmj.water.prior import unflat
from fishmj.water.residual_hooks import member

LAYER = ("outer", "outer_bias", "even", "odd")  # linear in the force
FREE, ROUNDS, SEEN = online_correction.FREE, 2, 2
STRIPS = len(FREE) + 2


class Recorder:
    """Keeps segments and corrects nothing."""

    def __init__(self):
        self.segments = []

    def swim(self, segments):
        self.segments += segments
        return ["recorded"] * len(segments)


class LayerReplay:
    """Movement of one fish in a segment as a function of factors, stream and changes of the output layer, with derivatives."""

    def __init__(self, robot, net):
        self.engine, self.net, self.tick = planar.PlanarEngine(robot), net, robot.timing.bus_dt
        self.learnt, self.sizes = self.engine.added.learnt, [np.asarray(getattr(net, key)).shape for key in LAYER]
        self.count = sum(int(np.prod(size)) for size in self.sizes)
        self.sd = np.concatenate([np.full(int(np.prod(s)), self.rms(k)) for k, s in zip(LAYER, self.sizes, strict=True)])
        self._values, self._slopes = jax.jit(self._means), jax.jit(jax.jacrev(self._means))

    def rms(self, key: str) -> float:
        """Size of a weight of one kind; a bias counts as a weight of D."""
        return float(np.sqrt(np.mean(np.asarray(getattr(self.net, "outer" if key == "outer_bias" else key)) ** 2)))

    def changed(self, x):
        """Net with changes x (count,), in its rms weights."""
        ends = np.cumsum([0, *(int(np.prod(size)) for size in self.sizes)])
        parts = [jnp.reshape((x * self.sd)[a:b], s) for a, b, s in zip(ends, ends[1:], self.sizes, strict=False)]
        return self.net._replace(**{key: getattr(self.net, key) + part for key, part in zip(LAYER, parts, strict=True)})

    def _means(self, x, start, commands, params, current, tick):
        factors = jnp.ones(10).at[jnp.array(FREE)].set(jnp.exp(x[: len(FREE)]))
        (mass, cross, skin, form, _), (tail_mass, tail_cross, _, _, edge) = factors[:5], factors[5:]
        c = unflat(list(params.water.T))
        body, plate = len(c.k) - 1, online_correction.PLATE
        c = c._replace(
            k=[v * mass for v in c.k[:body]] + [c.k[body] * tail_mass],
            cn=[v * cross for v in c.cn[:body]] + [c.cn[body] * tail_cross],
            cf=jnp.maximum(c.cf + (c.cf + plate) * (skin - 1.0), 0.0),
            ca_forward=c.ca_forward * form, ca_backward=c.ca_backward * form, ke=c.ke * edge,
        )  # fmt: skip
        water = jnp.stack(jnp.broadcast_arrays(*c.k, *c.cn, *c[2:]), 1)
        moved = current._replace(mean=current.mean + x[len(FREE) : STRIPS])
        engine = planar.PlanarEngine.__new__(planar.PlanarEngine)
        engine.__dict__.update(self.engine.__dict__)
        learnt = self.learnt._replace(net=self.changed(x[STRIPS:]))
        engine.added = type(self.engine.added)(
            self.engine.added.active, self.engine.added.row, self.engine.added.memory, learnt, self.engine.added.chain
        )
        _, trace = planar.PlanarEngine.advance.__wrapped__(engine, start, commands, params._replace(water=water), moved, tick)
        yaw, vx, vy = trace.pose[0, :, 2], trace.velocity[0, :, 0], trace.velocity[0, :, 1]
        turn = trace.velocity[0, :, 2]
        rates = jnp.stack([jnp.cos(yaw) * vx + jnp.sin(yaw) * vy, jnp.cos(yaw) * vy - jnp.sin(yaw) * vx, turn], -1)
        size = round(0.5 / self.tick)
        return rates[: len(rates) // size * size].reshape(-1, size, 3).mean(1).ravel()

    def of(self, segment, x, slopes: bool = False):
        """Means (K 3,) or their derivatives (K 3, unknowns)."""
        current = segment.current._replace(mean=np.asarray(segment.current.mean, float))
        at = np.array([segment.span])
        with jax.enable_x64(True):
            call = self._slopes if slopes else self._values
            return np.asarray(call(np.asarray(x, float), segment.start, segment.commands[None], segment.params, current, at))


def fitted(replay, segment, seen, wide, x0, belief, free, slopes):
    """MAP of the free unknowns: x, covariance after, and 2 ln of the evidence ratio. slopes: derivatives at x0."""
    prior, x = belief[np.ix_(free, free)], x0.copy()
    r0 = r = (replay.of(segment, x) - seen) / wide
    cost = lambda r, x: r @ r + (x - x0)[free] @ np.linalg.solve(prior, (x - x0)[free])
    for k in range(ROUNDS):
        jac = (slopes if k == 0 else replay.of(segment, x, slopes=True))[:, free] / wide[:, None]
        noise = np.eye(len(r)) + jac @ prior @ jac.T
        goal = prior @ jac.T @ np.linalg.solve(noise, jac @ (x - x0)[free] - r)
        for size in (1.0, 0.3, 0.1):
            tried = x.copy()
            tried[free] += size * (x0[free] + goal - x[free])
            after = (replay.of(segment, tried) - seen) / wide
            if np.isfinite(after).all() and cost(after, tried) < cost(r, x):
                break
        else:
            break
        x, r = tried, after
    gain = r0 @ r0 - cost(r, x) - np.linalg.slogdet(noise)[1]
    left = belief.copy()
    left[np.ix_(free, free)] = prior - prior @ jac.T @ np.linalg.solve(noise, jac @ prior)
    return x, left, gain


def main() -> None:
    """Runs all conditions and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fish", type=int, default=6)
    parser.add_argument("--sd", type=float, nargs="+", default=[0.3])
    parser.add_argument("--truths", nargs="+", help="default all")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    robot = choice.in_water(load_robot("fish"), "swift")
    trials = protocol.trials(speeds=(0.2,), repeats=1, duration=60.0)
    trials = replace(trials, items=trials.items[: args.fish])
    recorder = Recorder()
    options = HybridOptions(first=10.0, every=10.0, wait=True)
    engine = HybridEngine(robot, trials.flows()[0], options, oracle=recorder)
    run_trials.run(control.chosen("station", robot), robot, trials, engine)
    by_fish = [[s for s in recorder.segments if s.fish == k] for k in range(args.fish)]
    learnt = planar.PlanarEngine(robot).added.learnt
    replay, tick = LayerReplay(robot, learnt.net), robot.timing.bus_dt
    made, random = [], np.random.default_rng(0)
    noise = {key: random.normal(size=np.shape(getattr(learnt.net, key))) for key in LAYER}
    perturbed = lambda size: learnt.net._replace(
        **{key: getattr(learnt.net, key) + size * replay.rms(key) * noise[key] for key in LAYER}
    )
    slip = choice.in_water(load_robot("fish"), "swift-slip099")
    coefficients = engines.nominal_params(slip, 1).water
    truths = {
        "right": (learnt.net, None),
        "member": (member(learnt, 0).net, None),
        "no residual": (learnt.net._replace(**{key: 0.0 * getattr(learnt.net, key) for key in LAYER}), None),
        "layer off by 0.3": (perturbed(0.3), None),
        "layer off by 1": (perturbed(1.0), None),
        "slip 0.99": (learnt.net, coefficients),
    }
    for name in args.truths or truths:
        net, water = truths[name]
        began, true = time.perf_counter(), LayerReplay(robot, net)
        for rows in by_fish:
            made += one_fish(name, rows, replay, true, water, tick, args.sd)
        console.say(f"{name}: {time.perf_counter() - began:.0f} s")
        print_row(made, name)
        if args.out:
            args.out.write_text(json.dumps(made, indent=1))


def one_fish(name, rows, replay, true, water, tick, sds) -> list[dict]:
    """Held-out misses of every method for one fish."""
    seen, wide = [], []
    for s in rows:
        given = s if water is None else s._replace(params=s.params._replace(water=water))
        seen.append(true.of(given, np.zeros(STRIPS + true.count)))
        through = np.concatenate([seen[-1].reshape(-1, 3)[:, :2]], 1)
        heading = np.array([s.start.q[0, 2]])
        mean = np.asarray(s.current.mean)[0]
        ahead = np.cos(heading) * mean[0] + np.sin(heading) * mean[1]
        aside = np.cos(heading) * mean[1] - np.sin(heading) * mean[0]
        speed = np.hypot(through[:, 0] - ahead, through[:, 1] - aside)
        turn = np.abs(seen[-1].reshape(-1, 3)[:, 2])
        each = np.stack([0.03 * speed + 0.004, 0.03 * speed + 0.004, 0.05 * turn + np.radians(1)], 1)
        wide.append((each * np.sqrt(OWN)).ravel())
    held = lambda x: float(np.sqrt(np.mean([np.mean(((replay.of(s, x) - y) / w) ** 2) for s, y, w in
                                            list(zip(rows, seen, wide, strict=True))[SEEN:]])))  # fmt: skip
    start = np.zeros(STRIPS + replay.count)
    found = [{"truth": name, "method": "none", "held": held(start), "moved": False}]
    prior = [*online_correction.WRONG, *online_correction.WRONG]
    strips = [*(prior[k] for k in FREE), online_correction.STREAM, online_correction.STREAM]
    factors, stream, layer = list(range(len(FREE))), [STRIPS - 2, STRIPS - 1], list(range(STRIPS, STRIPS + replay.count))
    sets = {"factors": factors, "stream": stream, "strips": [*factors, *stream]}
    plans = {"strips": (sets, sds[0])}
    for sd in sds:
        more = {"layer": layer, "both": [*factors, *stream, *layer]}
        plans |= {f"best, sd {sd:g}": (sets | more, sd)}
    for method, (beliefs, sd) in plans.items():
        x, cov, chosen = start.copy(), np.diag(np.array([*strips, *[sd] * replay.count]) ** 2), []
        for s, y, w in list(zip(rows, seen, wide, strict=True))[:SEEN]:
            miss = ((replay.of(s, x) - y) / w).reshape(-1, 3)
            if not online_correction.refuted(miss):
                chosen.append("right")
                continue
            slopes = replay.of(s, x, slopes=True)
            tried = {key: fitted(replay, s, y, w, x, cov, free, slopes) for key, free in beliefs.items()}
            best = max(tried, key=lambda key: tried[key][2])
            if tried[best][2] > 0:
                x, cov, _ = tried[best]
            chosen.append(best if tried[best][2] > 0 else "right")
        found.append({"truth": name, "method": method, "held": held(x), "moved": bool(np.any(x)), "chosen": chosen})
    return found


def print_row(made: list[dict], name: str) -> None:
    """Prints mean held-out misses by method, and paired differences from `strips`."""
    some = [row for row in made if row["truth"] == name]
    methods = list(dict.fromkeys(row["method"] for row in some))
    values = {m: np.array([row["held"] for row in some if row["method"] == m]) for m in methods}
    for m in methods:
        off, moved = values[m] - values["strips"], sum(row["moved"] for row in some if row["method"] == m)
        se = off.std(ddof=1) / np.sqrt(len(off)) if len(off) > 1 else float("nan")
        chosen = [c for row in some if row["method"] == m for c in row.get("chosen", [])]
        counts = ", ".join(f"{c} {chosen.count(c)}" for c in dict.fromkeys(chosen))
        console.say(f"  {m:16s} {values[m].mean():.3f}   minus strips {off.mean():+.3f} (se {se:.3f})  moved {moved}  {counts}")


if __name__ == "__main__":
    main()
