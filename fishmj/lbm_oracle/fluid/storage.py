"""Plain loads and stores of populations in single or half precision, and of velocities; vectors and matrices in flat arrays.

Warp's own indexing folds negative indices and multiplies by strides: seven instructions an access, a third of all that a
lattice update needs on an accelerator. The arrays here are contiguous and the indices never negative.

Half precision stores 2^15 (f - w): values of 1e-6 to 1 keep their eleven bits, where unscaled they would lose them below 6e-5
(Lehmann et al. 2022, Phys. Rev. E 106:015308). The arithmetic stays in single precision.
"""

import warp as wp

STORAGE = {"float32": wp.float32, "float16": wp.float16}


@wp.func_native("return values.data[i];")
def peek(values: wp.array(dtype=wp.float32), i: int) -> wp.float32: ...


@wp.func_native("return wp::float32(values.data[i]) * 3.0517578125e-05f;")
def peek(values: wp.array(dtype=wp.float16), i: int) -> wp.float32: ...  # noqa: F811  an overload


@wp.func_native("values.data[i] = value;")
def poke(values: wp.array(dtype=wp.float32), i: int, value: wp.float32): ...


@wp.func_native("values.data[i] = wp::float16(value * 32768.0f);")
def poke(values: wp.array(dtype=wp.float16), i: int, value: wp.float32): ...  # noqa: F811


@wp.func_native("return values.data[i];")
def peek3(values: wp.array(dtype=wp.vec3), i: int) -> wp.vec3: ...


@wp.func_native("values.data[i] = value;")
def poke3(values: wp.array(dtype=wp.vec3), i: int, value: wp.vec3): ...


@wp.func
def point3(a: wp.array(dtype=wp.float64), at: int) -> wp.vec3d:
    return wp.vec3d(a[at], a[at + 1], a[at + 2])


@wp.func
def matrix3(a: wp.array(dtype=wp.float64), at: int) -> wp.mat33d:
    return wp.mat33d(a[at], a[at + 1], a[at + 2], a[at + 3], a[at + 4], a[at + 5], a[at + 6], a[at + 7], a[at + 8])
