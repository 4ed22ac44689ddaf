"""The learnt residual in the compiled engine: its network as vector code, with the weights as an argument.

A physics step with a residual calls three functions on the workspace, in this order:
    features   generated from `residual_network.motion`: inputs of the network
    network    written here: force coefficients, spread of the ensemble's members, next wake states
    physics    generated from `planar_chain.step` with `PrecomputedResidual` hooks, the rest of `residual_hooks.LearnedResidual`

The text depends only on shapes (links, members, hidden units), so all fitted waters of a robot share one machine code; weights,
range and lengths come as one flat array. With the input split into e, even under the mirror symmetry, and o, odd under it,
    p = a + A_e e,   q = A_o o,   (tanh(p + q) +- tanh(p - q)) / 2 = (sinh 2p, sinh 2q) / (cosh 2p + cosh 2q)
both branches of the mirror need half the multiply-adds, and the symmetry holds exactly. Weights are stored times 2 / ln 2, so
that each e^2x is a power of two. A block of units shares every loaded input.
"""

import re
from math import log
from typing import Any, NamedTuple

import numpy as np

from fishmj.water import residual_hooks, residual_network
from fishmj.water.dynamics import planar_chain
from fishmj.water.residual_network import BOUND, WAKES

BLOCK = 4  # hidden units that share each load of an input
NUMBER = re.compile(r"\bc\[([^]]*)\]")  # an item of the weights `c` in the text of a loop
POWER = 2 / log(2)  # tanh x = (2^(POWER x) - 1) / (2^(POWER x) + 1)


class Shape(NamedTuple):
    """Sizes on which the text of the network depends."""

    links: int
    members: int
    hidden: int
    ranged: bool  # the residual has a range

    @classmethod
    def of(cls, learnt: residual_hooks.Residual) -> "Shape":
        """Shape of a residual."""
        members, hidden, _ = np.shape(learnt.net.inner)
        return cls(len(learnt.net.even), members, hidden, learnt.reach is not None)

    @property
    def inputs(self) -> tuple[list[int], list[int]]:
        """Indices of the even and of the odd inputs [x, z] under the mirror symmetry."""
        even, features = self.links + 1, 3 * self.links + 1
        wakes = range(features, features + WAKES)
        return [*range(even), *wakes[: WAKES // 2]], [*range(even, features), *wakes[WAKES // 2 :]]

    @property
    def block(self) -> int:
        """Number of weights of a block of units."""
        return BLOCK * (1 + sum(map(len, self.inputs)))

    @property
    def blocks(self) -> int:
        """Number of blocks of a member's hidden units; units with zero weights pad the last one."""
        return -(-self.hidden // BLOCK)

    def rows(self) -> dict:
        """Rows of the workspace that the network needs."""
        line = lambda name, count: [f"{name}{i}" for i in range(count)]
        forces = 3 * self.links
        return {
            "feature": line("feature", forces + 1),
            "pace": "pace",
            "unit": line("unit", 2 * BLOCK),  # half sums, then half differences, of a block
            "product": line("product", forces),
            "sum": line("sum", forces),  # of one member
            "coefficient": line("coefficient", forces),  # mean over the members
            "spread": "spread",
            "next": line("next", WAKES),
        }

    def sizes(self) -> dict[str, int]:
        """Sizes of each part of the flat array, in order."""
        forces = 3 * self.links
        even, odd = (len(pairs[0]) for pairs in residual_network.products(self.links))
        return {
            "units": (self.members * self.blocks + WAKES // BLOCK) * self.block,  # those of the wake last
            "outer": self.members * self.blocks * BLOCK * forces,
            "bias": self.members * forces,
            "products": self.links * even + 2 * self.links * odd,
            "rates": WAKES,
            "range": self.ranged * (self.links * (residual_hooks.SEEN * (residual_hooks.SEEN + 1) + 2) + 1),
        }

    def starts(self) -> dict[str, int]:
        """First index of each part."""
        sizes = self.sizes()
        return dict(zip(sizes, np.cumsum([0, *sizes.values()]).tolist(), strict=False))

    def range_places(self) -> dict[str, int]:
        """{name: index in the flat array} of the numbers of a range."""
        first = self.starts()["range"]
        return {f"range{i}": first + i for i in range(self.sizes()["range"])}


def flat_weights(learnt: residual_hooks.Residual, dt: float, dtype) -> np.ndarray:
    """Flat array of weights and range, in the order of `Shape.sizes`; dt: physics step, s."""
    shape, net = Shape.of(learnt), residual_network.Net(*(np.asarray(a, float) for a in learnt.net))
    columns = [number for half in shape.inputs for number in half]

    def units(weights, bias):
        """Weights in blocks of units: biases, then the weights of each input."""
        more = -len(bias) % BLOCK
        rows = np.concatenate([np.column_stack([bias, weights[:, columns]]), np.zeros((more, 1 + len(columns)))])
        return rows.reshape(-1, BLOCK, 1 + len(columns)).swapaxes(1, 2)

    layers = [*zip(net.inner, net.inner_bias, strict=True), (net.wake, net.wake_bias)]
    idle = ((0, 0), (0, 0), (0, BLOCK * shape.blocks - shape.hidden))
    even = np.arange(3 * shape.links) < shape.links  # odd outputs have no bias
    parts = [np.ravel(units(w, b)) * POWER for w, b in layers]
    outer = (np.pad(net.outer, idle).swapaxes(1, 2), net.outer_bias * even, net.even.T, net.odd.T)
    parts += [np.ravel(w) * (POWER / BOUND) for w in outer] + [-dt / np.exp(net.reach) / log(2)]
    if learnt.reach is not None:
        parts += [np.ravel(np.asarray(a, float)) for a in learnt.reach]
    return np.concatenate(parts).astype(dtype)


class PrecomputedResidual(residual_hooks.LearnedResidual):
    """Residual whose network output is an input: mean coefficients (3 N), spread () and the next wake (WAKES)."""

    def __init__(self, xp, ch, learnt, memory, inner, coefficients, spread, wake):
        super().__init__(xp, ch, learnt, memory, inner)
        n = ch.n
        self.answer = [coefficients[i * n : (i + 1) * n] for i in range(3)], spread, wake

    def network(self, learnt, m, z, dt):
        """Returns the given output of the network."""
        return self.answer


def hooks_from_network_output(xp, ch: planar_chain.Chain, shape: Shape, inner: Any, a: dict) -> PrecomputedResidual:
    """Hooks of the generated step; a: its arguments by the names of `Shape.rows`, and the flat `range`."""
    reach = None
    if shape.ranged:
        n, seen, given = shape.links, residual_hooks.SEEN, iter(a["range"])
        take = lambda *counts: [take(*counts[1:]) for _ in range(counts[0])] if counts else next(given)
        reach = residual_hooks.MotionRange(take(n, seen), take(n, seen, seen), take(n), take(n), take())
    unused: Any = None  # the step does not need the weights
    learnt = residual_hooks.Residual(unused, reach)
    return PrecomputedResidual(xp, ch, learnt, a["memory"], inner, a["coefficient"], a["spread"], a["next"])


def features(xp, ch: planar_chain.Chain, sw, inner: Any, q, v, flow) -> list:
    """Inputs of the network in a step, `feature` and `pace`; hooks before the water act as in `planar_chain.step`."""
    panels = residual_network.panels(ch)
    if inner is not None:
        ch, sw = inner.fish(ch, sw)
        flow = inner.flow(ch, q, flow)
    m = residual_network.motion(xp, panels, residual_hooks.batched(planar_chain.kinematics(xp, ch, q, v, flow)))
    return [*m.x, m.speed]


def network(shape: Shape, rows: dict[str, int], wake: int) -> str:
    """Text of `network(w, c)`; wake: the row of the first wake state."""
    starts, sizes, n, forces = shape.starts(), shape.sizes(), shape.links, 3 * shape.links
    (even, odd), block = shape.inputs, shape.block
    at = lambda name, k=0: f"w[{rows[f'{name}0'] + k} * LANES + i]"
    one = lambda name: f"w[{rows[name]} * LANES + i]"
    seen = lambda j: at("feature", j) if j <= forces else f"w[{wake + j - forces - 1} * LANES + i]"
    each = range(forces)

    units = [f"e{j} = {seen(j)}" for j in even + odd]
    units += _dense("p", even, 0, True) + _dense("q", odd, BLOCK * (1 + len(even)), False)
    for k in range(BLOCK):
        units += [f"m, d = tanh_pair(p{k}, q{k})", f"{at('unit', k)} = m", f"{at('unit', BLOCK + k)} = d"]

    pairs, place = [f"e{j} = {seen(j)}" for j in range(forces + 1)] + [f"g{k} = real(0.0)" for k in each], starts["products"]
    for own, (first, second) in zip((range(n), range(n, forces)), residual_network.products(n), strict=True):
        for i, j in zip(first, second, strict=True):
            pairs += [f"v = e{i} * e{j}", *(f"g{k} += c[{place + k - own[0]}] * v" for k in own)]
            place += len(own)
    pairs += [f"{at('product', k)} = g{k}" for k in each]
    pairs += [f"{at('coefficient', k)} = real(0.0)" for k in each] + [f"{one('spread')} = real(0.0)"]

    # all stores at the end, because the compiler cannot move loads across stores
    gathered = [f"u{k} = {at('unit', k)}" for k in range(2 * BLOCK)]
    for k in each:
        parts = (f"c[{forces * u + k}] * u{u + BLOCK * (k >= n)}" for u in range(BLOCK))
        gathered.append(f"g{k} = {at('sum', k)} + {' + '.join(parts)}")
    gathered += [f"{at('sum', k)} = g{k}" for k in each]

    # Welford's mean and variance over the members, which needs no storage of members
    joined = [f"g{k} = {at('sum', k)}" for k in each] + [f"spread = {one('spread')}"]
    joined += [f"g{k}, g{(k + 1) % forces} = tanh_two(g{k}, g{(k + 1) % forces})" for k in range(0, forces - 1, 2)]
    joined += [f"g{forces - 1}, _ = tanh_two(g{forces - 1}, real(0.0))"] * (forces % 2)
    for k in each:
        mean = at("coefficient", k)
        joined += [f"g = real({BOUND!r}) * g{k}", f"off = g - {mean}", f"{mean} += weight * off", f"spread += off * (g - {mean})"]
    joined.append(f"{one('spread')} = spread")

    last = [f"pace = {one('pace')}", f"{one('spread')} = {one('spread')} * real({1 / (max(shape.members - 1, 1) * forces)!r})"]
    for k in range(WAKES):
        state = f"w[{wake + k} * LANES + i]"
        last += [f"target = {at('next', k)}", f"z{k} = target + ({state} - target) * exp2(pace * c[{starts['rates'] + k}])"]
    last += [f"{at('next', k)} = z{k}" for k in range(WAKES)]

    functions = {
        "units(w, c, row)": units,
        "products(w, c)": pairs,
        "begin(w, c, row)": [f"{at('sum', k)} = {at('product', k)} + c[{k}]" for k in each],
        "gather(w, c, row)": gathered,
        "join(w, weight)": joined,
        "settle(w, c)": last,
    }
    text = "".join(f"@lanes\ndef {name}:\n    wide()\n{_loop(lines, 'row' in name)}\n\n" for name, lines in functions.items())
    table = lambda name, columns: f"c[{starts[name]} : {starts[name] + sizes[name]}].reshape({sizes[name] // columns}, {columns})"
    return f"""{text}
@njit(**MATH)
def network(w, c):
    inner, outer, bias = {table("units", block)}, {table("outer", forces * BLOCK)}, {table("bias", forces)}
    products(w, c)
    for member in range({shape.members}):
        begin(w, bias, member)
        for row in range({shape.blocks} * member, {shape.blocks} * (member + 1)):
            units(w, inner, row)
            gather(w, outer, row)
        join(w, real(1.0) / real(member + 1))
    for block in range({WAKES // BLOCK}):
        units(w, inner, {shape.members * shape.blocks} + block)
        turned = {BLOCK} * LANES if block >= {WAKES // BLOCK // 2} else 0
        for k in range({BLOCK} * LANES):
            w[({rows["next0"]} + {BLOCK} * block) * LANES + k] = w[{rows["unit0"]} * LANES + turned + k]
    settle(w, c)


"""


def _loop(lines: list[str], row: bool) -> str:
    """Loop of `lines` over the lanes; weights are loaded before it, where the compiler sees no store that may change them.

    row: the weights are one row of a table `c`.
    """
    names: dict[str, str] = {}
    name = lambda found: names.setdefault(f"c[row, {found[1]}]" if row else found[0], f"c{len(names)}")
    body = "".join(f"        {NUMBER.sub(name, line)}\n" for line in lines)
    return "".join(f"    {key} = {place}\n" for place, key in names.items()) + f"    for i in range(LANES):\n{body}"


def _dense(out: str, inputs: list[int], at: int, bias: bool) -> list[str]:
    """Lines for out0.. = bias + weights . e for a block of units, their weights of one input side by side from `at`."""
    lines = [f"{out}{k} = c[{at + k}]" for k in range(BLOCK)] if bias else []
    for place, j in enumerate(inputs):
        sign = "+=" if bias or place else "="
        lines += [f"{out}{k} {sign} c[{at + BLOCK * (place + bias) + k}] * e{j}" for k in range(BLOCK)]
    return lines
