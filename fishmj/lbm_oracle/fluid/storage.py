"""Plain loads and stores of populations in single or half precision, and of velocities; vectors and matrices in flat arrays.

Warp's own indexing folds negative indices and multiplies by strides: seven instructions for each access, a third of all
instructions of a lattice update on an accelerator. The arrays here are contiguous and the indices are never negative.

Half precision stores 2^15 (f - w): values of 1e-6 to 1 keep their eleven bits, where unscaled they would lose them below 6e-5
(Lehmann et al. 2022, Phys. Rev. E 106:015308). The arithmetic stays in single precision.

With an eddy viscosity only it and the hybrid stress read the velocity, which is stored as three integers of 16 bits, the nearest
to 2^16 u: six bytes in place of twelve. The resolution is 1.5e-5 cells a step and the range half a cell a step, far beyond the
speed at which a run is stopped; differences of two are exact. Without an eddy viscosity only the user reads it: it is a float.
"""

import numpy as np
import warp as wp

from fishmj.lbm_oracle.fluid.in_kernels import vec6i

STORAGE = {"float32": wp.float32, "float16": wp.float16}
VELOCITIES = (wp.vec3, wp.vec3s)
UNIT = 2.0**-16  # of a velocity of 16 bits, cells a step
GREATEST = 32767


def velocity_type(subgrid: bool) -> type:
    """Storage type of velocities."""
    return VELOCITIES[subgrid]


def encoded(u: np.ndarray, kind: type) -> np.ndarray:
    """Velocities (..., 3) in cells a step, as an array of this type stores them."""
    return np.clip(np.rint(u / UNIT), -GREATEST, GREATEST).astype(np.int16) if kind is wp.vec3s else u.astype(np.float32)


def decoded(u: np.ndarray) -> np.ndarray:
    """Stored velocities (..., 3) as float32, cells a step."""
    return u * np.float32(UNIT) if u.dtype == np.int16 else u


@wp.func_native("return values.data[i];")
def peek(values: wp.array(dtype=wp.float32), i: int) -> wp.float32:
    """Loads a population in single precision."""
    ...


@wp.func_native("return wp::float32(values.data[i]) * 3.0517578125e-05f;")
def peek(values: wp.array(dtype=wp.float16), i: int) -> wp.float32:  # noqa: F811  an overload
    """Loads a population that is stored in half precision, scaled by 2^15."""
    ...


@wp.func_native("values.data[i] = value;")
def poke(values: wp.array(dtype=wp.float32), i: int, value: wp.float32):
    """Stores a population in single precision."""
    ...


@wp.func_native("values.data[i] = wp::float16(value * 32768.0f);")
def poke(values: wp.array(dtype=wp.float16), i: int, value: wp.float32):  # noqa: F811
    """Stores a population in half precision, scaled by 2^15."""
    ...


@wp.func_native("return values.data[i];")
def peek3(values: wp.array(dtype=wp.vec3), i: int) -> wp.vec3:
    """Loads a velocity, cells a step."""
    ...


@wp.func_native("""const auto& v = values.data[i];
    const float unit = 1.52587890625e-05f;
    return wp::vec3(v[0] * unit, v[1] * unit, v[2] * unit);""")
def peek3(values: wp.array(dtype=wp.vec3s), i: int) -> wp.vec3:  # noqa: F811
    """Loads a velocity that is stored as three integers of 16 bits, cells a step."""
    ...


@wp.func_native("values.data[i] = value;")
def poke3(values: wp.array(dtype=wp.vec3), i: int, value: wp.vec3):
    """Stores a velocity, cells a step."""
    ...


# 2^16 u rounded to the nearest integer, ties to even: added to 1.5 x 2^23 it stands in the low bits of a float on every machine
_INTEGER = """float w = 65536.0f * {value};
        w = w > 32767.0f ? 32767.0f : w;
        w = w < -32767.0f ? -32767.0f : w;
        union {{ float number; int bits; }} sum;
        sum.number = w + 12582912.0f;
        {kept} = (short)sum.bits;"""


def _three(value: str, kept: str) -> str:
    """Native text that stores three components, `k` in both arguments."""
    return f"for (int k = 0; k < 3; ++k) {{ {_INTEGER.format(value=value, kept=kept)} }}"


@wp.func_native(_three("value[k]", "values.data[i][k]"))
def poke3(values: wp.array(dtype=wp.vec3s), i: int, value: wp.vec3):  # noqa: F811
    """Stores a velocity in cells a step as three integers of 16 bits."""
    ...


# two neighbours at once, the first at an even place: one load or store of twice the width on an accelerator (pairs.py)

mat23 = wp.types.matrix(shape=(2, 3), dtype=wp.float32)


def _for(accelerator: str, cpu: str) -> str:
    """Text of a native function that differs on an accelerator."""
    return f"#if defined(__CUDA_ARCH__)\n{accelerator}\n#else\n{cpu}\n#endif\n"


@wp.func_native(
    _for(
        "float2 v = *(const float2*)(values.data + i); return wp::vec2(v.x, v.y);",
        "return wp::vec2(values.data[i], values.data[i + 1]);",
    )
)
def peek_pair(values: wp.array(dtype=wp.float32), i: int) -> wp.vec2:
    """Loads two neighbouring populations in single precision; i is even."""
    ...


@wp.func_native(
    _for(
        """unsigned int v = *(const unsigned int*)(values.data + i);
        float a, b;
        asm("{.reg .f16 low, high; mov.b32 {low, high}, %2; cvt.f32.f16 %0, low; cvt.f32.f16 %1, high;}"
            : "=f"(a), "=f"(b) : "r"(v));
        return wp::vec2(a * 3.0517578125e-05f, b * 3.0517578125e-05f);""",
        """return wp::vec2(
            wp::float32(values.data[i]) * 3.0517578125e-05f, wp::float32(values.data[i + 1]) * 3.0517578125e-05f);""",
    )
)
def peek_pair(values: wp.array(dtype=wp.float16), i: int) -> wp.vec2:  # noqa: F811
    """Loads two neighbouring populations in half precision; i is even."""
    ...


@wp.func_native(_for("*(float2*)(values.data + i) = make_float2(a, b);", "values.data[i] = a; values.data[i + 1] = b;"))
def poke_pair(values: wp.array(dtype=wp.float32), i: int, a: wp.float32, b: wp.float32):
    """Stores two neighbouring populations in single precision; i is even."""
    ...


@wp.func_native(
    _for(
        """unsigned int v;
        asm("{.reg .f16 low, high; cvt.rn.f16.f32 low, %1; cvt.rn.f16.f32 high, %2; mov.b32 %0, {low, high};}"
            : "=r"(v) : "f"(a * 32768.0f), "f"(b * 32768.0f));
        *(unsigned int*)(values.data + i) = v;""",
        "values.data[i] = wp::float16(a * 32768.0f); values.data[i + 1] = wp::float16(b * 32768.0f);",
    )
)
def poke_pair(values: wp.array(dtype=wp.float16), i: int, a: wp.float32, b: wp.float32):  # noqa: F811
    """Stores two neighbouring populations in half precision; i is even."""
    ...


@wp.func_native(
    _for(
        """const float2* w = (const float2*)(values.data + i);
        float2 a = w[0], b = w[1], c = w[2];
        wp::mat_t<2, 3, wp::float32> r;
        r.data[0][0] = a.x; r.data[0][1] = a.y; r.data[0][2] = b.x; r.data[1][0] = b.y; r.data[1][1] = c.x; r.data[1][2] = c.y;
        return r;""",
        """wp::mat_t<2, 3, wp::float32> r;
        for (int k = 0; k < 3; ++k) { r.data[0][k] = values.data[i][k]; r.data[1][k] = values.data[i + 1][k]; }
        return r;""",
    )
)
def peek3_pair(values: wp.array(dtype=wp.vec3), i: int) -> mat23:
    """Loads two neighbouring velocities as the rows of a matrix; i is even."""
    ...


@wp.func_native(
    _for(
        """const unsigned int* w = (const unsigned int*)(values.data + i);
        unsigned int a = w[0], b = w[1], c = w[2];
        wp::mat_t<2, 3, wp::float32> r;
        r.data[0][0] = (short)a; r.data[0][1] = (short)(a >> 16); r.data[0][2] = (short)b;
        r.data[1][0] = (short)(b >> 16); r.data[1][1] = (short)c; r.data[1][2] = (short)(c >> 16);
        for (int n = 0; n < 2; ++n) for (int k = 0; k < 3; ++k) r.data[n][k] *= 1.52587890625e-05f;
        return r;""",
        """wp::mat_t<2, 3, wp::float32> r;
        for (int n = 0; n < 2; ++n) for (int k = 0; k < 3; ++k) r.data[n][k] = values.data[i + n][k] * 1.52587890625e-05f;
        return r;""",
    )
)
def peek3_pair(values: wp.array(dtype=wp.vec3s), i: int) -> mat23:  # noqa: F811
    """Loads two neighbouring velocities of 16-bit integers as the rows of a matrix; i is even."""
    ...


@wp.func_native(
    _for(
        """float2* w = (float2*)(values.data + i);
        w[0] = make_float2(a[0], a[1]); w[1] = make_float2(a[2], b[0]); w[2] = make_float2(b[1], b[2]);""",
        "values.data[i] = a; values.data[i + 1] = b;",
    )
)
def poke3_pair(values: wp.array(dtype=wp.vec3), i: int, a: wp.vec3, b: wp.vec3):
    """Stores two neighbouring velocities; i is even."""
    ...


@wp.func_native(
    f"short r[6]; {_three('a[k]', 'r[k]')} {_three('b[k]', 'r[3 + k]')}"
    + "\n"
    + _for(
        """unsigned int* w = (unsigned int*)(values.data + i);
        for (int k = 0; k < 3; ++k) w[k] = (unsigned int)(unsigned short)r[2 * k] | (unsigned int)r[2 * k + 1] << 16;""",
        "for (int k = 0; k < 3; ++k) { values.data[i][k] = r[k]; values.data[i + 1][k] = r[3 + k]; }",
    )
)
def poke3_pair(values: wp.array(dtype=wp.vec3s), i: int, a: wp.vec3, b: wp.vec3):  # noqa: F811
    """Stores two neighbouring velocities as 16-bit integers; i is even."""
    ...


@wp.func_native(
    _for(
        """int4 a = *(const int4*)values.data;
        int2 b = *(const int2*)(values.data + 4);
        wp::vec_t<6, wp::int32> r;
        r[0] = a.x; r[1] = a.y; r[2] = a.z; r[3] = a.w; r[4] = b.x; r[5] = b.y;
        return r;""",
        "wp::vec_t<6, wp::int32> r; for (int k = 0; k < 6; ++k) r[k] = values.data[k]; return r;",
    )
)
def six(values: wp.array(dtype=int)) -> vec6i:
    """Loads the six integers of a box or an origin."""
    ...


# `end` 1, -1: stores the first or the last of eight numbers, or velocities, that begin at a multiple of eight, and zeros in the
# rest of their sector: an accelerator reads a sector first if it is written in part. `end` 0: stores the number alone


@wp.func_native(
    _for(
        """if (end == 0) { values.data[i] = value; return; }
        float4 rest = make_float4(0.f, 0.f, 0.f, 0.f), own = rest;
        (end > 0 ? own.x : own.w) = value;
        float4* w = (float4*)(values.data + (end > 0 ? i : i - 7));
        w[0] = end > 0 ? own : rest; w[1] = end > 0 ? rest : own;""",
        "values.data[i] = value;",
    )
)
def poke_end(values: wp.array(dtype=wp.float32), i: int, end: int, value: wp.float32):
    """Stores one number at index i; `end` also fills the rest of its sector with zeros (see above)."""
    ...


@wp.func_native(
    _for(
        """if (end == 0) { values.data[i] = value; return; }
        float4 rest = make_float4(0.f, 0.f, 0.f, 0.f);
        float4 own = end > 0 ? make_float4(value[0], value[1], value[2], 0.f) : make_float4(0.f, value[0], value[1], value[2]);
        float4* w = (float4*)((float*)(values.data + i) - (end > 0 ? 0 : 5));
        w[0] = end > 0 ? own : rest; w[1] = end > 0 ? rest : own;""",
        "values.data[i] = value;",
    )
)
def poke_end(values: wp.array(dtype=wp.vec3), i: int, end: int, value: wp.vec3):  # noqa: F811
    """Stores one velocity at index i; `end` also fills the rest of its sector with zeros (see above)."""
    ...


@wp.func
def poke_end(values: wp.array(dtype=wp.vec3s), i: int, end: int, value: wp.vec3):  # noqa: F811  six bytes do not fill a sector
    """Stores one velocity of 16-bit integers; six bytes do not fill a sector, so `end` has no effect."""
    poke3(values, i, value)


# the same with separate base and index, and velocities by component: a compiler vectorises these (rows.py)


@wp.func_native("return (values.data + base)[i];")
def peek_at(values: wp.array(dtype=wp.float32), base: int, i: int) -> wp.float32:
    """Loads the population at base + i in single precision."""
    ...


@wp.func_native("return wp::float32((values.data + base)[i]) * 3.0517578125e-05f;")
def peek_at(values: wp.array(dtype=wp.float16), base: int, i: int) -> wp.float32:  # noqa: F811
    """Loads the population at base + i in half precision."""
    ...


@wp.func_native("(values.data + base)[i] = value;")
def poke_at(values: wp.array(dtype=wp.float32), base: int, i: int, value: wp.float32):
    """Stores the population at base + i in single precision."""
    ...


@wp.func_native("(values.data + base)[i] = wp::float16(value * 32768.0f);")
def poke_at(values: wp.array(dtype=wp.float16), base: int, i: int, value: wp.float32):  # noqa: F811
    """Stores the population at base + i in half precision."""
    ...


@wp.func_native("return ((const float*)(values.data + base))[3 * i + part];")
def peek3_at(values: wp.array(dtype=wp.vec3), base: int, i: int, part: int) -> wp.float32:
    """Loads component `part` of the velocity at base + i, cells a step."""
    ...


@wp.func_native("return ((const short*)(values.data + base))[3 * i + part] * 1.52587890625e-05f;")
def peek3_at(values: wp.array(dtype=wp.vec3s), base: int, i: int, part: int) -> wp.float32:  # noqa: F811
    """Loads component `part` of the velocity of 16-bit integers at base + i, cells a step."""
    ...


@wp.func_native("((float*)(values.data + base))[3 * i + part] = value;")
def poke3_at(values: wp.array(dtype=wp.vec3), base: int, i: int, part: int, value: wp.float32):
    """Stores component `part` of the velocity at base + i, cells a step."""
    ...


@wp.func_native(_INTEGER.format(value="value", kept="((short*)(values.data + base))[3 * i + part]"))
def poke3_at(values: wp.array(dtype=wp.vec3s), base: int, i: int, part: int, value: wp.float32):  # noqa: F811
    """Stores component `part` of the velocity at base + i as a 16-bit integer."""
    ...


CELLS_AT_ONCE = 16  # numbers in a vector register, at most
_LANES = f"typedef float lanes __attribute__((vector_size({4 * CELLS_AT_ONCE}), aligned(4)));"


@wp.func_native(_LANES + "*(lanes*)(target.data + j) = *(const lanes*)(source.data + i);")
def copy_cells(source: wp.array(dtype=wp.float32), i: int, target: wp.array(dtype=wp.float32), j: int):
    """Copies `CELLS_AT_ONCE` populations in single precision on a CPU."""
    ...


@wp.func_native(
    f"for (int k = 0; k < {CELLS_AT_ONCE}; ++k) target.data[j + k] = wp::float32(source.data[i + k]) * 3.0517578125e-05f;"
)
def copy_cells(source: wp.array(dtype=wp.float16), i: int, target: wp.array(dtype=wp.float32), j: int):  # noqa: F811
    """Loads `CELLS_AT_ONCE` populations that are stored in half precision."""
    ...


@wp.func_native(f"for (int k = 0; k < {CELLS_AT_ONCE}; ++k) target.data[j + k] = wp::float16(source.data[i + k] * 32768.0f);")
def copy_cells(source: wp.array(dtype=wp.float32), i: int, target: wp.array(dtype=wp.float16), j: int):  # noqa: F811
    """Stores `CELLS_AT_ONCE` populations in half precision."""
    ...


def _ask(lines: int = 1) -> str:
    """Native text that asks for cache lines to read from `i` on, and to write from `j` on."""
    ask = "__builtin_prefetch((const char*)({0}) + 64 * k, {1});"
    return f"for (int k = 0; k < {lines}; ++k) {{ {ask.format('source.data + i', 0)} {ask.format('target.data + j', 1)} }}"


@wp.func_native(_ask())
def prefetch(source: wp.array(dtype=wp.float32), i: int, target: wp.array(dtype=wp.float32), j: int):
    """Asks a CPU's cache for populations in single precision: from i on to be read, from j on to be written."""
    ...


@wp.func_native(_ask())
def prefetch(source: wp.array(dtype=wp.float16), i: int, target: wp.array(dtype=wp.float16), j: int):  # noqa: F811
    """Asks a CPU's cache for populations in half precision."""
    ...


@wp.func_native(_ask(2))
def prefetch(source: wp.array(dtype=wp.vec3s), i: int, target: wp.array(dtype=wp.vec3s), j: int):  # noqa: F811
    """Asks a CPU's cache for `CELLS_AT_ONCE` velocities of 16-bit integers."""
    ...


@wp.func_native(_ask(3))
def prefetch(source: wp.array(dtype=wp.vec3), i: int, target: wp.array(dtype=wp.vec3), j: int):  # noqa: F811
    """Asks a CPU's cache for `CELLS_AT_ONCE` velocities."""
    ...


# the following avoid Warp's indexing too: the time of code that runs once grows with its number of instructions


@wp.func_native("return wp::vec_t<3, wp::float64>(a.data[at], a.data[at + 1], a.data[at + 2]);")
def point3(a: wp.array(dtype=wp.float64), at: int) -> wp.vec3d:
    """Loads three doubles at offset `at` of a flat array."""
    ...


@wp.func_native("""wp::mat_t<3, 3, wp::float64> m;
for (int i = 0; i < 9; ++i) m.data[i / 3][i % 3] = a.data[at + i];
return m;""")
def matrix3(a: wp.array(dtype=wp.float64), at: int) -> wp.mat33d:
    """Loads a 3 x 3 matrix of doubles, row by row, at offset `at` of a flat array."""
    ...
