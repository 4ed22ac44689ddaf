"""The body's part of steps without the host: its equation, its motion, the water inside it.

    load_state         data from the host -> state; only the commands if the device keeps its own state        once
    move_body          v+ -> state -> pose, box, fastest corner                                                 a step
    assemble_equation  M + dt D and right-hand side                                                             a step
    return_state       state, torques, rates, wrenches -> the host's memory, and last the number of the run     once

Each is one block of threads, a thread for each link and each degree of freedom; one thread on the CPU. The formulas are those of
`articulated_body.py` (M, bias, servos) and of `link_dynamics.py` (the water inside the links).
"""

from typing import Any

import numpy as np
import warp as wp

from fishmj.lbm_oracle.fluid.storage import matrix3, point3
from fishmj.lbm_oracle.immersed.articulated_body import (
    FREE,
    Motion,
    Tree,
    inertia_about,
    move_joint,
    place_body,
    screw_product,
    weigh_body,
)
from fishmj.lbm_oracle.immersed.fsi_solve import wait_for_block
from fishmj.lbm_oracle.immersed.kernels import CouplingArrays
from fishmj.lbm_oracle.immersed.link_dynamics import FOLLOWS, layer_momentum, store_vec3

wp.set_module_options({"enable_backward": False, "max_unroll": 4})  # unrolled further it takes long to compile


@wp.struct
class InteriorWater:
    """Water inside L links, and boxes round their markers; float64, SI."""

    dt: wp.float64
    counts_gain: int  # 1 if its gain pushes the links
    mass: wp.array(dtype=wp.float64)  # L
    centre: wp.array(dtype=wp.float64)  # 3 L, in the link's frame
    inertia: wp.array(dtype=wp.float64)  # 9 L
    has_layers: int  # 1 if there are layers of water on sheets
    layers: wp.array(dtype=wp.float64)  # 36 L, their inertia, by rows
    weight: wp.array(dtype=wp.float64)  # 6 L, dt m g
    measured_speed: wp.array(dtype=wp.float64)  # L, speed along the link as this step measures it
    speed: wp.array(dtype=wp.float64)  # L, as the step before measured it; nan: it moves as the link does
    last_momentum: wp.array(dtype=wp.float64)  # 6 L, momentum at the start of the step before
    layer_momentum: wp.array(dtype=wp.float64)  # 6 L, of the layers
    total_gain: wp.array(dtype=wp.float64)  # 6 L, what it gained in all steps
    push: wp.array(dtype=wp.float64)  # 6 L, moment about the first link's frame and force times dt
    applied: wp.array(dtype=wp.float64)  # n
    corner: wp.array(dtype=wp.float64)  # 24 L, of the boxes
    link_boxes: wp.array(dtype=wp.float64)  # 7 L, low, high, and square of the greatest speed, of each link
    fastest: wp.array(dtype=wp.float64)  # 1, of all steps
    dx: wp.float64
    grid: wp.vec3d  # corner of the grid
    size: wp.vec3d  # cells of the scratch box


_TOUCH = """
int seen = 0;
#if defined(__CUDA_ARCH__)
for (int i = {step} * me; i < values.shape[0]; i += {step} * threads) seen ^= ((const int*)(values.data + i))[0];
#endif
return seen;
"""


@wp.func_native(_TOUCH.format(step=4))  # a cache sector of 32 bytes
def touch(values: wp.array(dtype=wp.float64), me: int, threads: int) -> int:
    """Loads one double of each cache sector, so that all sectors are fetched at once.

    Returns a value that depends on the loads.
    """
    ...


@wp.func_native(_TOUCH.format(step=8))
def touch(values: wp.array(dtype=wp.int32), me: int, threads: int) -> int:  # noqa: F811  an overload
    """Loads one integer of each cache sector, so that all sectors are fetched at once.

    Returns a value that depends on the loads.
    """
    ...


@wp.func_native("if (seen == 0x5bd1e995 && values.shape[0] < 0) values.data[0] = 0.0;")  # never; a load without a use is left out
def use(seen: int, values: wp.array(dtype=wp.float64)):
    """Uses the result of `touch` without an effect; the compiler removes a load whose result is not used."""
    ...


@wp.func
def touch_all(
    integers: wp.array(dtype=int),
    reals: wp.array(dtype=wp.float64),
    state: wp.array(dtype=wp.float64),
    block: wp.array(dtype=wp.float64),
    me: int,
    threads: int,
):
    """Loads all later inputs at once: while the water steps, one load after another is slow."""
    a, b = touch(integers, me, threads), touch(reals, me, threads)
    use(a ^ b ^ touch(state, me, threads) ^ touch(block, me, threads), state)


@wp.func
def twist_of(t: Tree, s: Motion, l: int):
    """Angular velocity of link l, and velocity of its point at the first link's frame."""
    w, u = wp.vec3d(), wp.vec3d()
    for d in range(t.dofs):
        speed = t.reach[l * t.dofs + d] * s.qvel[d]
        w += speed * point3(s.screw, 6 * d)
        u += speed * point3(s.screw, 6 * d + 3)
    return w, u


@wp.func
def gain_of_interior(t: Tree, s: Motion, e: InteriorWater, l: int):
    """Writes the momentum that the water inside link l gained since the previous step, and its buoyancy over this step."""
    w, u = twist_of(t, s, l)
    turn = matrix3(s.pose, 12 * l + 3)
    p = point3(s.pose, 12 * l) - point3(s.pose, 0) + turn * point3(e.centre, 3 * l)
    u += wp.cross(w, p)
    sheet, turning = wp.vec3d(), wp.vec3d()
    if e.has_layers == 1:
        sheet, turning = layer_momentum(e.layers, 36 * l, turn, u, w)
        sheet = wp.float64(FOLLOWS) * (sheet - point3(e.layer_momentum, 6 * l))
        turning = wp.float64(FOLLOWS) * (turning - point3(e.layer_momentum, 6 * l + 3))
        store_vec3(e.layer_momentum, 6 * l, point3(e.layer_momentum, 6 * l) + sheet)
        store_vec3(e.layer_momentum, 6 * l + 3, point3(e.layer_momentum, 6 * l + 3) + turning)
    if e.speed[l] == e.speed[l]:  # not nan
        along = wp.vec3d(turn[0, 0], turn[1, 0], turn[2, 0])
        u += (e.speed[l] - wp.dot(along, u)) * along
    linear, angular = e.mass[l] * u, inertia_about(turn, matrix3(e.inertia, 9 * l)) * w
    gained, spun = linear - point3(e.last_momentum, 6 * l), angular - point3(e.last_momentum, 6 * l + 3)
    store_vec3(e.last_momentum, 6 * l, linear)
    store_vec3(e.last_momentum, 6 * l + 3, angular)
    if e.has_layers == 1:
        gained += sheet
        spun += turning
    if e.counts_gain == 0:
        gained, spun = wp.vec3d(), wp.vec3d()
    store_vec3(e.total_gain, 6 * l, point3(e.total_gain, 6 * l) + gained)
    store_vec3(e.total_gain, 6 * l + 3, point3(e.total_gain, 6 * l + 3) + spun)
    gained -= point3(e.weight, 6 * l)
    store_vec3(e.push, 6 * l, wp.cross(p, gained) + spun)
    store_vec3(e.push, 6 * l + 3, gained)


@wp.func
def write_equation(
    t: Tree,
    s: Motion,
    e: InteriorWater,
    block: wp.array(dtype=wp.float64),
    at: CouplingArrays,
    rate: wp.array(dtype=wp.float64),
    me: int,
    threads: int,
):
    """Writes M + dt D, the right-hand side and the velocity into the block that the solve reads."""
    n = t.dofs
    weigh_body(t, s, me, threads)
    l = int(me)
    while l < t.links:
        gain_of_interior(t, s, e, l)
        l += threads
    wait_for_block()
    i = int(me)
    while i < n:
        rate[i] = s.qvel[i]
        block[at.before + i] = s.qvel[i]
        right = e.dt * (s.passive[i] + s.actuator[i] - s.bias[i] + e.applied[i])
        for k in range(t.links):
            right += t.reach[k * n + i] * screw_product(s.screw, i, e.push, k)
        for j in range(n):
            entry = s.mass_matrix[n * i + j] + wp.where(i == j, e.dt * t.damping[i], wp.float64(0.0))
            block[at.system + n * i + j] = entry
            right += entry * s.qvel[j]
        block[at.momentum + i] = right
        i += threads


@wp.kernel
def assemble_equation(
    t: Tree,
    s: Motion,
    e: InteriorWater,
    block: wp.array(dtype=wp.float64),
    at: CouplingArrays,
    rate: wp.array(dtype=wp.float64),
    integers: wp.array(dtype=int),
    reals: wp.array(dtype=wp.float64),
    state: wp.array(dtype=wp.float64),
):
    """Assembles the equation of a step."""
    me, threads = wp.tid(), wp.block_dim()
    touch_all(integers, reals, state, block, me, threads)
    write_equation(t, s, e, block, at, rate, me, threads)


@wp.func
def store_interior_speed(s: Motion, e: InteriorWater, l: int):
    """Stores the measured speed of the water along the link; the first value is a state, not a gain."""
    if e.speed[l] != e.speed[l]:
        along = wp.vec3d(s.pose[12 * l + 3], s.pose[12 * l + 6], s.pose[12 * l + 9])
        linear = point3(e.last_momentum, 6 * l)
        store_vec3(e.last_momentum, 6 * l, linear + (e.mass[l] * e.measured_speed[l] - wp.dot(along, linear)) * along)
    e.speed[l] = e.measured_speed[l]


@wp.func
def measure_link_box(t: Tree, s: Motion, e: InteriorWater, l: int):
    """Computes the upright box round link l's markers, and the square of its fastest corner's speed."""
    w, u = twist_of(t, s, l)
    place, turn = point3(s.pose, 12 * l), matrix3(s.pose, 12 * l + 3)
    far, fast = wp.float64(wp.inf), wp.float64(0.0)
    low, high = wp.vec3d(far, far, far), wp.vec3d(-far, -far, -far)
    for k in range(8):
        x = place + turn * point3(e.corner, 24 * l + 3 * k)
        low, high = wp.min(low, x), wp.max(high, x)
        v = u + wp.cross(w, x - point3(s.pose, 0))
        fast = wp.max(fast, wp.dot(v, v))
    store_vec3(e.link_boxes, 7 * l, low)
    store_vec3(e.link_boxes, 7 * l + 3, high)
    e.link_boxes[7 * l + 6] = fast


@wp.func
def set_box(
    t: Tree,
    s: Motion,
    e: InteriorWater,
    block: wp.array(dtype=wp.float64),
    at: CouplingArrays,
    me: int,
    threads: int,
):
    """Writes the box of cells round the body into the block that the markers read."""
    l = int(me)
    while l < t.links:
        measure_link_box(t, s, e, l)
        l += threads
    wait_for_block()
    a = int(me)
    while a < 3:
        low, high = wp.float64(wp.inf), -wp.float64(wp.inf)
        for k in range(t.links):
            low, high = wp.min(low, e.link_boxes[7 * k + a]), wp.max(high, e.link_boxes[7 * k + 3 + a])
        middle = wp.float64(0.5) * (low + high)
        block[at.box + a] = wp.rint((middle - e.grid[a]) / e.dx - wp.float64(0.5) * e.size[a])
        a += threads


@wp.kernel
def load_state(
    t: Tree,
    at: CouplingArrays,
    block: wp.array(dtype=wp.float64),
    sent_block: wp.array(dtype=wp.float64),
    state: wp.array(dtype=wp.float64),
    sent_state: wp.array(dtype=wp.float64),
    wrench: wp.array2d(dtype=wp.float64),
    carried: int,
    sent_count: int,
):
    """Copies the host's data from the host's memory: the state up to number `sent_count`, its last number, and the block.

    With `carried` > 0 the first `carried` numbers of the state, and the block, stay as the previous steps left them. Sums restart
    from zero if the host has read them, or if `carried` > 0.
    """
    me, threads = wp.tid(), wp.block_dim()
    k = int(me) + carried
    while k < sent_count:  # the steps find the others, one of them beside this
        state[k] = sent_state[k]
        k += threads
    if me == 0:
        state[state.shape[0] - 1] = sent_state[state.shape[0] - 1]
    k = int(me)
    while k < at.size and carried == 0:
        block[k] = sent_block[k]
        k += threads
    wait_for_block()
    k = int(me)
    while k < 6 * at.links and (carried > 0 or block[at.reset_wrench] > wp.float64(0.5)):
        wrench[k // 6, k % 6] = wp.float64(0.0)
        k += threads
    j = int(me)
    while j < t.joints and carried > 0:  # as MuJoCo's own state is, which the host would have sent; `state` begins with qpos
        if t.kind[j] == wp.static(FREE):
            q, total = t.coordinate[j] + 3, wp.float64(0.0)
            for i in range(4):
                total += state[q + i] * state[q + i]
            for i in range(4):
                state[q + i] = state[q + i] / wp.sqrt(total)
        j += threads


@wp.kernel
def move_body(
    t: Tree,
    s: Motion,
    e: InteriorWater,
    block: wp.array(dtype=wp.float64),
    at: CouplingArrays,
    v: wp.array(dtype=wp.float64),
    moves: int,
    measured: int,
    next: Motion,
    rate: wp.array(dtype=wp.float64),
    assembles: int,
    integers: wp.array(dtype=int),
    reals: wp.array(dtype=wp.float64),
    state: wp.array(dtype=wp.float64),
):
    """Computes the state after the step (`moves`), its pose and its box of cells.

    `measured` = 0: the interior water moves with the links. `assembles`: also assembles the equation of the `next` step.
    """
    me, threads = wp.tid(), wp.block_dim()
    touch_all(integers, reals, state, block, me, threads)
    l = int(me)
    while l < t.links and moves * measured == 1:
        store_interior_speed(s, e, l)
        l += threads
    wait_for_block()
    j = int(me)
    while j < t.joints and moves == 1:
        move_joint(t, s, j, v, e.dt)
        j += threads
    wait_for_block()
    place_body(t, s, me, threads)
    set_box(t, s, e, block, at, me, threads)
    if me == 0 and moves == 1:
        block[at.reset_wrench] = wp.float64(0.0)
        for k in range(t.links):
            e.fastest[0] = wp.max(e.fastest[0], wp.sqrt(e.link_boxes[7 * k + 6]))
    if assembles == 1:
        wait_for_block()
        write_equation(t, next, e, block, at, rate, me, threads)


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    __threadfence_system();
    __syncthreads();
#endif
""")
def wait_for_host_memory():
    """Waits until the block's writes to the host's memory are visible there."""
    ...


@wp.func_native("*(volatile double*)(values.data + i) = value;")
def write_at_once(values: wp.array(dtype=wp.float64), i: int, value: wp.float64):
    """Writes a number without caching, so that the host sees it."""
    ...


@wp.kernel
def return_state(
    state: wp.array(dtype=wp.float64),
    on_host: wp.array(dtype=wp.float64),
    wrench: wp.array2d(dtype=wp.float64),
):
    """Writes the wrenches and all but the last number of the state to the host; once these are there, the last one.

    The host waits for the last number.
    """
    me, threads, last = wp.tid(), wp.block_dim(), state.shape[0] - 1
    k = int(me)
    while k < last:
        on_host[k] = state[k]
        k += threads
    k = int(me)
    while k < 6 * wrench.shape[0]:
        on_host[last + 1 + k] = wrench[k // 6, k % 6]
        k += threads
    wait_for_host_memory()
    if me == 0:
        write_at_once(on_host, last, state[last])


def pack_arrays(structs: list, kind: type, device: Any) -> wp.array:
    """Packs all arrays of one number type that the structs own into one array, of which they become views; returns it."""
    owned = [(one, name) for one in structs for name in one._cls.vars if _owns(getattr(one, name), kind)]
    places = np.cumsum([0] + [-(-getattr(one, name).size // 8) * 8 for one, name in owned])  # each at the begin of a cache line
    made = wp.zeros(max(int(places[-1]), 1), dtype=kind, device=device)
    for (one, name), start in zip(owned, places, strict=False):
        old = getattr(one, name)
        part = made[int(start) : int(start) + old.size]
        wp.copy(part, old)
        setattr(one, name, part)
    return made


def _owns(value: Any, kind: type) -> bool:
    return isinstance(value, wp.array) and value.dtype is kind and value.size > 0 and value._ref is None
