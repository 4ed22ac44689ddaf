"""Code generator: turns a physics step in components into straight-line source, jaxpr -> value graph -> Python text.

`jax.make_jaxpr` of a function on scalars is a list of primitive operations. The graph below eliminates common subexpressions and
dead code, and folds constants and the identities 0 x, 1 x, x + 0. The text is plain Python arithmetic on names: tests run it in
NumPy at float64, and numba compiles it at float32 for use.
"""

import math
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

from fishmj.base.errors import ConfigError

BINARY = {"add": "{} + {}", "sub": "{} - {}", "mul": "{} * {}", "div": "{} / {}", "and": "{} & {}"}
PLAIN = ("sqrt", "sin", "cos", "exp", "atan2", "floor")  # functions that have one name in all languages
CALLS = {"abs": "absolute", "max": "maximum", "min": "minimum"} | {name: name for name in PLAIN}
COMPARE = {"gt": ">", "lt": "<", "ge": ">=", "le": "<="}
FOLD: dict[str, Callable[..., float]] = {name: getattr(math, name) for name in PLAIN} | {"abs": abs, "max": max, "min": min}
FOLD |= {"add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv, "neg": operator.neg}
COMMUTES = ("add", "mul", "and")


class Program(NamedTuple):
    """Straight-line code: `inputs` name the arguments, `lines` assign values, `outputs` are names or constants."""

    inputs: tuple
    lines: tuple  # of (name, expression)
    constants: dict  # name -> float
    outputs: tuple

    def assignments(self, indent: str = "") -> str:
        """The body as text."""
        return "".join(f"{indent}{name} = {text}\n" for name, text in self.lines)

    def numbers(self) -> str:
        """Definitions of the constants as text; `real` is the float type."""
        return "".join(f"{name} = real({value!r})\n" for name, value in self.constants.items())


class Graph:
    """Graph of numbered values; equal values share one number."""

    def __init__(self):
        self.nodes, self.number = [], {}

    def add(self, *node) -> int:
        """The number of `node` = (operation, arguments...)."""
        # a + b and b + a round alike, so sorted operands make them one value
        if node[0] in COMMUTES and node[1] > node[2]:
            node = (node[0], node[2], node[1])
        if node not in self.number:
            self.number[node] = len(self.nodes)
            self.nodes.append(node)
        return self.number[node]

    def constant(self, value: float) -> int:
        """Number of the constant `value` in the graph."""
        return self.add("const", float(value))

    def value(self, number: int):
        """The constant behind `number`, or None."""
        node = self.nodes[number]
        return node[1] if node[0] == "const" else None

    def apply(self, op: str, *args: int) -> int:
        """Adds an operation, simplified if a constant allows it; returns its number."""
        known = [self.value(a) for a in args]
        if op in FOLD and None not in known:
            return self.constant(FOLD[op](*known))
        # 0 x = 0 is wrong for inf and nan, but intended here: a zero coefficient removes its term
        if op == "mul":
            for value, other in zip(known, args[::-1], strict=True):
                if value == 0.0:
                    return self.constant(0.0)
                if value == 1.0:
                    return other
                if value == -1.0:
                    return self.apply("neg", other)
        if op == "add":
            for value, other in zip(known, args[::-1], strict=True):
                if value == 0.0:
                    return other
        if op == "sub" and known[1] == 0.0:
            return args[0]
        if op == "sub" and known[0] == 0.0:
            return self.apply("neg", args[1])
        # a product is faster than a quotient; the reciprocal is computed in float64, before rounding to float32
        if op == "div" and known[1] is not None:
            return self.apply("mul", args[0], self.constant(1.0 / known[1]))
        if op == "neg" and self.nodes[args[0]][0] == "neg":
            return self.nodes[args[0]][1]
        return self.add(op, *args)

    def power(self, base: int, exponent: int) -> int:
        """base ** exponent by repeated multiplication."""
        if exponent < 0:
            return self.apply("div", self.constant(1.0), self.power(base, -exponent))
        if exponent == 0:
            return self.constant(1.0)
        half = self.power(base, exponent // 2)
        square = self.apply("mul", half, half)
        return self.apply("mul", square, base) if exponent % 2 else square

    def inline(self, jaxpr, consts, args) -> list:
        """Numbers of the outputs of `jaxpr` applied to `args`, nested jaxprs inlined."""
        env = dict(zip(jaxpr.constvars, (self.constant(c) for c in consts), strict=True))
        env.update(zip(jaxpr.invars, args, strict=True))
        read = lambda atom: self.constant(atom.val) if hasattr(atom, "val") else env[atom]
        for eqn in jaxpr.eqns:
            op, inputs = eqn.primitive.name, [read(atom) for atom in eqn.invars]
            nested = next((eqn.params[k] for k in ("jaxpr", "call_jaxpr") if k in eqn.params), None)
            if nested is not None:
                results = self.inline(getattr(nested, "jaxpr", nested), getattr(nested, "consts", ()), inputs)
            elif op == "integer_pow":
                results = [self.power(inputs[0], eqn.params["y"])]
            elif op == "square":
                results = [self.power(inputs[0], 2)]
            elif op in ("convert_element_type", "copy", "stop_gradient"):
                results = inputs
            # select_n(p, no, yes) is where(p, yes, no)
            elif op == "select_n" and len(inputs) == 3:
                results = [self.apply("select", inputs[0], inputs[2], inputs[1])]
            elif op in BINARY or op in CALLS or op in COMPARE or op == "neg":
                results = [self.apply(op, *inputs)]
            else:
                known = ", ".join(sorted({*BINARY, *CALLS, *COMPARE, "neg", "select_n", "integer_pow", "square"}))
                raise ConfigError(
                    f"compiled engine: the physics uses {op!r}, which the code generator does not support; supported: {known}"
                )
            env.update(zip(eqn.outvars, results, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def program(self, inputs: list, outputs: list, prefix: str) -> Program:
        """Program that computes `outputs` (numbers); constants are named prefix0, prefix1, ..."""
        # going backwards from the outputs leaves unused values out. Numbers rise from arguments to results, so in sorted order
        # every value is defined before its use
        needed, stack = set(), list(outputs)
        while stack:
            number = stack.pop()
            if number not in needed:
                needed.add(number)
                if self.nodes[number][0] not in ("const", "in"):
                    stack.extend(self.nodes[number][1:])
        names, lines, constants = {}, [], {}
        for number in sorted(needed):
            op, *args = self.nodes[number]
            if op == "in":
                names[number] = args[0]
            elif op == "const":
                names[number] = f"{prefix}{len(constants)}"
                constants[names[number]] = args[0]
            else:
                names[number] = f"v{len(lines)}"
                lines.append((names[number], _text(op, [names[a] for a in args])))
        return Program(tuple(inputs), tuple(lines), constants, tuple(names[n] for n in outputs))


def _text(op: str, args: list) -> str:
    if op in BINARY:
        return BINARY[op].format(*args)
    if op in CALLS:
        return f"{CALLS[op]}({', '.join(args)})"
    if op in COMPARE:
        return f"{args[0]} {COMPARE[op]} {args[1]}"
    if op == "neg":
        return f"-{args[0]}"
    return f"where({args[0]}, {args[1]}, {args[2]})"


def trace(function: Any, names: Any, prefix: str = "k") -> Program:
    """Traces `function` to a straight-line program; its argument has the structure of `names`, with scalars.

    Args:
        function: takes one pytree, returns a list of scalars.
        names: the same pytree with a distinct string in place of every scalar.
        prefix: prefix of the names of constants.
    Raises:
        ConfigError: the function uses an operation that the generator does not know.
    """
    import jax

    leaves, shape = jax.tree_util.tree_flatten(names)
    with jax.enable_x64(True):  # constants stay exact until rounding in the text
        closed = jax.make_jaxpr(lambda *flat: function(jax.tree_util.tree_unflatten(shape, flat)))(*[0.5] * len(leaves))
    graph = Graph()
    inputs = [graph.add("in", name) for name in leaves]
    return graph.program(leaves, graph.inline(closed.jaxpr, closed.consts, inputs), prefix)
