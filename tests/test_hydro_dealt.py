"""A batch sharded over several devices has the gradient of the batch on one."""

import json
import subprocess
import sys

import jax
import numpy as np

from fishmj.hydro_fit.fit.training_loop import short_op_compiler_options

SCRIPT = """
import json
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_num_cpu_devices", 4)
from fishmj.hydro_fit.fit.training_loop import devices, sharded, stacked, use_cores_as_devices

rng = np.random.default_rng(0)
x, y = rng.normal(size=(12, 3)), rng.normal(size=12)
loss = lambda net, x, y: jnp.mean((jnp.tanh(x @ net["w"]) + net["b"] - y) ** 2)
net = {"w": rng.normal(size=3), "b": 0.3}
wanted = jax.value_and_grad(loss)(net, x, y)
use_cores_as_devices()
counts = [len(devices(12, 8)), len(devices(12)), len(devices(9, 12)), len(devices(7))]
batches = stacked([(x[k::4], y[k::4]) for k in range(4)])
got = jax.jit(sharded(loss, devices(12, 8)))(net, *batches)
off = jax.tree.map(lambda a, b: float(np.abs(a - b).max()), got, wanted)
print(json.dumps({"counts": counts, "off": max(jax.tree.leaves(off)), "size": float(np.abs(wanted[1]["w"]).max())}))
"""


def test_four_batches_have_the_slope_of_one():
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["counts"] == [4, 4, 3, 1]
    assert found["off"] < 1e-6 < found["size"]


def test_a_compiler_option_that_jax_no_longer_knows_is_left_out(monkeypatch):
    def unknown(fun, compiler_options=None):
        raise jax.errors.JaxRuntimeError(f"INVALID_ARGUMENT: No such compile option: {compiler_options}")

    assert short_op_compiler_options("gpu") is None
    monkeypatch.setattr(jax, "jit", unknown)
    assert short_op_compiler_options.__wrapped__("cpu") is None


SWIM = """
import json, sys
import jax, numpy as np
jax.config.update("jax_num_cpu_devices", int(sys.argv[1]))
from fishmj.water.dynamics import planar_chain
from fishmj.hydro_fit.fit.rollout import FishBatch, SwimWindow
from fishmj.mjcf import load_robot
from fishmj.water.prior import flat

robot, rng, count, ticks = load_robot("fish"), np.random.default_rng(0), 130, 4
ch, fish = planar_chain.chain_of(robot), planar_chain.nominal(robot)
draw = lambda *shape: rng.normal(0.0, 0.3, (count, *shape))
state, target = draw(2, 1, ch.n + 2), draw(ticks, 5, ch.n - 1)
flow, power = (draw(ticks, ch.n, 2), draw(ticks, 2)), draw(ticks)
fleet = FishBatch(state[:, 0], state[:, 1], target, *flow, power, np.ones((count, ticks)), ())
track = SwimWindow(ch, fish).run(fleet, flat(fish.water) * (1.0 + 0.1 * rng.random((count, 1))))
print(json.dumps([len(jax.devices()), *(np.asarray(a).tolist() for a in track[:3])]))
"""


def test_a_batch_swims_alike_on_one_device_and_on_two():
    done = [subprocess.run([sys.executable, "-c", SWIM, n], capture_output=True, text=True, check=True) for n in "12"]
    (one, *alone), (two, *shared) = (json.loads(run.stdout.splitlines()[-1]) for run in done)
    assert (one, two) == (1, 2)
    for a, b in zip(alone, shared, strict=True):
        np.testing.assert_allclose(b, a, rtol=1e-5, atol=1e-5)
        assert np.isfinite(a).all() and len(a) == 130
