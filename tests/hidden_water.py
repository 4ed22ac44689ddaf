"""A water that the model does not know, and what a campaign in it would have recorded. Synthetic, made for the tests of the fit.

The strip model with other coefficients, and two things that no strip model has:
    wash       the tail swims through what the link before it pushed aside, late by two lags of length WASH / speed
    overshoot  cross-flow drag is higher while the speed across grows: C_o (|w| - |w| delayed) w
"""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from fishmj.base.store import Manifest, write_json
from fishmj.hydro_fit import record, segment_dataset
from fishmj.mjcf import load_robot
from fishmj.mjcf.servos import on_the_bus
from fishmj.water.dynamics import planar_chain, strip_forces

ROBOT = load_robot("fish")
CHAIN = planar_chain.chain_of(ROBOT)
N, J, TICK = CHAIN.n, CHAIN.n - 1, ROBOT.timing.bus_dt
STEPS = round(TICK / CHAIN.dt)
WASH, GAIN, OVERSHOOT, LAG = 0.10, 0.35, 1.2, 0.12  # m, share, coefficient, m
NOISE = 0.01  # of a channel's rms
FISH, SECOND = 32, round(1 / CHAIN.dt)  # swum at once, and steps: one program for all swims
TRUE = planar_chain.nominal(ROBOT).water._replace(
    k=[0.82, 0.95, 1.0, 0.70],
    cn=[1.5, 1.0, 1.4, 2.6],
    cf=0.018,
    ca_forward=0.55,
    ca_backward=0.8,
    ke=0.42,
    stall_angle=np.radians(40),
    stall_lag=2.2,
)


class Hidden:
    """Hooks with the wash and the overshoot. memory: 2 + N arrays."""

    def __init__(self, memory, scale=1.0):
        self.memory, self.scale = memory, scale

    def fish(self, ch, sw):
        return ch, sw

    def flow(self, ch, q, flow):
        return flow

    def servos(self, ch, sw, q, v, target):
        return planar_chain.servo_drive(jnp, ch, sw, q, v, target), [0.0] * (ch.n - 1)

    def body(self, ch, sw, q, k, rhs, m):
        pass

    def water(self, ch, sw, q, k, hydro):
        s, dt = ch.strips, ch.dt
        mid = [k.w[i] + k.omega[i] * np.mean(s.x[i]) for i in range(ch.n)]
        speed = [jnp.sqrt(k.u[i] ** 2 + mid[i] ** 2 + 1e-4) for i in range(ch.n)]
        near, far, *slow = self.memory
        keep = jnp.exp(-dt * speed[-1] / (WASH / 2))
        near, far = mid[-2] + (near - mid[-2]) * keep, near + (far - near) * keep
        slow = [abs(w) + (m - abs(w)) * jnp.exp(-dt * v / LAG) for w, m, v in zip(mid, slow, speed, strict=True)]
        self.memory = [near, far, *slow]
        out = []
        for i, (ft, fn, moment) in enumerate(hydro):
            area, push = sum(s.h[i]), 0.0
            if i == ch.n - 1:
                seen = mid[i] - GAIN * far
                push = -(sw.water.cn[i]) * (abs(seen) * seen - abs(mid[i]) * mid[i])
            push = push - OVERSHOOT * (abs(mid[i]) - slow[i]) * mid[i]
            push = 0.5 * s.rho * area * push * self.scale
            out.append((ft, fn + push, moment + np.mean(s.x[i]) * push))
        return out

    def end(self, ch, sw, v, drive):
        return self.memory


def swimmer(water=TRUE):
    return planar_chain.nominal(ROBOT)._replace(water=water)


def wave(frequency, amplitude, lag, bias, seconds):
    """Bus commands (T, J) of a gait with a second of ramp."""
    t = np.arange(round(seconds / TICK))[:, None] * TICK
    phase = 2 * np.pi * frequency * t - lag * np.arange(J)
    return np.minimum(t, 1.0) * amplitude * np.sin(phase) + np.minimum(t / 0.5, 1.0) * bias / J


def gaits(count, seconds, seed, turning=0.5):
    """Commands of `count` gaits, drawn."""
    rng = np.random.default_rng([5, seed])
    out = []
    for _ in range(count):
        f, a, lag = rng.uniform(0.5, 1.8), np.radians(rng.uniform(10, 32)), np.radians(rng.uniform(35, 85))
        a = min(a, 0.85 * ROBOT.servo.speed_no_load / (2 * np.pi * f))
        bias = np.radians(rng.uniform(10, 30)) * rng.choice([-1, 1]) if rng.random() < turning else 0.0
        out.append(wave(f, a, lag, bias, seconds))
    return np.array(out)


def targets(count, seconds, seed):
    """Random targets every 0.2 s, in a straight line."""
    rng, every = np.random.default_rng([6, seed]), round(ROBOT.timing.control_dt / TICK)
    ticks = round(seconds / TICK)
    goals = rng.uniform(-1, 1, (count, ticks // every + 2, J)) * rng.uniform(0.2, 0.6, (count, 1, 1))
    goals[:, 0] = 0.0
    k, share = np.divmod(np.arange(ticks), every)
    share = (share[:, None] + 1) / every
    return goals[:, k] + share * (goals[:, k + 1] - goals[:, k])


def chirps(count, seconds, seed):
    """Joint paths (count, T + 1, J) of a held fish, 0.3 to 3 Hz."""
    rng = np.random.default_rng([7, seed])
    t = np.arange(round(seconds / CHAIN.dt) + 1) * CHAIN.dt
    k = np.log(10.0)
    phase = 2 * np.pi * 0.3 * seconds / k * np.expm1(k * t / seconds)
    rate = 2 * np.pi * 0.3 * np.exp(k * t / seconds)
    size = np.minimum(np.radians(rng.uniform(10, 28, (count, 1))), 3.5 / rate)
    ratio, lag = rng.uniform(0.8, 1.2, (count, 1)) ** np.arange(J), rng.uniform(-1.5, 2, (count, 1)) * np.arange(J)
    return np.minimum(t, 1.0)[:, None] * size[..., None] * np.sin(ratio[:, None] * phase[:, None] - lag[:, None])


def swim(commands, *, flow=None, block="gait", split="train", water=TRUE, hidden=1.0, noise=NOISE, seed=0, yaw=None):
    """Free swims of B fish by bus commands (B, T, J): B records. flow (B, 2) m/s, yaw (B,) at the start."""
    commands = on_the_bus(ROBOT.servo, commands)
    batch, ticks, _ = commands.shape
    flow = np.zeros((batch, 2)) if flow is None else flow
    delay = round(ROBOT.timing.command_latency / CHAIN.dt)
    late = np.maximum((np.arange(ticks * STEPS) - delay) // STEPS, -1)
    targets = np.concatenate([np.zeros((batch, 1, J)), commands], 1)[:, late + 1]
    start = np.zeros((6, batch))
    start[2] = 0.0 if yaw is None else yaw
    with jax.enable_x64(True):
        out = _swum(start, targets.transpose(1, 2, 0), flow.T, water, hidden)
    return _records(out, commands, flow, (start, 0 * start), block, split, noise, seed, False)


def hold(paths, *, speed=0.0, heading=0.0, block="chirp", split="train", water=TRUE, hidden=1.0, noise=NOISE, seed=0):
    """Held fish whose joints follow paths (B, steps + 1, J) to the letter; heading (B,) to a stream along +x."""
    batch, length, _ = paths.shape
    ticks = (length - 1) // STEPS
    flow = np.stack([np.broadcast_to(speed, batch), np.zeros(batch)], -1).astype(float)
    rate = np.diff(paths, axis=1, prepend=paths[:, :1]) / CHAIN.dt
    q, v = np.zeros((length, 6, batch)), np.zeros((length, 6, batch))
    q[:, 2] = heading
    q[:, 3:], v[:, 3:] = paths.transpose(1, 2, 0), rate.transpose(1, 2, 0)
    with jax.enable_x64(True):
        wrench = np.asarray(_hold(q, v, flow.T, water, hidden))
    last = ticks * STEPS
    out = q[1 : last + 1], v[1 : last + 1], wrench[:last], np.full((last, batch), np.nan)
    return _records(out, paths[:, :last:STEPS], flow, (q[0], v[0]), block, split, noise, seed, True)


def _nothing(batch):
    return [jnp.zeros(batch)] * (2 + N)


def _swum(start, targets, flow, water, hidden):
    """Swims of `FISH` fish, second by second, the last fish repeated: one program for every number of fish and every length."""
    batch, whole = start.shape[1], len(targets)
    more = lambda a: np.concatenate([a, np.repeat(a[..., -1:], -batch % FISH, -1)], -1)
    targets = np.concatenate([targets, np.repeat(targets[-1:], -whole % SECOND, 0)])
    start, targets, flow = more(start), more(targets), more(flow)
    found = []
    for first in range(0, start.shape[1], FISH):
        some = slice(first, first + FISH)
        state = (list(start[:, some]), list(0 * start[:, some]), np.full(FISH, 0.5), [np.zeros(FISH)] * (2 + N))
        rows = []
        for k in range(0, len(targets), SECOND):
            state, out = _swim(state, targets[k : k + SECOND, :, some], flow[:, some], water, hidden)
            rows.append([np.asarray(a) for a in out])
        found.append([np.concatenate(column) for column in zip(*rows, strict=True)])
    return [np.concatenate(column, -1)[:whole, ..., :batch] for column in zip(*found, strict=True)]


@jax.jit
def _swim(begin, targets, flow, water, hidden):
    sw, stream = swimmer(water), [(flow[0], flow[1])] * N

    def one(state, target):
        q, v, attached, memory = state
        s = planar_chain.step(jnp, CHAIN, sw, q, v, attached, list(target), stream, (0.0, 0.0), Hidden(memory, hidden))
        wrench = _wrench(sw, q, v, attached, memory, stream, s.accel, hidden)
        return (s.q, s.v, s.attached, list(s.memory)), (jnp.stack(s.q), jnp.stack(s.v), wrench, s.power)

    return lax.scan(one, begin, targets)


@jax.jit
def _hold(q, v, flow, water, hidden):
    sw, stream, batch = swimmer(water), [(flow[0], flow[1])] * N, q.shape[2]

    def one(state, now):
        (q, v, new), (attached, memory) = now, state
        turn = (new - v)[2:] / CHAIN.dt
        accel = [0 * turn[0], 0 * turn[0], *jnp.cumsum(turn, 0)]
        wrench = _wrench(sw, q, v, attached, memory, stream, accel, hidden)
        k, hooks = planar_chain.kinematics(jnp, CHAIN, q, v, stream), Hidden(memory, hidden)
        hooks.water(CHAIN, sw, q, k, [(0.0, 0.0, 0.0)] * N)
        attached = strip_forces.attachment(jnp, CHAIN.strips, water, k.u[-1], k.w[-1], k.omega[-1], attached, CHAIN.dt)
        return (attached, hooks.memory), wrench

    return lax.scan(one, (jnp.full(batch, 0.5), _nothing(batch)), (q[:-1], v[:-1], v[1:]))[1]


def _wrench(sw, q, v, attached, memory, stream, accel, hidden):
    """Force and moment of the water on every link, tank frame, (N, 3, B)."""
    k = planar_chain.kinematics(jnp, CHAIN, q, v, stream)
    hydro = planar_chain.water_forces(jnp, CHAIN, sw, k, q[2], (0.0, 0.0), attached)
    hydro = Hidden(memory, hidden).water(CHAIN, sw, q, k, hydro)
    ax, ay, *alpha = accel
    cp, sp, out = jnp.cos(q[2]), jnp.sin(q[2]), []
    for i in range(N):
        (tx, ty), (nx, ny) = k.t[i], k.n[i]
        if i:
            lever = CHAIN.d[i - 1] * alpha[i - 1]
            ax, ay = ax + lever * k.n[i - 1][0], ay + lever * k.n[i - 1][1]
        m0, m1, m2 = (sw.water.k[i] * m for m in CHAIN.strips.mu[i])
        a = ax * nx + ay * ny
        ft, fn, moment = hydro[i]
        fn, moment = fn - m0 * a - m1 * alpha[i], moment - m1 * a - m2 * alpha[i]
        fx, fy = ft * tx + fn * nx, ft * ty + fn * ny
        out.append(jnp.stack([cp * fx - sp * fy, sp * fx + cp * fy, moment + 0 * fx]))
    return jnp.stack(out)


def _records(out, commands, flow, start, block, split, noise, seed, prescribed):
    ends = slice(STEPS - 1, None, STEPS)
    q, v = (out[i][ends].transpose(2, 0, 1) for i in (0, 1))
    tick_mean = lambda a: a.reshape(-1, STEPS, *a.shape[1:]).mean(1)
    wrench = tick_mean(out[2]).transpose(3, 0, 1, 2)
    power = tick_mean(out[3]).T + ROBOT.servo.idle_power
    rng = np.random.default_rng([8, seed])
    wrench = wrench + noise * np.sqrt((wrench**2).mean(1, keepdims=True)) * rng.standard_normal(wrench.shape)
    made = []
    for b in range(len(q)):
        kind = block if isinstance(block, str) else block[b]
        name = f"{kind}-{split}-{seed}-{b}"
        meta = {"id": name, "episode": name, "block": kind, "split": split, "tick": TICK, "replicate_of": "", "stopped": ""}
        meta |= {"start": {"q": start[0][:, b].tolist(), "v": start[1][:, b].tolist()}, "grid": {"slip": 1.0}}
        meta |= {"prescribed": {"joints": prescribed, "root": prescribed}, "latency": ROBOT.timing.command_latency}
        meta |= {"origin": "synthetic", "segment": {"flow": {"speed": float(np.hypot(*flow[b])), "turbulence": "none"}}}
        stream = np.broadcast_to(flow[b], (len(q[b]), N, 2)).copy()
        made.append(record.SegmentRecord(meta, q[b], v[b], commands[b], wrench[b], wrench[b], stream, power[b]))
    return made


def campaign(size=1.0, seed=0, split="train", seconds=8.0, **world):
    """A small campaign of every kind; 34 records at size 1. world: water, hidden, noise."""
    count = lambda n: max(2, round(n * size))
    few, n, rest = count(6), count(12), count(4)
    rng = np.random.default_rng([9, seed])
    angle, yaw = rng.uniform(0, 2 * np.pi, few), rng.uniform(0, 2 * np.pi, few)
    stream = rng.uniform(0, 0.4, few)[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    commands = np.concatenate([gaits(n + few, seconds, seed), targets(few, seconds, seed)])
    flow = np.concatenate([np.zeros((n, 2)), stream, np.zeros((few, 2))])
    turned = np.concatenate([np.zeros(n), yaw, np.zeros(few)])
    names = ["gait"] * (n + few) + ["random"] * few
    out = swim(commands, flow=flow, yaw=turned, block=names, split=split, seed=seed, **world)
    paths = chirps(few, seconds, seed)
    still = np.radians(rng.uniform(-40, 40, (rest, 1, 1))) * (np.arange(rest) % 2)[:, None, None]
    paths = np.concatenate([paths, np.broadcast_to(still, (rest, *paths.shape[1:]))])
    speed = np.concatenate([rng.choice([0.0, 0.2, 0.4], few), np.full(rest, 0.25)])
    heading = np.concatenate([np.full(few, np.pi), rng.uniform(-np.pi, np.pi, rest)])
    names = ["chirp"] * few + ["static"] * rest
    return out + hold(paths, speed=speed, heading=heading, block=names, split=split, seed=seed, **world)


def write_dataset(folder, records):
    """Records as a data set on disk, as a campaign leaves it."""
    about = {"robot": {"name": ROBOT.name, "joints": J, "sha256": segment_dataset.fingerprint(ROBOT)}}
    grid = {"domain": "synthetic", "dx": 0.0, "dt": CHAIN.dt, "slip": 1.0}
    for r in records:
        arrays = {key: getattr(r, key) for key in record.UNITS if key != "power" or np.isfinite(r.power).all()}
        record.write_record(folder / segment_dataset.SEGMENTS, {**r.meta, **about, "grid": grid}, arrays)
    episodes = {r.meta["episode"]: r.meta["split"] for r in records}
    write_json(folder / segment_dataset.SPLIT, {"episodes": episodes, "sha256": segment_dataset.split_hashes(episodes)})
    Manifest.of(folder).write(folder)
    return folder


if __name__ == "__main__":  # python tests/hidden_water.py FOLDER: a whole synthetic campaign, to try the verbs of hydro_fit on
    parts = (("train", 1.0, 0, 8.0), ("val", 0.5, 3, 8.0), ("test", 1.0, 11, 14.0))
    every = [r for split, size, seed, seconds in parts for r in campaign(size, seed, split, seconds)]
    print(write_dataset(Path(sys.argv[1]), every))
