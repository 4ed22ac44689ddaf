"""MuJoCo in JAX: batched, jit-able, for GPUs. As in `batch`, MuJoCo moves the fish.

Each physics step the closed form solves (M + M_a + h D) a = f and hands MJX the water's share Q_water - M_a a as
`qfrc_applied`; `mjx.step` applies the servos, solves its own M + h D (Euler, implicit joint damping) and integrates.
Constraints and contacts are off in the model. Masses and gains are model fields mapped over the batch.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax import lax
from mujoco import mjx

from fishmj import mjcf
from fishmj.engines import Copied, FishParams, FishState, Trace, check_commands, swimmer, ticks_per
from fishmj.engines.extensions import Extensions, stacked
from fishmj.engines.planar import link_centres
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.mjcf.servos import on_the_bus, targets_of_tick
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import Current, sample


class MjxEngine(Copied):
    """MJX engine; `advance` is pure and may be called inside jit and scan.

    The float type is JAX's at construction: build and call it inside `jax.enable_x64(True)` for float64.
    """

    jittable = True

    def __init__(self, robot: "Robot | str" = "fish"):
        self.robot = load_robot(robot)
        self.arguments = (self.robot,)
        self.chain, self.added = planar_chain.chain_of(self.robot), Extensions.of(self.robot)
        model = mjcf.build(self.robot, bare=True)
        self.model, self.blank = mjx.put_model(model, impl="jax"), mjx.make_data(model, impl="jax")
        self.steps, self.ticks = ticks_per(self.robot)
        self.ramp = self.robot.timing.command_path == "move_time"

    @partial(jax.jit, static_argnums=0)
    def advance(self, state: FishState, commands, params: FishParams, current: Current, tick):
        """Advances B fish by the T bus commands (B, T, J) [rad]; tick (B,) int counts bus ticks since t = 0.

        Returns:
            (FishState, Trace with T ticks).
        """
        check_commands(commands, self.robot.n_joints)
        fields, sw = self.fields(params), swimmer(params)
        commands = on_the_bus(self.robot.servo, commands, jnp)
        columns = lambda a: [a[:, i] for i in range(a.shape[1])]

        def one_tick(carry, command):
            q, v, attached, buffer, memory, tick = carry
            buffer = jnp.concatenate([buffer[:, 1:], command[:, None]], 1)
            flow, ambient = sample(jnp, current, link_centres(jnp, self.chain, q), tick)
            targets = jnp.stack(targets_of_tick(jnp, buffer, params.delay, self.steps, self.ramp))
            links, ambient = [columns(flow[:, i]) for i in range(self.chain.n)], columns(ambient)

            def one_step(inner, target):
                q, v, attached, memory, power = inner
                hooks = self.added.hooks(jnp, columns(params.effects), columns(memory))
                s = planar_chain.step(
                    jnp, self.chain, sw, columns(q), columns(v), attached, columns(target), links, ambient, hooks
                )
                q, v = self._step(fields, q, v, target, jnp.stack(s.applied, -1))
                return (q, v, s.attached, stacked(jnp, s.memory, memory), power + s.power), None

            start = (q, v, attached, memory, jnp.zeros_like(attached))
            (q, v, attached, memory, power), _ = lax.scan(one_step, start, targets)
            out = Trace(q[:, :3], q[:, 3:] - params.zero, v[:, 3:], v[:, :3], power / self.steps)
            return (q, v, attached, buffer, memory, tick + 1), out

        start = (state.q, state.v, state.attached, state.buffer, state.memory, tick)
        (q, v, attached, buffer, memory, _), trace = lax.scan(one_tick, start, jnp.swapaxes(commands, 0, 1))
        return FishState(q, v, attached, buffer, memory), Trace(*(jnp.swapaxes(a, 0, 1) for a in trace))

    def fields(self, params: FishParams) -> dict:
        """Model fields that differ from fish to fish, batch axis first."""
        m = self.model
        count = params.mass.shape[0]
        mass = jnp.concatenate([jnp.ones((count, 1), params.mass.dtype), params.mass], 1)  # body 0 is the world
        root = jnp.broadcast_to(m.dof_damping[:3], (count, 3))
        gain = jnp.broadcast_to(m.actuator_gainprm, (count, *m.actuator_gainprm.shape)).at[:, :, 0].set(params.kp)
        bias = jnp.broadcast_to(m.actuator_biasprm, (count, *m.actuator_biasprm.shape))
        bias = bias.at[:, :, :3].set(jnp.stack([params.kp * params.zero, -params.kp, -params.kv], -1))
        return {
            "body_mass": mass * m.body_mass,
            "body_inertia": mass[:, :, None] * m.body_inertia,
            "dof_damping": jnp.concatenate([root, params.kb], 1),
            "actuator_gainprm": gain,
            "actuator_biasprm": bias,
        }

    def _step(self, fields, q, v, target, applied):
        """Does one `mjx.step` of every fish; returns (q, v)."""

        def one(fields, q, v, target, applied):
            data = self.blank.replace(qpos=q, qvel=v, ctrl=target, qfrc_applied=applied)
            data = mjx.step(self.model.replace(**fields), data)
            return data.qpos, data.qvel

        return jax.vmap(one)(fields, q, v, target, applied)
