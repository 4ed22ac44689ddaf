"""Commands on their way to the servos: the sites `command`, run along time before any physics.

The transport delay of the clock "command" is not in here: whoever feeds the servo looks that much earlier into the result.
"""

from fishmj.effects.stack import EffectStack


def delivered(xp, active: EffectStack, parameters, commands, h: float):
    """What the servos are told when `commands` are sent.

    Args:
        xp: numpy, or jax.numpy outside a compiled function.
        active: the effects, in their order.
        parameters: (P,) one parameter row, or (B, P) a batch of them.
        commands: (T, J) rad, one row every `h` s: each physics step, or each event of the bus.
    Returns:
        (T, J) rad for one row of parameters, (B, T, J) for a batch.
    """
    commands, rows = xp.asarray(commands), xp.asarray(parameters)
    given = xp.broadcast_to(commands, (*rows.shape[:-1], *commands.shape))
    if not any(slot.effect.command for slot in active.slots):
        return given
    session = active.begin(xp, [rows[..., i] for i in range(rows.shape[-1])], active.memory)
    joints = range(commands.shape[1])
    moments = [xp.stack([session.command(j, given[..., k, j], h) for j in joints], -1) for k in range(len(commands))]
    return xp.stack(moments, -2)
