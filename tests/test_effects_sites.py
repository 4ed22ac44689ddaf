"""What single effects claim, in numbers: each against its formula, worked out by hand or by another route."""

from types import SimpleNamespace

import numpy as np
import pytest
from effect_swim import CHAIN, JOINTS, SWIMMER, H, sense, swim

from fishmj import effects
from fishmj.effects import EffectStack
from fishmj.effects.sites import BodyMotion, FlowAt, Gear, LocalWater, SensorReadings, ServoDrive
from fishmj.effects.stack import delivered
from fishmj.effects.stages.actuator_joint import AT_REST, GIVE
from fishmj.water.dynamics.hooks import Effects

AIR = SWIMMER._replace(water=SWIMMER.water._replace(k=[0.0] * 4, cn=[0.0] * 4, cf=0.0, ca_forward=0.0, ca_backward=0.0, ke=0.0))


def values(**given) -> SimpleNamespace:
    """Parameters of an effect on the default fish."""
    return SimpleNamespace(**given, robot=effects.RobotScales())


def one(name: str, **values):
    """(Active of one effect, its parameter row)."""
    active = EffectStack([effects.get(name)], JOINTS)
    return active, active.flat({name: values})


def told(name: str, sent, h: float = H, **values):
    """Commands (T,) of a single joint as the servo gets them."""
    active, row = one(name, **values)
    return delivered(np, active, row, np.asarray(sent, float)[:, None], h)[:, 0]


def fields(kind, **given):
    return kind(**dict.fromkeys(kind._fields, 0.0) | given)


def test_commands_are_ramped_limited_scaled_and_counted():
    step = np.r_[np.zeros(5), np.full(45, 0.3)]
    ramp = told("move_time_ramp", step, move_time=0.1)
    np.testing.assert_allclose(ramp[5:30], 0.3 * np.arange(1, 26) * H / 0.1, atol=1e-12)
    np.testing.assert_array_equal(ramp[30:], 0.3)
    small = told("move_time_ramp", step / 3, move_time=0.1)
    np.testing.assert_allclose(small, ramp / 3, atol=1e-12)  # the slope goes with the step
    limited = told("rate_limit", step, slowness=0.25)
    assert np.isclose(np.diff(limited).max(), H / 0.25) and np.isclose(limited[-1], 0.3)
    np.testing.assert_allclose(told("command_gain_error", step, gain=0.05), 1.05 * step)
    counted = told("command_quantisation", np.linspace(-1, 1, 101), step=0.03)
    np.testing.assert_allclose(counted, 0.03 * np.round(np.linspace(-1, 1, 101) / 0.03), atol=1e-12)


def test_a_new_command_restarts_the_ramp_from_where_it_is():
    ramp = told("move_time_ramp", np.r_[np.full(10, 0.3), np.full(60, -0.1)], move_time=0.1)
    middle = 0.3 * 10 * H / 0.1
    np.testing.assert_allclose(ramp[10:35], middle + (-0.1 - middle) * np.arange(1, 26) * H / 0.1, atol=1e-12)


def test_dead_band_is_silent_inside_and_whole_outside():
    error = np.array([0.0, 0.01, -0.017, 0.0201, -0.2])
    s, _ = effects.get("servo_deadband").servo(np, SimpleNamespace(deadband=0.02), fields(ServoDrive, error=error), (), H)
    np.testing.assert_array_equal(s.error, [0.0, 0.0, 0.0, 0.0201, -0.2])


def test_supply_and_heat_weaken_the_servo_in_proportion():
    given = fields(ServoDrive, limit=1.667, kp=8.0, kv=0.1, current=3.7, time=100.0)
    s, _ = effects.get("voltage_sag").servo(np, values(resistance=0.4), given, (), H)
    left = (7.4 - 0.4 * (3.7 + 1.5 / 7.4)) / 7.4
    assert np.isclose(s.limit, 1.667 * left) and np.isclose(s.kp, 8.0 * left)
    s, _ = effects.get("thermal_derating").servo(np, SimpleNamespace(rate=0.001), given, (), H)
    assert np.isclose(s.limit, 1.667 * np.exp(-0.1)) and np.isclose(s.kp, 8 * np.exp(-0.1))
    s, _ = effects.get("torque_saturation").servo(np, values(limit=1.0), given, (), H)
    assert s.limit == 1.0


def test_laws_take_length_and_voltage_from_the_described_robot():
    """A servo of 5 V sags by R I / 5; half the length feels a wall half as far."""
    mine = effects.RobotScales(length=0.2675, voltage=5.0, idle_power=0.5, torque=3.0)
    p = lambda **given: SimpleNamespace(**given, robot=mine)
    given = fields(ServoDrive, limit=3.0, kp=8.0, kv=0.1, current=0.9)
    s, _ = effects.get("voltage_sag").servo(np, p(resistance=0.4), given, (), H)
    assert np.isclose(s.limit, 3.0 * (1.0 - 0.4 * (0.9 + 0.5 / 5.0) / 5.0))
    s, _ = effects.get("torque_saturation").servo(np, p(limit=2.0), given, (), H)
    assert s.limit == 2.0  # above the default fish's stall torque
    whole = effects.get("torque_saturation").on_robot(mine).parameters[0].null
    s, _ = effects.get("torque_saturation").servo(np, p(limit=whole), given._replace(limit=3.3), (), H)
    assert s.limit == 3.3  # at the null any servo keeps its own limit
    wave, _ = effects.get("free_surface").body(np, p(gain=8.0), fields(BodyMotion, u=0.4, wet=1.0), (), H)
    assert np.isclose(wave.fx, -8.0 * 0.4**4 / (9.81 * 0.2675))
    water = fields(LocalWater, x=1.5325, forces=[(2.0, 0.0, 0.0)], instant=[(1.0, 0.0, 0.0)])
    near, _ = effects.get("wall_effect").water(np, p(gain=0.4), water, (), H)
    assert np.isclose(near.forces[0][0], 2.0 + 0.4 * np.exp(-1.0))


def rubbed(name, drive, seconds, rate=0.0, inertia=3e-4, **p):
    """(moved rad, rate rad/s) of one joint that a constant torque drives against dry friction."""
    gear, memory, moved = effects.get(name).gear, AT_REST, 0.0
    for _ in range(round(seconds / H)):
        g, memory = gear(np, SimpleNamespace(**p), fields(Gear, drive=drive, rate=rate), memory, H)
        rate = (rate + H / inertia * (g.drive + g.torque)) / (1.0 + H / inertia * g.resist)
        moved += H * rate
    return moved, rate


@pytest.mark.parametrize(
    "name, p",
    [("coulomb_friction", {"torque": 0.1}), ("stribeck", {"torque": 0.1, "speed": 0.1}), ("load_friction", {"ratio": 2.0})],
)
def test_a_joint_at_rest_stays_where_it_is_until_friction_is_overcome(name, p):
    moved, rate = rubbed(name, 0.05, 20.0, **p)
    assert moved <= GIVE and abs(rate) < 1e-6


def test_coulomb_friction_subtracts_its_torque_and_stribeck_fades_at_speed():
    _, rate = rubbed("coulomb_friction", 0.16, 0.2, torque=0.1)
    assert rate == pytest.approx(0.2 * 0.06 / 3e-4, rel=0.05)
    _, stopped = rubbed("coulomb_friction", 0.0, 0.5, rate=5.0, torque=0.1)
    assert abs(stopped) < 1e-6
    _, fast = rubbed("stribeck", 0.0, 0.2, rate=5.0, torque=0.1, speed=0.1)
    assert fast == pytest.approx(5.0, rel=1e-9)


def test_the_extra_torque_speed_line_ends_at_its_speed():
    active, row = one("speed_limit", slowness=0.5)
    sent = np.full((250, JOINTS), 1.0)
    rate = swim(active, [row], sent, swimmer=AIR, wet=0.0)[1][0, :, 5]
    free = swim(active, [active.null], sent, swimmer=AIR, wet=0.0)[1][0, :, 5]
    assert free.max() > 3.0 and rate.max() < 2.04 and np.isclose(np.median(rate[5:60]), 2.0, rtol=0.01)
    above, own = one("speed_limit", slowness=0.15)[0], one("speed_limit", slowness=0.15)[1]  # the servo's own line: 0.19
    np.testing.assert_array_equal(swim(above, [own], sent, swimmer=AIR, wet=0.0)[1][0, :, 5], free)


def test_play_is_lost_motion_at_reversals_and_holds_no_torque_inside():
    gear, p = effects.get("gear_backlash").gear, SimpleNamespace(half_gap=0.02)
    drive, memory, lost = np.r_[np.full(30, 0.5), np.full(30, -0.5)], (0.0,), []
    for torque in drive:
        g, memory = gear(np, p, fields(Gear, drive=torque, kb=0.3), memory, H)
        assert -0.02 <= memory[0] <= 0.02
        lost.append(1.0 - g.drive / torque)
    crossing = 0.3 / 0.5 / H  # steps a radian at the motor's no-load speed
    assert np.isclose(sum(lost[:30]), 0.02 * crossing) and np.isclose(sum(lost[30:]), 0.04 * crossing)


def test_skin_branch_relaxes_with_its_time_and_the_spring_does_not():
    gear, memory, held = effects.get("skin_hysteresis").gear, (0.0,), []
    for _ in range(250):
        g, memory = gear(np, SimpleNamespace(stiffness=0.5, time=0.5), fields(Gear, angle=0.4), memory, H)
        held.append(g.torque)
    np.testing.assert_allclose(held, -0.5 * 0.4 * np.exp(-H * np.arange(1, 251) / 0.5), rtol=1e-10)


def test_a_skin_costs_power_to_hold_an_angle():
    active = EffectStack([effects.get("skin_stiffness")], JOINTS)
    q, _, power = swim(active, [active.null, [0.8]], np.full((400, JOINTS), 0.5), swimmer=AIR, wet=0.0)
    slack = 0.5 - q[:, -1, 4]
    assert abs(slack[0]) < 1e-3 and np.isclose(8.0 * slack[1], 0.8 * q[1, -1, 4], rtol=1e-2)
    torque = 0.8 * q[1, -1, 3:]
    assert power[0, -1] < 1e-3 and np.isclose(power[1, -1], np.sum(torque**2) / SWIMMER.kb[0], rtol=2e-2)


def test_a_zero_offset_bends_the_fish_and_its_encoders_do_not_tell():
    active, row = one("joint_zero_offset", offset1=0.1, offset3=-0.05)
    q, _, power = swim(active, [row], np.full((500, JOINTS), 0.2))
    np.testing.assert_allclose(q[0, -1, 3:], [0.3, 0.2, 0.15], atol=2e-3)
    np.testing.assert_allclose(sense(active, [row], q, power).joint[0, -1], 0.2, atol=2e-3)


def test_wake_reaches_63_per_cent_of_a_new_force_after_its_time():
    water, memory, felt = effects.get("wake_memory").water, (0.0, 0.0, 0.0), []
    given = fields(LocalWater, forces=[(0.0, 0.0, 0.0), (1.0, 5.0, 0.2)], instant=[(0.0, 0.0, 0.0), (0.0, 3.0, 0.0)])
    for _ in range(50):
        w, memory = water(np, SimpleNamespace(time=0.2), given, memory, H)
        felt.append(w.forces[1][1])
    assert np.isclose(felt[49], 3.0 + 2.0 * (1 - np.exp(-1.0)))  # what belongs to the added mass comes at once


def test_wall_effect_raises_drag_by_its_gain_and_decays_with_distance():
    water, p = effects.get("wall_effect").water, values(gain=0.4)
    given = fields(LocalWater, x=np.array([1.8, 0.0, 0.3]), y=np.array([0.2, 0.0, -1.8]))
    given = given._replace(forces=[(2.0, 0.0, 0.0)], instant=[(1.0, 0.0, 0.0)])
    near, _ = water(np, p, given, (), H)
    np.testing.assert_allclose(near.forces[0][0], [2.4, 2.0 + 0.4 * np.exp(-1.8 / 0.535), 2.4])


def test_walls_raise_the_added_mass_too():
    """A fish let go sideways at the wall gains, in the first step, what its own added mass times the share would give."""
    active = EffectStack([effects.get("wall_effect")], JOINTS)
    row, k = 0.5, SWIMMER.water.k
    heavy = SWIMMER._replace(water=SWIMMER.water._replace(k=[1.5 * x for x in k], cn=[1.5 * c for c in SWIMMER.water.cn]))
    heavy = heavy._replace(water=heavy.water._replace(**{f: 1.5 * getattr(heavy.water, f) for f in ("cf", "ca_forward", "ke")}))
    at_wall, still = (0.0, 1.8, 0.3, 0.1, -0.2, 0.1), np.zeros((1, JOINTS))
    push = (0.3, 0.2, 0.5, 0.4, -0.3, 0.2)
    near = swim(active, [[row]], still, at_wall, push)[1]
    like = swim(active, [active.null], still, at_wall, push, swimmer=heavy)[1]
    np.testing.assert_allclose(near, like, rtol=1e-9, atol=1e-12)


def test_moments_and_forces_of_the_hull_have_their_signs():
    given = fields(BodyMotion, u=0.3, w=0.1, sway_mass=2.0, wet=1.0)
    munk, _ = effects.get("munk_moment").body(np, SimpleNamespace(gain=0.2), given, (), H)
    assert np.isclose(munk.n, -0.2 * 2.0 * 0.3 * 0.1)  # drifting left, the nose is turned right: further askew
    for u in (0.3, -0.3):
        lift, _ = effects.get("body_lift").body(np, SimpleNamespace(coefficient=10.0), given._replace(u=u), (), H)
        assert np.isclose(lift.fy, -0.3)
    pull, _ = effects.get("tether").body(
        np, SimpleNamespace(stiffness=0.5, x=1.0, y=0.0), fields(BodyMotion, heading=np.pi / 2), (), H
    )
    assert np.allclose((pull.fx, pull.fy), (0.0, -0.5))  # facing north, the anchor in the east lies to the right
    wave = [effects.get("free_surface").body(np, values(gain=8.0), given._replace(u=u), (), H)[0].fx for u in (0.2, 0.4)]
    assert np.isclose(wave[1] / wave[0], 16.0)
    assert np.isclose(wave[1], -8.0 * 0.4**4 / (9.81 * 0.535))


def test_in_air_no_water_acts_on_body_or_joints():
    given = fields(BodyMotion, u=0.3, w=0.1, r=1.0)
    for name in ("linear_surge_drag", "quadratic_drag", "yaw_drag", "body_lift", "free_surface", "munk_moment") + tuple(
        f"{way}_added_mass" for way in ("surge", "sway", "yaw")
    ):
        effect = effects.get(name)
        p = values(**{q.name: q.probe for q in effect.parameters})
        assert all(value == 0.0 for value in effect.body(np, p, given, (), H)[0][-7:]), name
    g, _ = effects.get("joint_hydro_damping").gear(np, SimpleNamespace(coefficient=0.05), fields(Gear, rate=2.0), (), H)
    assert g.resist == 0.0


def test_water_turns_shears_and_drifts():
    at = fields(FlowAt, x=1.0, y=-0.5)
    place = effects.get("swirl").flow(np, SimpleNamespace(rate=0.04), at)
    assert np.allclose((place.u, place.v), (0.02, 0.04))
    place = effects.get("current_shear").flow(np, SimpleNamespace(rate=0.1), at)
    assert np.allclose((place.u, place.v), (-0.05, 0.0))


def test_body_mass_is_spread_by_weight_and_coasts_like_added_mass():
    heavy, row = one("body_mass", mass=0.2)
    added, other = one("surge_added_mass", mass=0.2)
    still = np.zeros((200, JOINTS))
    a = swim(heavy, [row], still, push=(0.4, 0, 0, 0, 0, 0))[1][0, :, 0]
    b = swim(added, [other], still, push=(0.4, 0, 0, 0, 0, 0))[1][0, :, 0]
    plain = swim(heavy, [heavy.null], still, push=(0.4, 0, 0, 0, 0, 0))[1][0, :, 0]
    np.testing.assert_allclose(a, b, rtol=1e-9)
    assert a[-1] > plain[-1] + 1e-3
    hooks = Effects(np, heavy, row, heavy.memory)
    ch, sw = hooks.fish(CHAIN, SWIMMER)
    assert np.isclose(np.array(sw.mass) @ ch.mass, 1.3)


def test_sensors_turn_stretch_and_shift_what_they_see():
    seen = SensorReadings(np.zeros(1), *(np.array([v]) for v in (1.0, 0.5, 0.2)), np.zeros((1, 3)), np.array([4.0]))
    look = lambda name, **values: effects.get(name).measure(np, SimpleNamespace(**values), seen)
    turned = look("camera_yaw", angle=np.pi / 2)
    assert np.allclose((turned.x, turned.y, turned.yaw), ([-0.5], [1.0], [0.2 + np.pi / 2]))
    assert np.allclose(look("camera_scale", scale=0.02).x, 1.02) and np.allclose(look("power_offset", power=0.3).power, 4.3)
    assert np.allclose(look("lens_distortion", k1=0.01).y, 0.5 * (1 + 0.01 * 1.25))
    assert np.allclose(look("marker_offset", x=0.03).y, 0.5 + 0.03 * np.sin(0.2))
    assert np.allclose(look("heading_marker_offset", angle=-0.05).yaw, 0.15)


def test_clocks_add_their_delays_and_drift():
    active = EffectStack([effects.get(name) for name in ("camera_latency", "clock_offset", "joint_sensor_delay")], JOINTS)
    row = active.flat({"camera_latency": {"delay": 0.05}, "clock_offset": {"offset": -0.02, "drift": 1.0001}})
    np.testing.assert_allclose(active.delay(np, row, "pose", np.array([0.0, 100.0])), [0.03, 0.04])
    assert active.delay(np, row, "joint") == 0.0


def test_drawn_commands_have_the_scatter_that_their_effects_claim():
    t, rng = np.arange(20_000) * 0.02, np.random.default_rng(11)
    sent = rng.normal(size=len(t))
    late, same = effects.get("latency_jitter").robot.scatter(rng, SimpleNamespace(sigma=0.004), t, sent)
    assert np.all(np.diff(late) >= 0) and np.isclose(np.mean(late - t), 0.004, rtol=0.1) and np.array_equal(same, sent)
    assert np.isclose(np.std(late - t), 0.004, rtol=0.1)
    _, holes = effects.get("packet_loss").robot.scatter(rng, SimpleNamespace(probability=0.05), t, sent)
    assert np.isclose(np.mean(holes != sent), 0.05, atol=0.01)


@pytest.mark.parametrize("name", ["crossflow_drag", "tail_normal_force", "com_offset", "yaw_inertia"])
def test_constants_change_where_they_say_and_nowhere_else(name):
    active, row = one(name, **{effects.get(name).parameters[0].name: effects.get(name).parameters[0].probe})
    ch, sw = Effects(np, active, row, active.memory).fish(CHAIN, SWIMMER)
    changed = {f for f in ch._fields if getattr(ch, f) != getattr(CHAIN, f)}
    changed |= {f for f in sw._fields if f != "water" and getattr(sw, f) != getattr(SWIMMER, f)}
    changed |= {f for f in sw.water._fields if getattr(sw.water, f) != getattr(SWIMMER.water, f)}
    claims = {"crossflow_drag": {"cn"}, "tail_normal_force": {"cn", "ke"}, "com_offset": {"com"}, "yaw_inertia": {"inertia"}}
    assert changed == claims[name]
    if name == "tail_normal_force":
        assert sw.water.cn[:-1] == SWIMMER.water.cn[:-1] and np.isclose(sw.water.cn[-1], 1.3 * SWIMMER.water.cn[-1])
    if name == "yaw_inertia":
        assert np.isclose(ch.inertia[0] - CHAIN.inertia[0], 0.008) and ch.inertia[1:] == CHAIN.inertia[1:]
    if name == "com_offset":
        assert np.isclose(ch.com[0] - CHAIN.com[0], 0.03) and ch.com[1:] == CHAIN.com[1:]


def test_the_motors_ask_for_a_duty_and_the_supply_gives_what_is_left():
    """Stalled: i = d V / R_m, I = sum d i. The steps come to rest at V = V_oc - R (I + I_b); the meter reads V (I + I_b)."""
    resistance, boards, count = 0.6, 1.5 / 7.4, JOINTS
    sag, row = one("voltage_sag", resistance=resistance)
    memory = list(sag.memory)
    for _ in range(60):
        hooks = Effects(np, sag, row, memory)
        drive, _ = hooks.servos(CHAIN, SWIMMER, np.zeros(6), np.zeros(6), [1.0] * count)
        memory = hooks.end(CHAIN, SWIMMER, np.zeros(6), drive)
    stalled = count * CHAIN.torque / CHAIN.motor  # A at 7.4 V and full duty
    volts = (7.4 - resistance * boards) / (1.0 + resistance * stalled / 7.4)
    assert np.isclose(memory[0], stalled * volts / 7.4) and np.isclose(drive[0], CHAIN.torque * volts / 7.4)
    seen = fields(SensorReadings, power=volts * memory[0] + 7.4 * boards)
    metered = effects.get("voltage_sag").measure(np, values(resistance=resistance), seen).power
    assert np.isclose(metered, volts * (memory[0] + boards))
