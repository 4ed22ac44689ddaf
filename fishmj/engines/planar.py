"""The closed-form planar fish in JAX: batched, jit-able, on CPU and GPU.

A bus tick stores the command in the buffer, samples the flow at every link, and does five physics steps (`planar_chain.step`),
each with the newest command that has arrived.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from fishmj.engines import Copied, FishParams, FishState, Trace, check_commands, swimmer, ticks_per
from fishmj.engines.extensions import Extensions, stacked
from fishmj.engines.planar_columns import columns, initial_carry, pairs
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.mjcf.servos import on_the_bus, targets_of_tick
from fishmj.water.dynamics import planar_chain
from fishmj.water.dynamics.hooks import centres
from fishmj.water.flow import Current, sample
from fishmj.water.residual_step import takes_kernel

kernel = True  # one kernel for the physics of a tick, in a learnt water on an NVIDIA GPU; False: for the learnt force only


def link_centres(xp, ch: planar_chain.Chain, q):
    """World positions of the link centres, (B, N, 2) m, from q (B, nv)."""
    columns = [q[..., i] for i in range(q.shape[-1])]
    return xp.stack([xp.stack(centre, -1) for centre in centres(xp, ch, columns)], -2)


class PlanarEngine(Copied):
    """Closed-form engine. `advance` is pure and may be called inside jit, vmap and scan."""

    jittable = True

    def __init__(self, robot: "Robot | str" = "fish", unroll: int = 1):
        robot = load_robot(robot)
        self.robot, self.chain, self.unroll = robot, planar_chain.chain_of(robot), unroll
        self.arguments = robot, unroll
        self.added = Extensions.of(robot)
        self.steps, self.ticks = ticks_per(robot)
        self.ramp = robot.timing.command_path == "move_time"

    @partial(jax.jit, static_argnums=0)
    def advance(self, state: FishState, commands, params: FishParams, current: Current, tick):
        """Advances B fish by the T bus commands (B, T, J) [rad]; tick (B,) int counts bus ticks since t = 0.

        Returns:
            (FishState, Trace with T ticks).
        """
        check_commands(commands, self.robot.n_joints)
        commands = on_the_bus(self.robot.servo, commands, jnp)
        physics = self._physics_of(state, params, current)

        def one_tick(carry, inputs):
            state, tick = carry
            buffer = jnp.concatenate([state.buffer[:, 1:], inputs[:, None]], 1)
            flow, ambient = sample(jnp, current, link_centres(jnp, self.chain, state.q), tick)
            targets = jnp.stack(targets_of_tick(jnp, buffer, params.delay, self.steps, self.ramp))
            state, power = physics(state._replace(buffer=()), params, targets, flow, ambient)
            q, v = state.q, state.v
            out = Trace(q[:, :3], q[:, 3:] - params.zero, v[:, 3:], v[:, :3], power / self.steps)
            return (state._replace(buffer=buffer), tick + 1), out

        (state, _), trace = lax.scan(one_tick, (state, tick), jnp.swapaxes(commands, 0, 1))
        return state, Trace(*(jnp.swapaxes(a, 0, 1) for a in trace))

    def _physics_of(self, state: FishState, *given):
        """Computes `physics`, for many fish with a learnt force on an NVIDIA GPU by the equivalent kernel."""
        if not kernel or self.added.learnt is None or not takes_kernel(state.attached):
            return self.physics
        if np.dtype(float) in {a.dtype for a in jax.tree.leaves((state, *given))}:
            return self.physics
        from fishmj.engines import planar_kernel

        return partial(planar_kernel.tick, self)

    def physics(self, state: FishState, params: FishParams, targets, flow, ambient):
        """Does the physics steps of one bus tick.

        Args:
            state: without the buffer. targets: (steps, B, J) servo targets, rad. flow: (B, N, 2) m/s. ambient: (B, 2) m/s2.

        Returns:
            (state, sum of the steps' power (B,) W).
        """
        step = partial(self.step, self.added, swimmer(params), columns(params.effects), pairs(flow), columns(ambient))
        # steps use columns, one array for each component; they are converted to rows once a tick
        carry, _ = lax.scan(lambda c, target: (step(c, columns(target)), None), initial_carry(state), targets, unroll=self.unroll)
        q, v, attached, memory, power = carry
        return FishState(jnp.stack(q, -1), jnp.stack(v, -1), attached, (), stacked(jnp, memory, state.memory)), power

    def step(self, added: Extensions, sw: planar_chain.Swimmer, effects, flow, ambient, carry, target):
        """Does one physics step in columns; carry: as from `initial_carry`."""
        q, v, attached, memory, power = carry
        s = planar_chain.step(jnp, self.chain, sw, q, v, attached, target, flow, ambient, added.hooks(jnp, effects, memory))
        like = zip(s.memory, memory, strict=True)
        memory = tuple(jnp.broadcast_to(value, old.shape).astype(old.dtype) for value, old in like)
        return tuple(s.q), tuple(s.v), s.attached, memory, power + s.power
