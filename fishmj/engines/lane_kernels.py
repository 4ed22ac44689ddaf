# ruff: noqa: F821
"""The loops of the compiled engine around the generated physics.

These functions are compiled as text: `numba_build.py` puts a decorator on each and, in front, a header that defines `real` (the
float type), the elementary functions, the straight-line `physics`, `centres` and `forces`, and the names in capitals. The
workspace `w` holds one quantity a row and LANES fish a row, so every loop over `i` becomes vector instructions. `advance`
mirrors `planar.PlanarEngine.advance` and `flow.sample` line by line; tests/test_compiled.py holds them equal.
"""

import numpy as np
from numpy import floor


def workspace():
    """Zeros for all rows, each of which starts with a cache line: a vector across two lines costs twice."""
    w = np.zeros((ROWS + 1) * LANES, real)
    skip = -(w.ctypes.data // w.itemsize) % LANES
    return w[skip : skip + ROWS * LANES]


def load(w, base, values, block):
    """Copies columns of values (B, n) into rows base.. of w; spare lanes of the last block repeat the last fish."""
    last = values.shape[0] - 1
    for j in range(values.shape[1]):
        for i in range(LANES):
            w[(base + j) * LANES + i] = values[min(block + i, last), j]


def store(values, w, base, block):
    """Copies rows base.. of w into the columns of values (B, n)."""
    for i in range(min(LANES, values.shape[0] - block)):
        for j in range(values.shape[1]):
            values[block + i, j] = w[(base + j) * LANES + i]


def load_fish(w, state, swimmer, block):
    """Loads the block's fish: states that change as they swim, and the constants of each."""
    q, v, attached, memory = state
    mass, kp, kv, kb, zero, water, effects = swimmer
    load(w, Q, q, block)
    load(w, V, v, block)
    load(w, ATTACHED, attached, block)
    load(w, MEMORY, memory, block)
    load(w, MASS, mass, block)
    load(w, KP, kp, block)
    load(w, KV, kv, block)
    load(w, KB, kb, block)
    load(w, ZERO, zero, block)
    load(w, WATER, water, block)
    load(w, EFFECTS, effects, block)


def load_current(w, current, clock, block):
    """Loads the background flow of the block's fish, and their bus tick."""
    mean, rms, row, offset, turn = current
    load(w, MEAN, mean, block)
    load(w, RMS, rms, block)
    load(w, SLICE, row, block)
    load(w, OFFSET, offset, block)
    load(w, TURN, turn, block)
    load(w, CLOCK, clock, block)


def load_delay(w, places, delay, block):
    """Computes the command latency: physics steps beyond whole bus ticks, and the places of the newest three commands in the
    line.

    At tick k a lane sees line[places + k JOINTS LANES]: the command that arrives now, the one before, and one more.
    """
    # latencies differ from lane to lane. Offsets into the line of commands, found once, keep a branch a lane out of the ticks
    for i in range(LANES):
        steps = delay[min(block + i, delay.shape[0] - 1), 0]
        w[PART * LANES + i] = real(steps % STEPS)
        for age in range(3):
            places[age * LANES + i] = (1 + max(BUFFER - 1 - steps // STEPS - age, 0)) * JOINTS * LANES + i


def load_commands(line, buffer, commands, block):
    """Writes bus commands in order of time, remembered then new, as the servo sees them: clamped and quantised."""
    ticks = commands.shape[1]
    for i in range(LANES):
        b = min(block + i, buffer.shape[0] - 1)
        for k in range(BUFFER):
            for j in range(JOINTS):
                line[(k * JOINTS + j) * LANES + i] = buffer[b, k, j]
        for k in range(ticks):
            for j in range(JOINTS):
                clamped = minimum(maximum(commands[b, k, j], -RANGE), RANGE)
                line[((BUFFER + k) * JOINTS + j) * LANES + i] = np.rint(clamped / RESOLUTION) * RESOLUTION


def store_commands(buffer, line, ticks, block):
    """Stores the newest BUFFER commands."""
    for i in range(min(LANES, buffer.shape[0] - block)):
        for k in range(BUFFER):
            for j in range(JOINTS):
                buffer[block + i, k, j] = line[((ticks + k) * JOINTS + j) * LANES + i]


def pick_commands(w, line, places, k):
    """Picks the three commands that matter in tick k, newest first, for each lane's latency."""
    for age in range(3):
        for j in range(JOINTS):
            for i in range(LANES):
                w[(RECENT + age * JOINTS + j) * LANES + i] = line[places[age * LANES + i] + (k * JOINTS + j) * LANES]


def aim(w, step):
    """Computes servo targets at one physics step of a tick; with RAMP the servo moves from command to command in one tick."""
    for j in range(JOINTS):
        for i in range(LANES):
            newest, previous = w[(RECENT + j) * LANES + i], w[(RECENT + JOINTS + j) * LANES + i]
            before = w[(RECENT + 2 * JOINTS + j) * LANES + i]
            late = real(step) - w[PART * LANES + i]
            fresh = late >= real(0.0)
            target = where(fresh, newest, previous)
            if RAMP:
                origin = where(fresh, previous, before)
                share = (where(fresh, late, late + real(STEPS)) + real(1.0)) / real(STEPS)
                target = origin + share * (target - origin)
            w[(TARGET + j) * LANES + i] = target


def grid(w, cells, cell):
    """Computes cell (0..cells-1, 0 for NaN) and position within it of every link centre in the drifting table."""
    size = real(cells)
    for link in range(LINKS):
        for i in range(LANES):
            cos, sin = w[TURN * LANES + i], w[(TURN + 1) * LANES + i]
            time = w[CLOCK * LANES + i] * TICK
            x = w[(CENTRE + 2 * link) * LANES + i] - w[MEAN * LANES + i] * time
            y = w[(CENTRE + 2 * link + 1) * LANES + i] - w[(MEAN + 1) * LANES + i] * time
            gx = (cos * x + sin * y) / cell + w[OFFSET * LANES + i]
            gy = (cos * y - sin * x) / cell + w[(OFFSET + 1) * LANES + i]
            fx, fy = floor(gx), floor(gy)
            # floor instead of %: an integer remainder has no vector instruction
            ix, iy = fx - size * floor(fx / size), fy - size * floor(fy / size)
            w[(PLACE + 4 * link) * LANES + i] = where(ix < size, maximum(ix, real(0.0)), real(0.0))
            w[(PLACE + 4 * link + 1) * LANES + i] = where(iy < size, maximum(iy, real(0.0)), real(0.0))
            w[(PLACE + 4 * link + 2) * LANES + i] = gx - fx
            w[(PLACE + 4 * link + 3) * LANES + i] = gy - fy


def spatial_flow(w, table, cells):
    """Frozen turbulence at the link centres: bilinear in the periodic table (S, cells, cells, 2), flat."""
    for link in range(LINKS):
        flow, place = (FLOW + 2 * link) * LANES, (PLACE + 4 * link) * LANES
        for i in range(LANES):
            ix, iy, ax, ay = w[place + i], w[place + LANES + i], w[place + 2 * LANES + i], w[place + 3 * LANES + i]
            ahead = 2 * cells * (1 if ix + real(1.0) < real(cells) else 1 - cells)
            right = 2 * (1 if iy + real(1.0) < real(cells) else 1 - cells)
            a = 2 * ((int(w[SLICE * LANES + i]) * cells + int(ix)) * cells + int(iy))
            b, c, d = a + right, a + ahead, a + ahead + right
            u, v = table[a] + ay * (table[b] - table[a]), table[a + 1] + ay * (table[b + 1] - table[a + 1])
            w[flow + i] = u + ax * (table[c] + ay * (table[d] - table[c]) - u)
            w[flow + LANES + i] = v + ax * (table[c + 1] + ay * (table[d + 1] - table[c + 1]) - v)
    # a loop of its own: the one before gathers from the table, which prevents vector instructions; this one has only arithmetic
    for link in range(LINKS):
        flow = (FLOW + 2 * link) * LANES
        for i in range(LANES):
            u, v, rms = w[flow + i], w[flow + LANES + i], w[RMS * LANES + i]
            cos, sin = w[TURN * LANES + i], w[(TURN + 1) * LANES + i]
            w[flow + i] = w[MEAN * LANES + i] + rms * (cos * u - sin * v)
            w[flow + LANES + i] = w[(MEAN + 1) * LANES + i] + rms * (sin * u + cos * v)
    for i in range(LANES):
        w[AMBIENT * LANES + i] = w[(AMBIENT + 1) * LANES + i] = real(0.0)


def gust_flow(w, table, cells):
    """Gusts, uniform in space: the row of the table (S, cells, 2), flat, at this tick, and the slope to the next."""
    for i in range(LANES):
        cos, sin, rms = w[TURN * LANES + i], w[(TURN + 1) * LANES + i], w[RMS * LANES + i]
        start = int(w[SLICE * LANES + i]) * cells
        now = (int(w[CLOCK * LANES + i]) + int(w[OFFSET * LANES + i])) % cells
        here, ahead = 2 * (start + now), 2 * (start + (now + 1) % cells)
        u, v = table[here], table[here + 1]
        du, dv = table[ahead] - u, table[ahead + 1] - v
        w[AMBIENT * LANES + i] = rms * (cos * du - sin * dv) / TICK
        w[(AMBIENT + 1) * LANES + i] = rms * (sin * du + cos * dv) / TICK
        for link in range(LINKS):
            w[(FLOW + 2 * link) * LANES + i] = w[MEAN * LANES + i] + rms * (cos * u - sin * v)
            w[(FLOW + 2 * link + 1) * LANES + i] = w[(MEAN + 1) * LANES + i] + rms * (sin * u + cos * v)


def find_flow(w, table, cells, cell, gust):
    """Computes the water velocity at every link, and DU/Dt, at this tick."""
    if gust:
        gust_flow(w, table, cells)
    else:
        centres(w)
        grid(w, cells, cell)
        spatial_flow(w, table, cells)


def record(w, k, block, pose, joint, rate, velocity, power):
    """Records tick k of the trace."""
    for i in range(min(LANES, pose.shape[0] - block)):
        b = block + i
        for j in range(3):
            pose[b, k, j] = w[(Q + j) * LANES + i]
            velocity[b, k, j] = w[(V + j) * LANES + i]
        for j in range(JOINTS):
            joint[b, k, j] = w[(Q + 3 + j) * LANES + i] - w[(ZERO + j) * LANES + i]
            rate[b, k, j] = w[(V + 3 + j) * LANES + i]
        power[b, k] = w[POWER * LANES + i] / real(STEPS)


def advance(first, stop, c, state, buffer, commands, swimmer, delay, current, clock, table, cells, cell, gust, trace):
    """Advances fish first..stop (first a multiple of LANES) by commands.shape[1] bus ticks, in place."""
    # one small workspace, reused for every block: it stays in the cache for all ticks of a block
    w, ticks = workspace(), commands.shape[1]
    line = np.empty((BUFFER + ticks) * JOINTS * LANES, real)
    places = np.empty(3 * LANES, np.int64)
    q, v, attached, memory = state
    pose, joint, rate, velocity, power = trace
    for block in range(first, stop, LANES):
        load_fish(w, state, swimmer, block)
        load_current(w, current, clock, block)
        load_delay(w, places, delay, block)
        load_commands(line, buffer, commands, block)
        for k in range(ticks):
            pick_commands(w, line, places, k)
            find_flow(w, table, cells, cell, gust)
            for i in range(LANES):
                w[CLOCK * LANES + i] += real(1.0)
                w[POWER * LANES + i] = real(0.0)
            for step in range(STEPS):
                aim(w, step)
                ask(w, c)
                physics(w, c)
            record(w, k, block, pose, joint, rate, velocity, power)
        store(q, w, Q, block)
        store(v, w, V, block)
        store(attached, w, ATTACHED, block)
        store(memory, w, MEMORY, block)
        store_commands(buffer, line, ticks, block)


def evaluate(first, stop, c, state, swimmer, target, flow, ambient, out):
    """Computes applied force, new attachment and power of one physics step of fish first..stop, into `out`."""
    w = workspace()
    applied, attached_new, power, memory_new = out
    for block in range(first, stop, LANES):
        load_fish(w, state, swimmer, block)
        load(w, TARGET, target, block)
        load(w, FLOW, flow, block)
        load(w, AMBIENT, ambient, block)
        ask(w, c)
        forces(w, c)
        store(applied, w, APPLIED, block)
        store(attached_new, w, ATTACHED, block)
        store(power, w, POWER, block)
        store(memory_new, w, MEMORY, block)


def look(first, stop, q, current, clock, table, cells, cell, gust, out):
    """Computes the water velocity at the links of fish first..stop and DU/Dt at one bus tick, into `out`."""
    w = workspace()
    flow, ambient = out
    for block in range(first, stop, LANES):
        load(w, Q, q, block)
        load_current(w, current, clock, block)
        find_flow(w, table, cells, cell, gust)
        store(flow, w, FLOW, block)
        store(ambient, w, AMBIENT, block)
