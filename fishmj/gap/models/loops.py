# ruff: noqa: F821
"""The loops around a model's generated step, compiled as text by `kernel.py`, which defines the names in capitals.

The workspace `w` holds one quantity a row and LANES rollouts a row, so the generated code becomes vector instructions.
"""

import numpy as np


def load(w, base, values, block):
    """Columns of values (R, n) into rows base.. of w; spare lanes of the last block repeat the last row."""
    last = values.shape[0] - 1
    for j in range(values.shape[1]):
        for i in range(LANES):
            w[(base + j) * LANES + i] = values[min(block + i, last), j]


def feed(w, which, inputs, lengths, delay, block, k):
    """Commands that reach each lane's servo at step k."""
    last = which.shape[0] - 1
    for i in range(LANES):
        r = min(block + i, last)
        log = which[r]
        place = max(real(k) - delay[r], real(0.0))
        before = int(place)
        share = place - real(before)
        before = min(before, lengths[log] - 1)
        after = min(before + 1, lengths[log] - 1)
        for j in range(INPUTS):
            a, b = inputs[log, before, j], inputs[log, after, j]
            w[(INPUT + j) * LANES + i] = a + share * (b - a)


def watch(out, w, k, block):
    """Sample k of every lane."""
    for i in range(min(LANES, out.shape[0] - block)):
        for j in range(WATCHED):
            out[block + i, k, j] = w[(WATCH + j) * LANES + i]


def roll(first, stop, which, inputs, lengths, parameters, start, delay, stride, out):
    """Rollouts first..stop (first a multiple of LANES), each as long as `out` has room for."""
    w = np.zeros(ROWS * LANES, real)
    for block in range(first, stop, LANES):
        load(w, PARAMETER, parameters, block)
        load(w, STATE, start, block)
        longest = 0
        for i in range(min(LANES, which.shape[0] - block)):
            longest = max(longest, lengths[which[block + i]])
        look(w)
        watch(out, w, 0, block)
        for k in range(min((longest // stride + 1) * stride, (out.shape[1] - 1) * stride)):
            feed(w, which, inputs, lengths, delay, block, k)
            physics(w)
            if (k + 1) % stride == 0:
                look(w)
                watch(out, w, (k + 1) // stride, block)
