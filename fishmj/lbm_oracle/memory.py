"""Plain loads and stores. Warp's own indexing folds negative indices and multiplies by strides: seven instructions an access,
a third of all that a lattice update needs on an accelerator. The arrays here are contiguous and the indices never negative.
"""

import warp as wp


@wp.func_native("return values.data[i];")
def peek(values: wp.array(dtype=float), i: int) -> float: ...


@wp.func_native("values.data[i] = value;")
def poke(values: wp.array(dtype=float), i: int, value: float): ...


@wp.func_native("return values.data[i];")
def peek3(values: wp.array(dtype=wp.vec3), i: int) -> wp.vec3: ...


@wp.func_native("values.data[i] = value;")
def poke3(values: wp.array(dtype=wp.vec3), i: int, value: wp.vec3): ...
