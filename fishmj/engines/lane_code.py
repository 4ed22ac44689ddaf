"""Straight-line loops over the lanes of a workspace, written as LLVM's instructions without numba's own front end.

numba infers the type of every statement and lowers it alone: some 2 ms for each of thousands of statements. The bodies of these
loops do not need that: every value is `real`, a whole number or a truth value. A function with the decorator `lanes` is read from
the text of its module (`TEXT`) and written as the instructions that numba would emit. Elementary functions (fast_math.py) become
functions of LLVM's own. After optimisation both ways give the same code and the same bits. A numba function wraps the result, so
that other functions call it like any other. Its symbol contains the name of the generated module, because two modules of one
process must not share a symbol.

    names = expressions                  numbers of the array `c`, read before the loop
    for i in range(LANES): ...           assignments to names and to w[row * LANES + i]

Example with 16 lanes and `real` float32, input text -> output IR (getelementptr shortened to gep):

    a = c[3]                          %5 = gep float, float* %c, i64 3;  %6 = load float, float* %5
    for i in range(LANES):            a loop over i64 %i from 0 to 15
        x = w[32 + i]                 %7 = add i64 32, %i;  %8 = gep float, float* %w, i64 %7;  %9 = load float, float* %8
        y = a * x                     %10 = fmul float %6, %9
        y = y + absolute(x)           %11 = call float @llvm.fabs.f32(float %9);  %12 = fadd float %10, %11
        w[80 + i] = y                 %13 = add i64 80, %i;  %14 = gep float, float* %w, i64 %13;  store float %12, float* %14

A function may contain the calls `wide()`, `real`, `whole`, `absolute`, `sqrt`, `floor`, and functions of the module that consist
of assignments and a return; + - * / & <<, comparisons, `a if b else c`, `x.view(real)`, tuples, items of arrays.
"""

import ast
from collections.abc import Callable
from functools import cache
from typing import Any

INTRINSICS = {"absolute": "llvm.fabs", "sqrt": "llvm.sqrt", "floor": "llvm.floor"}
COMPARED = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="}
FLOATS = {ast.Add: "fadd", ast.Sub: "fsub", ast.Mult: "fmul", ast.Div: "fdiv"}
WHOLE = {ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.BitAnd: "and_", ast.LShift: "shl"}


@cache
def functions_of(text: str) -> dict[str, ast.FunctionDef]:
    """Functions of a module, by name."""
    return {node.name: node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)}


def lanes(function: Callable) -> Any:
    """Compiles a function of a generated module as above; the module's globals hold its `TEXT`, INNER, LANES and `real`."""
    from numba import njit, void
    from numba.extending import intrinsic

    scope, name = function.__globals__, function.__name__
    made = functions_of(scope["TEXT"])[name]
    arguments = ", ".join(argument.arg for argument in made.args.args)

    def write(context, builder, signature, values):
        Writer(context, builder, scope).function(made, signature.args, values)
        return context.get_dummy_value()

    inside = {"typed": lambda *types: (void(*types), write)}
    exec(f"def body(context, {arguments}):\n    return typed({arguments})", inside)  # noqa: S102  names of our own text
    around = {"__name__": scope["__name__"], "lanes_body": intrinsic(inside["body"])}
    exec(f"def {name}({arguments}):\n    lanes_body({arguments})", around)  # noqa: S102
    return njit(**scope["INNER"])(around[name])


class Writer:
    """Writes the instructions of one function at the position of `builder`. scope: globals of the generated module."""

    def __init__(self, context, builder, scope: dict):
        from llvmlite import ir

        self.context, self.builder, self.scope, self.ir = context, builder, scope, ir
        self.functions = functions_of(scope["TEXT"])
        single = scope["real"].__name__ == "float32"
        self.real, self.whole = (ir.FloatType(), ir.IntType(32)) if single else (ir.DoubleType(), ir.IntType(64))
        self.index = ir.IntType(64)

    def function(self, made: ast.FunctionDef, types, values) -> None:
        """Writes the whole function. types, values: numba's types and LLVM's values of its arguments."""
        from numba.core import cgutils
        from numba.core import types as kinds

        env: dict[str, Any] = {}
        for argument, kind, value in zip(made.args.args, types, values, strict=True):
            if isinstance(kind, kinds.Array):
                array = self.context.make_array(kind)(self.context, self.builder, value)
                value = array.data, cgutils.unpack_tuple(self.builder, array.shape)
            env[argument.arg] = value
        for line in made.body:
            if isinstance(line, ast.For):
                with cgutils.for_range(self.builder, self.index(self.scope["LANES"])) as loop:
                    self.lines(line.body, env | {ast.unparse(line.target): loop.index})
            elif isinstance(line, ast.Expr):  # wide()
                set.add(self.builder.function.attributes, '"prefer-vector-width"="512"')
            else:
                self.lines([line], env)

    def lines(self, body: list[Any], env: dict) -> Any:
        """Writes assignments, into `env` or into memory; returns the value of a return statement."""
        for line in body:
            if isinstance(line, ast.Return):
                return self.value(line.value, env)
            if isinstance(line, ast.AugAssign):
                found = self.binary(line.op, self.value(line.target, env), self.value(line.value, env))
                self.assign(line.target, found, env)
                continue
            found = self.value(line.value, env)
            for target in line.targets:
                self.assign(target, found, env)
        return None

    def assign(self, target, found, env: dict) -> None:
        """Binds a value to a name, each part of a tuple to its target, or stores it in an item of an array."""
        if isinstance(target, ast.Tuple):
            for part, value in zip(target.elts, found, strict=True):
                self.assign(part, value, env)
        elif isinstance(target, ast.Name):
            env[target.id] = found
        else:
            self.builder.store(found, self.place(target, env))

    def place(self, item: Any, env: dict) -> Any:
        """Address of an item of an array of one or two axes."""
        data, shape = env[item.value.id]
        if isinstance(item.slice, ast.Tuple):
            row, column = (self.number(self.value(part, env)) for part in item.slice.elts)
            at = self.builder.add(self.builder.mul(row, shape[1]), column)
        else:
            at = self.number(self.value(item.slice, env))
        return self.builder.gep(data, [at])

    def number(self, value) -> Any:
        """Index as an LLVM value; a value that is known now is a Python int."""
        return self.index(value) if isinstance(value, int) else value

    def value(self, node: Any, env: dict) -> Any:
        """Value of an expression: LLVM's, a Python number if it is known, or a tuple."""
        b = self.builder
        match node:
            case ast.Constant():
                return node.value
            case ast.Name():
                found = env[node.id] if node.id in env else self.scope[node.id]
                return found if hasattr(found, "type") or isinstance(found, int) else self.real(float(found))
            case ast.Tuple():
                return tuple(self.value(part, env) for part in node.elts)
            case ast.Subscript():
                return b.load(self.place(node, env))
            case ast.UnaryOp():
                operand = self.value(node.operand, env)
                # numba's negation: minus zero minus x
                return -operand if isinstance(operand, int | float) else b.fsub(self.real(-0.0), operand)
            case ast.BinOp():
                return self.binary(node.op, self.value(node.left, env), self.value(node.right, env))
            case ast.Compare(ops=[op], comparators=[other]):
                return b.fcmp_ordered(COMPARED[type(op)], self.value(node.left, env), self.value(other, env))
            case ast.IfExp():
                return b.select(*(self.value(part, env) for part in (node.test, node.body, node.orelse)))
            case ast.Call(func=ast.Attribute(attr="view", value=given), args=[ast.Name(id="real" | "whole" as kind)]):
                return b.bitcast(self.value(given, env), getattr(self, kind))
            case ast.Call(func=ast.Name(id=name), args=given):
                return self.call(name, [self.value(part, env) for part in given])
        raise TypeError(f"lanes: cannot write {ast.unparse(node)}")

    def binary(self, op, left, right) -> Any:
        """Value of a binary operation: a Python int of two ints, else one LLVM instruction for floats or whole numbers."""
        if isinstance(left, int) and isinstance(right, int):
            return {ast.Add: left + right, ast.Mult: left * right, ast.Sub: left - right}[type(op)]
        left, right = (self.number(side) for side in (left, right))
        names = FLOATS if left.type == self.real else WHOLE
        return getattr(self.builder, names[type(op)])(left, right)

    def call(self, name: str, given: list) -> Any:
        """Value of a call: a conversion, an instruction of LLVM, or a function of the module."""
        b, first = self.builder, given[0]
        if name in ("real", "whole"):
            kind = getattr(self, name)
            if isinstance(first, int | float):
                return kind(float(self.scope[name](first)) if name == "real" else int(first))
            if first.type == kind:
                return first
            return b.fptosi(first, kind) if name == "whole" else b.sitofp(first, kind)
        if name in INTRINSICS:
            return b.call(b.module.declare_intrinsic(INTRINSICS[name], [self.real]), given)
        found = b.call(self.helper(name, [value.type for value in given]), given)
        if isinstance(found.type, self.ir.LiteralStructType):
            return tuple(b.extract_value(found, i) for i in range(len(found.type.elements)))
        return found

    def helper(self, name: str, types: list) -> Any:
        """LLVM function for a function of the module, written once."""
        module, ir = self.builder.module, self.ir
        known = f"lanes.{name}"
        if known in module.globals:
            return module.globals[known]
        made = self.functions[name]
        parts = [node.value for node in ast.walk(made) if isinstance(node, ast.Return)]
        gives = ir.LiteralStructType([self.real] * len(parts[0].elts)) if isinstance(parts[0], ast.Tuple) else self.real
        function = ir.Function(module, ir.FunctionType(gives, types), known)
        function.linkage = "internal"
        there = ir.IRBuilder(function.append_basic_block())
        outer, self.builder = self.builder, there
        names = (argument.arg for argument in made.args.args)
        found = self.lines(made.body, dict(zip(names, function.args, strict=True)))
        self.builder = outer
        if isinstance(found, tuple):
            whole = ir.Constant(gives, ir.Undefined)
            for i, part in enumerate(found):
                whole = there.insert_value(whole, part, i)
            found = whole
        there.ret(found)
        return function
