"""A batch sharded over several devices has the gradient of the batch on one."""

import json
import subprocess
import sys

import jax

from fishmj.hydro_fit.fit.descent import quick

SCRIPT = """
import json
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_num_cpu_devices", 4)
from fishmj.hydro_fit.fit.descent import devices, several, sharded, stacked

rng = np.random.default_rng(0)
x, y = rng.normal(size=(12, 3)), rng.normal(size=12)
loss = lambda net, x, y: jnp.mean((jnp.tanh(x @ net["w"]) + net["b"] - y) ** 2)
net = {"w": rng.normal(size=3), "b": 0.3}
wanted = jax.value_and_grad(loss)(net, x, y)
several()
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

    assert quick("gpu") is None
    monkeypatch.setattr(jax, "jit", unknown)
    assert quick.__wrapped__("cpu") is None
