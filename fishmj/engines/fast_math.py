"""Elementary functions as short polynomials, which a compiler can vectorise.

    sin, cos   x = r + n pi,  |r| <= pi/2;   sin x = (-1)^n r S(r^2),  cos x = (-1)^n C(r^2)
    exp        x = r + n ln 2,  |r| <= ln 2 / 2;   exp x = 2^n E(r)
    atan2      t = min(|x|, |y|) / max(|x|, |y|),  atan t = t A(t^2), then unfolded by octant
    exp2       x = z + n,  |z| <= 1/2, |x| clipped to `held`;   2^x = 2^n T(z)
    tanh_two   tanh x, tanh y from a = e^2x, b = e^2y:  (a - 1) / (a + 1), one quotient for both
    tanh_pair  half the sum and difference of tanh(p + q), tanh(p - q):  (a b - 1, a - b) / ((a + 1) (b + 1))
The arguments of the last two are in units of ln 2 / 2; the factor is included in the weights of a network.

S, C, E, A, T interpolate the functions at Chebyshev points (near minimax). No table of coefficients is needed: they are computed
here for each precision. pi and ln 2 are split in parts whose products with n are exact (Cody & Waite 1980), which holds for
|n| < 2^`spare`. Errors up to |x| = 10^4 rad, float32 (float64): 2e-7 (4e-15) for sin and cos, 4e-7 (4e-15) for atan2, and
relative for exp, 3e-7 (1e-15) for the hyperbolic tangents; tested by tests/test_codegen.py.
"""

from math import log, pi
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial


class Precision(NamedTuple):
    """Polynomial degrees and bit format of one float type."""

    name: str
    integer: str
    mantissa: int  # bits
    bias: int  # of the exponent
    largest: float  # argument of exp
    spare: int  # bits left free in the parts of pi and ln 2
    held: float  # largest argument of exp2, so that the product of two powers is finite
    degree: tuple  # of S, C, E, A, T


SINGLE = Precision("float32", "int32", 23, 127, 87.0, 12, 60.0, (5, 6, 6, 8, 5))
DOUBLE = Precision("float64", "int64", 52, 1023, 708.0, 24, 500.0, (9, 10, 12, 18, 11))
PRECISIONS = {p.name: p for p in (SINGLE, DOUBLE)}

TEMPLATE = """
@njit(**MATH)
def turns(x):
    n = floor(x * real({inverse_pi!r}) + real(0.5))
    half = n * real(0.5)
    return {reduce_pi}, real(1.0) - real(4.0) * (half - floor(half))


@njit(**MATH)
def sin(x):
    r, sign = turns(x)
    z = r * r
    return sign * r * {S}


@njit(**MATH)
def cos(x):
    r, sign = turns(x)
    z = r * r
    return sign * {C}


@njit(**MATH)
def exp(x):
    x = minimum(real({largest}), maximum(real(-{largest}), x))
    n = floor(x * real({inverse_ln2!r}) + real(0.5))
    z = {reduce_ln2}
    return {E} * whole((whole(n) + whole({bias})) << whole({mantissa})).view(real)


@njit(**MATH)
def atan2(y, x):
    a, b = absolute(x), absolute(y)
    high = maximum(a, b)
    t = minimum(a, b) / (high if high > real(0.0) else real(1.0))
    z = t * t
    angle = t * {A}
    angle = real({half_pi!r}) - angle if b > a else angle
    angle = real({pi!r}) - angle if x < real(0.0) else angle
    return -angle if y < real(0.0) else angle


@njit(**MATH)
def exp2(x):
    x = minimum(real({held}), maximum(real(-{held}), x))
    shifted = x + real({shift!r})
    z = x - (shifted - real({shift!r}))
    return {T} * whole(real(shifted).view(whole) << whole({mantissa})).view(real)


@njit(**MATH)
def tanh_two(x, y):
    a, b = exp2(x), exp2(y)
    c, d = a + real(1.0), b + real(1.0)
    share = real(1.0) / (c * d)
    return (a - real(1.0)) * d * share, (b - real(1.0)) * c * share


@njit(**MATH)
def tanh_pair(p, q):
    a, b = exp2(p + q), exp2(p - q)
    share = real(1.0) / ((a + real(1.0)) * (b + real(1.0)))
    return (a * b - real(1.0)) * share, (a - b) * share


@njit(**MATH)
def maximum(a, b):
    return a if a > b else b


@njit(**MATH)
def minimum(a, b):
    return a if a < b else b


@njit(**MATH)
def where(condition, a, b):
    return a if condition else b
"""


def source(precision: Precision) -> str:
    """Python text of the functions for one precision; expects njit, MATH, real, whole, floor and absolute in scope."""
    s, c, e, a, t = precision.degree
    root = lambda f, at_zero: lambda z: np.where(z > 0, f(np.sqrt(np.where(z > 0, z, 1.0))), at_zero)
    return TEMPLATE.format(
        inverse_pi=1 / pi,
        inverse_ln2=1 / log(2),
        half_pi=pi / 2,
        pi=pi,
        reduce_pi=_reduced(_parts(PI_HIGH, PI_LOW, precision)),
        reduce_ln2=_reduced(_parts(LN2_HIGH, LN2_LOW, precision)),
        S=_horner(root(lambda r: np.sin(r) / r, 1.0), 0.0, (pi / 2) ** 2, s),
        C=_horner(root(np.cos, 1.0), 0.0, (pi / 2) ** 2, c),
        E=_horner(np.exp, -log(2) / 2, log(2) / 2, e),
        A=_horner(root(lambda t: np.arctan(t) / t, 1.0), 0.0, 1.0, a),
        T=_horner(np.exp2, -0.5, 0.5, t),
        largest=precision.largest,
        held=precision.held,
        shift=1.5 * 2.0**precision.mantissa + precision.bias,  # adding it rounds to n, and leaves n + bias in the last bits
        bias=precision.bias,
        mantissa=precision.mantissa,
    )


# pi and ln 2 as the nearest double and the remainder, from their decimal expansions
PI_HIGH, PI_LOW = 3.141592653589793, 1.2246467991473532e-16
LN2_HIGH, LN2_LOW = 0.6931471805599453, 2.3190468138462996e-17


def _parts(high: float, low: float, precision: Precision) -> list[float]:
    """Splits `high + low` into two parts short enough that n times a part is exact, and a remainder."""
    keep = precision.mantissa + 1 - precision.spare
    parts, rest = [], high
    for _ in range(2):
        scale = 2.0 ** (keep - 1 - np.floor(np.log2(rest)))
        parts.append(float(np.floor(rest * scale) / scale))
        rest -= parts[-1]
    return [*parts, float(rest + low)]


def _reduced(parts: list[float]) -> str:
    first, second, third = parts
    return f"((x - n * real({first!r})) - n * real({second!r})) - n * real({third!r})"


def _horner(function, low: float, high: float, degree: int) -> str:
    """Text of the interpolating polynomial in z on [low, high], in Horner's form."""
    coefficients = Chebyshev.interpolate(function, degree, domain=[low, high]).convert(kind=Polynomial).coef
    text = f"real({float(coefficients[-1])!r})"
    for value in coefficients[-2::-1]:
        text = f"({text} * z + real({float(value)!r}))"
    return text
