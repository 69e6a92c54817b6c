"""Verdicts of loops that are not linear, against rollouts written here and describing functions."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from scipy.linalg import expm
from scipy.optimize import brentq

import jaxact as jx
from jaxact.drive.controller import Controller
from jaxact.drive.options import Drive
from jaxact.drive.sensor import Sensor
from jaxact.loops import reading, robots
from jaxact.loops.loop import Output
from jaxact.loops.samples import expand
from jaxact.simulation import envelope, execute, metrics, scales, starts, verdicts
from jaxact.simulation.metrics import Metrics
from jaxact.simulation.scales import Scale
from jaxact.simulation.verdicts import Judgement, Motion
from jaxact.status import Verdict

# A motor with an encoder of 4,096 counts a revolution, whose differences are its velocity.
COUNT, PERIOD, MASS, WN, ZETA, CUTOFF = 0.001534, 2e-3, 0.02, 300.0, 0.7, 300.0
MOTOR = f"""
precision = "float64"
duration = 1.0
velocity = "differenced"
[parameters]
mass = {MASS}
wn = {WN}
zeta = {ZETA}
delay = {PERIOD}
control_rate = {1 / PERIOD}
velocity_filter = {CUTOFF}
position_resolution = {COUNT}
kp = 80.0
kd = 1.5
"""


def _run(text):
    asked = reading.parse(text)
    samples = expand(asked)
    found = execute.run(asked, samples)
    return {name: row.reshape(samples.shape) for name, row in found.items()}


def _plain(setpoint, duration, *, kp=80.0, kd=1.5, position=0.0, velocity=0.0):
    """The motor again, written out: positions at the ticks; the delay is one control period."""
    matrix = np.zeros((5, 5))
    matrix[0, 1], matrix[1, 2], matrix[2, 3] = 1.0, 1.0 / MASS, 1.0
    matrix[3, 2:] = -WN * WN, -2.0 * ZETA * WN, WN * WN
    advance = expm(matrix * PERIOD)
    state, waiting = np.array([position, velocity, 0.0, 0.0, 0.0]), 0.0
    seen, speed = np.round((position - velocity * PERIOD) / COUNT) * COUNT, velocity
    share = 1.0 - np.exp(-CUTOFF * PERIOD)
    positions = [position]
    for _ in range(round(duration / PERIOD)):
        now = np.round(state[0] / COUNT) * COUNT
        speed += share * ((now - seen) / PERIOD - speed)
        seen = now
        state[4], waiting = waiting, kp * (setpoint - now) - kd * speed
        state = advance @ state
        positions.append(state[0])
    return np.array(positions)


def _oscillation(positions):
    """Half range and angular frequency of the last quarter."""
    last = positions[3 * len(positions) // 4 :]
    above = last >= 0.5 * (last.max() + last.min())
    rising = np.flatnonzero(above[1:] & ~above[:-1])
    frequency = 2.0 * np.pi * (len(rising) - 1) / ((rising[-1] - rising[0]) * PERIOD)
    return 0.5 * np.ptp(last), frequency


@pytest.mark.exhaustive
def test_a_quantised_loop_has_one_verdict_whatever_its_setpoint_and_start():
    speeds = [0.0, 0.001, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, -0.02, -0.5, 0.0123]
    found = _run(MOTOR + f"[axes]\nsetpoint = [0.0, 0.01, 0.1, 1.0]\ninitial_velocity = {speeds}\n")
    assert (found["verdict"] == Verdict.LIMIT_CYCLE).all()
    amplitude, frequency = found["limit_cycle_amplitude"], found["limit_cycle_frequency"]
    # What remains of a step of 1 m has not decayed to counts within a second.
    settled = amplitude[:3]
    assert (
        np.all((settled > 0.5 * COUNT) & (settled < 2.5 * COUNT)) and np.isfinite(frequency).all()
    )


@pytest.mark.exhaustive
@pytest.mark.parametrize("setpoint, velocity", [(0.01, 0.0), (0.3, 0.0), (0.0, 0.5)])
def test_amplitude_and_frequency_are_those_of_a_plain_rollout(setpoint, velocity):
    text = MOTOR.replace("duration = 1.0", "duration = 4.0")
    axes = f"[axes]\nsetpoint = [{setpoint}]\ninitial_velocity = [{velocity}]\n"
    found = {name: float(row.ravel()[0]) for name, row in _run(text + axes).items()}
    amplitude, frequency = _oscillation(_plain(setpoint, 4.0, velocity=velocity))
    assert found["limit_cycle_amplitude"] == pytest.approx(amplitude, rel=1e-3)
    assert found["limit_cycle_frequency"] == pytest.approx(frequency, rel=0.03)


@pytest.mark.exhaustive
def test_ripples_within_a_cycle_are_not_counted_in_its_frequency():
    """A light joint whose differences are not filtered: its velocity turns three times a cycle."""
    period, count, mass, wn, zeta, kp, kd = 1e-3, 1e-3, 2.0, 970.0, 0.23, 28500.0, 210.0
    found = _run(
        'precision = "float64"\nduration = 2.0\nvelocity = "differenced"\n[parameters]\n'
        f"mass = {mass}\nwn = {wn}\nzeta = {zeta}\ndelay = {period}\nkp = {kp}\nkd = {kd}\n"
        f"position_resolution = {count}\n[axes]\nsetpoint = [0.1]\n"
    )
    matrix = np.zeros((5, 5))
    matrix[0, 1], matrix[1, 2], matrix[2, 3] = 1.0, 1.0 / mass, 1.0
    matrix[3, 2:] = -wn * wn, -2.0 * zeta * wn, wn * wn
    advance, state, waiting, seen, positions = expm(matrix * period), np.zeros(5), 0.0, 0.0, []
    for _ in range(2000):
        now = np.round(state[0] / count) * count
        state[4], waiting = waiting, kp * (0.1 - now) - kd * (now - seen) / period
        seen, state = now, advance @ state
        positions.append(state[0])
    last = np.array(positions[1500:])
    lines = np.abs(np.fft.rfft((last - last.mean()) * np.hanning(len(last)), 2**14))
    fundamental = 2.0 * np.pi * lines.argmax() / (2**14 * period)
    speed = np.diff(last)
    turns = np.sum((speed[:-1] < 0.0) & (speed[1:] >= 0.0))
    assert turns * 2.0 * np.pi / (500 * period) > 2.5 * fundamental
    assert found["verdict"] == Verdict.LIMIT_CYCLE
    assert found["limit_cycle_frequency"] == pytest.approx(fundamental, rel=0.02)


@pytest.mark.parametrize("together", [1, 4])
@pytest.mark.parametrize("ticks", [2, 3, 7, 50])
def test_a_frequency_is_that_of_the_passages_however_many_ticks_come_at_once(together, ticks):
    times = np.arange(1, 401)
    swing = np.sin(2.0 * np.pi * (times + 0.3) / ticks) * 1e-3 + 0.5
    speed = np.cos(2.0 * np.pi * (times + 0.3) / ticks)
    zero = jnp.zeros(1)

    def output(place):
        before, now = jnp.array([speed[place - 1]]), jnp.array([speed[place]])
        return Output(zero, before, jnp.array([swing[place]]), now, zero, zero, zero)

    state = envelope.following(
        replace(envelope.init(zero), lowest=zero + 0.499, highest=zero + 0.501)
    )
    for first in range(0, 400, together):
        places = range(first, first + together)
        state = envelope.update(
            state, [output(k) for k in places], [jnp.float32(k) for k in places]
        )
    expected = 2.0 * np.pi / (ticks * PERIOD)
    np.testing.assert_allclose(state.frequency(PERIOD), expected, rtol=2e-2 / ticks)


FAST = 2.5e-4


def _open_loop(frequency, kp, kd):
    """Frequency response from the measured position, once round, to the position: sampled.

    At a control period of `FAST`, as a describing function knows of no ticks; the delay is that of
    the motor.
    """
    matrix = np.zeros((5, 5))
    matrix[0, 1], matrix[1, 2], matrix[2, 3] = 1.0, 1.0 / MASS, 1.0
    matrix[3, 2:] = -WN * WN, -2.0 * ZETA * WN, WN * WN
    advance = expm(matrix * FAST)
    z = np.exp(1j * frequency * FAST)
    plant = np.linalg.solve(z * np.eye(4) - advance[:4, :4], advance[:4, 4])[0]
    pole = np.exp(-CUTOFF * FAST)
    controller = kp + kd * (1.0 - pole) * (z - 1.0) / (z - pole) / FAST
    return plant * controller * z ** -round(PERIOD / FAST)


@pytest.mark.exhaustive
@pytest.mark.parametrize("kp, kd", [(80.0, 1.5), (40.0, 1.0), (20.0, 0.6)])
def test_between_two_counts_it_is_what_the_describing_function_of_a_relay_predicts(kp, kd):
    """Between two counts the encoder is a relay of half a count: N(A) = 2 count / (pi A)."""

    def phase(frequency):
        return np.angle(-_open_loop(frequency, kp, kd))

    crossing = brentq(phase, 60.0, 400.0)
    amplitude = 2.0 * COUNT * abs(_open_loop(crossing, kp, kd)) / np.pi
    assert amplitude < COUNT  # where the next two counts are out of reach
    text = MOTOR.replace("kp = 80.0\nkd = 1.5", f"kp = {kp}\nkd = {kd}")
    text = text.replace(f"control_rate = {1 / PERIOD}", f"control_rate = {1 / FAST}")
    found = _run(text + f"[axes]\nsetpoint = [{10.5 * COUNT}]\n")
    assert found["limit_cycle_amplitude"][0] == pytest.approx(amplitude, rel=0.1)
    assert found["limit_cycle_frequency"][0] == pytest.approx(crossing, rel=0.07)


def _slow(most, fastest, seconds, *, kp=100.0, kd=20.0, setpoint=1.0):
    """1 kg under PD with a limit of the force [N] and of its change [N/s]; positions at 1 kHz."""
    position = velocity = force = 0.0
    positions = []
    for _ in range(round(1000 * seconds)):
        asked = kp * (setpoint - position) - kd * velocity
        force = np.clip(asked, force - 1e-3 * fastest, force + 1e-3 * fastest)
        force = np.clip(force, -most, most)
        position += 1e-3 * velocity + 0.5e-6 * force
        velocity += 1e-3 * force
        positions.append(position)
    return np.array(positions)


@pytest.mark.exhaustive
@pytest.mark.parametrize("seconds", [2.0, 4.0])
def test_a_motion_too_slow_to_turn_is_judged_by_where_it_goes(seconds):
    """A force limit lets a step arrive, be it after the rollout; a limit of its change loses it."""
    limits = np.array([0.1, 0.4, np.inf])
    text = f"""
        precision = "float64"
        duration = {seconds}
        [parameters]
        mass = 1.0
        kp = 100.0
        kd = 20.0
        setpoint = 1.0
        [axes]
        force_limit = {limits.tolist()}
        force_rate_limit = [1.0, inf]
    """
    verdict = _run(text)["verdict"]
    farthest = np.array([
        [np.abs(_slow(most, fastest, 60.0)[-20000:] - 1.0).max() for fastest in (1.0, np.inf)]
        for most in limits
    ])  # fmt: skip
    assert (farthest[:, 1] < 0.6).all() and (farthest[1:, 0] > 2.0).all()
    assert (verdict[farthest < 1.0] == Verdict.STABLE).all()
    if seconds > 2.0:
        # Until then the step is on its way.
        assert (verdict[farthest > 2.0] == Verdict.UNSTABLE).all()


def test_a_damped_joint_is_not_lost_behind_a_limited_force():
    inertia, damping, stiffness, force = 0.08531, 0.1357, 9.21, 110.0
    loop = jx.joint(
        inertia=inertia, joint_damping=damping, joint_stiffness=stiffness, wn=295.7, zeta=0.816,
        kp=779.2, kd=6.465, delay=4.4e-3, control_rate=500, force_limit=force,
    )  # fmt: skip
    # The largest motion that forces within +-F make: F times the integral of |impulse response|.
    wn = np.sqrt(stiffness / inertia)
    zeta = damping / (2.0 * inertia * wn)
    angle = np.pi * zeta / np.sqrt(1.0 - zeta**2)
    farthest = force / stiffness / np.tanh(0.5 * angle)
    runs = [jx.simulate(loop, setpoint=0.1, duration=duration) for duration in (2.0, 8.0)]
    assert float(runs[0].growth_rate) > 0.0
    for run in runs:
        assert int(run.verdict) == Verdict.LIMIT_CYCLE
        assert 2.0 < float(run.limit_cycle_amplitude) < farthest
    assert "still getting wider" in runs[0].report
    assert "still getting wider" not in runs[1].report
    # Without the spring its velocity stays within F / c, and its controller brings it back.
    rolls = loop.replace(joint_stiffness=0.0, kd=4.0)
    for duration in (1.0, 5.0):
        run = jx.simulate(rolls, setpoint=0.1, duration=duration)
        assert int(run.verdict) == Verdict.LIMIT_CYCLE
        assert float(np.abs(run.velocity).max()) < force / damping
    # By itself it topples: beyond what the limit can hold nothing brings it back.
    topples = loop.replace(joint_stiffness=-stiffness)
    assert int(jx.simulate(topples, setpoint=0.1, duration=2.0).verdict) == Verdict.UNSTABLE


def test_starts_that_still_grow_within_a_cycle_are_on_their_way_to_it_behind_a_line_too():
    loop = jx.joint(
        mass=0.7, wn=110.0, zeta=0.9, joint_stiffness=300.0, kd=60.0, stall_force=40.0,
        no_load_speed=4.0, velocity_resolution=1e-3,
    )  # fmt: skip
    found = jx.sweep(loop, kp=[1840.0, 2200.0, 3000.0, 5000.0], duration=2.0)
    assert (found.verdict.values == Verdict.LIMIT_CYCLE).all()
    # From small steps in C, written apart, over 60 s.
    apart = [4.29e-3, 6.07e-3, 13.3e-3, 36.5e-3]
    assert found.limit_cycle_amplitude.values == pytest.approx(apart, rel=0.02)


@pytest.mark.exhaustive
def test_a_motor_on_a_force_speed_line_drives_no_mass_faster_than_the_line_allows():
    loop = jx.joint(mass=0.7, kp=4000.0, kd=5.0, delay=4e-3, stall_force=40.0, no_load_speed=4.0)
    for duration in (0.3, 4.0):
        run = jx.simulate(loop, setpoint=0.01, duration=duration)
        assert float(run.growth_rate) > 0.0 and int(run.verdict) == Verdict.LIMIT_CYCLE
        assert float(np.abs(run.velocity).max()) < 4.0 * (1.0 + 1e-6)


@pytest.mark.exhaustive
def test_a_creep_that_has_not_turned_is_said_not_to_be_known():
    loop = jx.joint(
        mass=0.7, joint_damping=5.0, stall_force=10.0, no_load_speed=0.3, kp=67.2574, kd=38.1111,
        velocity_resolution=0.01, delay=1e-3,
    )  # fmt: skip
    # It comes to rest, which a simulation in small steps, written apart, shows.
    short, long = (jx.simulate(loop, setpoint=0.1, duration=duration) for duration in (2.0, 5.0))
    assert "may yet" in short.report
    assert int(long.verdict) == Verdict.STABLE and "may yet" not in long.report


@pytest.mark.exhaustive
def test_a_map_of_quantised_loops_is_the_same_for_every_setpoint():
    axes = """
[axes]
setpoint = [0.0, 0.01, 0.1, 1.0]
kp = { min = 5, max = 400, num = 10, spacing = "log" }
kd = { min = 0.1, max = 8, num = 10, spacing = "log" }
"""
    found = _run(MOTOR.replace('"float64"', '"float32"') + axes)
    verdict, growth = found["verdict"], found["growth_rate"]
    assert (verdict == verdict[:1]).all()
    assert (verdict[growth >= 0.0] == Verdict.UNSTABLE).all()
    # A bare mass never rests between two counts of an encoder that is its only sensor; what decays
    # in more than the simulated time has not come there.
    assert (verdict[growth < -1.0] == Verdict.LIMIT_CYCLE).all()


JOINT = """
precision = "float64"
duration = 2.0
[parameters]
actuator = "hyq"
delay = 0.001
"""
LOOPS = {
    "an encoder that is fine for the loop, and a sensor of velocity": (
        "position_resolution = 1e-5\ncontrol_rate = 4000\nkp = 100", Verdict.STABLE,
    ),
    "the same, with a coarse D/A converter": ("command_resolution = 2", Verdict.LIMIT_CYCLE),
    "noise alone": ("position_noise = 1e-4\nvelocity_noise = 0.01", Verdict.STABLE),
    "noise, and gains that are too high": ("velocity_noise = 0.01\nkd = 900", Verdict.UNSTABLE),
    "noise far above the count of its encoder": (
        "position_noise = 1e-3\nposition_resolution = 1e-5", Verdict.STABLE,
    ),
    "noise far below the step of its converter": (
        "position_noise = 1e-6\ncommand_resolution = 2", Verdict.LIMIT_CYCLE,
    ),
    "limits that are never reached": ("force_limit = 1e6", Verdict.STABLE),
    "limits that bound what grows": ("force_limit = 20\nkd = 900", Verdict.LIMIT_CYCLE),
}  # fmt: skip


@pytest.mark.exhaustive
@pytest.mark.parametrize("case", LOOPS)
def test_one_verdict_for_steps_over_four_orders_of_magnitude(case):
    drive, verdict = LOOPS[case]
    found = _run(JOINT + drive + "\n[axes]\nsetpoint = [0.0, 1e-3, 0.0317, 0.5]\n")
    assert (found["verdict"] == verdict).all()


def _shaped(**rows):
    return {name: jnp.asarray(value, float) for name, value in rows.items()}


def _of(
    amplitudes, growth, count=1e-3, farthest=1e-2, frequency=10.0, plant=True, leaving=True,
    span=1e-2, held=False, rubs=None,
):  # fmt: skip
    motion = Motion(
        **_shaped(amplitude=amplitudes, frequency=frequency, farthest=farthest, span=span),
        turning=jnp.asarray(np.isfinite(frequency)),
        leaving=jnp.asarray(leaving),
        valid=jnp.asarray(True),
    )
    flags = {"bounded": held, "held": held, "plant_linear": plant}
    flags["rubs"] = not plant if rubs is None else rubs
    flags |= {"linear": False, "unlimited": False}
    flags = {name: jnp.asarray(flag) for name, flag in flags.items()}
    scale = Scale(**_shaped(count=count, rest=0.01 * count, floor=0.0, limit=0.0), **flags)
    return verdicts.of_motion(motion, scale, jnp.asarray(growth), jnp.asarray(0.5)), scale


def test_what_a_motion_that_remains_means():
    def verdict(*amplitudes, growth=-1.0, **more):
        return int(_of([1e-2, *amplitudes], growth, **more)[0].verdict)

    assert verdict(1e-3, 1e-3, 1e-3) == Verdict.LIMIT_CYCLE
    assert verdict(1e-3, 1e-4, 1e-5) == Verdict.STABLE  # a hundredth of a count
    assert verdict(1e-2, 6e-3, 3.6e-3) == Verdict.STABLE  # exp(-0.5) = 0.61 a segment
    assert verdict(4e-3, 6e-3, 3.6e-3) == Verdict.LIMIT_CYCLE  # smaller only now
    assert verdict(1e-6, 1e-6, 1e-6, growth=1.0) == Verdict.UNSTABLE  # has not grown yet
    assert verdict(1e-3, 2e-3, 4e-3, growth=1.0) == Verdict.UNSTABLE
    assert verdict(1e-3, 2e-3, 4e-3, growth=1.0, held=True) == Verdict.LIMIT_CYCLE  # on its way
    assert verdict(1e-6, 1e-6, 1e-6, growth=1.0, held=True) == Verdict.UNSTABLE
    assert verdict(1e-3, 1e-3, 1e-3, growth=1.0) == Verdict.LIMIT_CYCLE
    assert verdict(1e-3, 1e-3, 1e-3, farthest=1e2) == Verdict.UNSTABLE
    # Friction ends what grows once it moves further: no cycle, and not stable either.
    still = {"frequency": np.nan, "count": 0.0, "growth": 1.0}
    assert verdict(1e-1, 5e-2, 4e-3, plant=False, **still) == Verdict.UNSTABLE
    assert verdict(1e-1, 5e-2, 4e-3, plant=True, **still) == Verdict.LIMIT_CYCLE
    assert verdict(1e-1, 5e-2, 4e-2, plant=False, **still) == Verdict.UNSTABLE
    assert verdict(1e-1, 5e-2, 5e-2, plant=False, **still) == Verdict.LIMIT_CYCLE
    slow = still | {"growth": -0.3}  # creeps home
    assert verdict(0.1, 0.099, 0.098, plant=False, **slow) == Verdict.STABLE
    assert verdict(0.1, 0.03, 0.04, plant=False, **slow) == Verdict.STABLE  # too slow to be seen
    assert verdict(0.1, 0.2, 0.4, plant=False, **slow) == Verdict.UNSTABLE
    # Sped up by what brings it back.
    assert verdict(0.1, 0.2, 0.4, plant=False, leaving=False, **slow) == Verdict.STABLE
    # With an encoder too: it has not turned, within a count of it or not.
    counted = {"frequency": np.nan, "growth": -0.3, "leaving": False}
    assert verdict(6e-4, 5.9e-4, 5.85e-4, plant=False, **counted) == Verdict.STABLE
    assert verdict(6e-4, 5.9e-4, 5.9e-4, plant=False, **counted) == Verdict.STABLE
    assert verdict(6e-3, 5.9e-3, 5.85e-3, plant=False, **counted) == Verdict.STABLE
    assert verdict(6e-3, 5e-3, 5.2e-3, plant=False, **counted) == Verdict.STABLE
    counted["growth"] = 0.3
    assert verdict(6e-3, 5e-3, 5.2e-3, plant=False, **counted) == Verdict.LIMIT_CYCLE
    turning = still | {"frequency": 20.0}
    assert verdict(0.192, 0.177, 0.148, plant=False, **turning) == Verdict.UNSTABLE
    assert verdict(0.3, 0.2, 0.15, plant=False, **turning) == Verdict.LIMIT_CYCLE  # slows down
    assert verdict(1e-3, 1e-3, 1e-3, growth=np.nan) == Verdict.INVALID


def _joints(amplitudes, growth, *, rubs, count=0.0):
    """What came of one start of a robot's two joints that turn, of which each row is a segment."""
    loop = {"frequency": np.full(2, 35.0), "span": np.full(2, 0.4), "plant": False, "count": count}
    return _of(amplitudes, growth, farthest=np.full(2, 1.5), rubs=rubs, **loop)[0]


def test_only_friction_ends_what_would_grow_and_only_where_no_joint_keeps_going():
    ended = [[0.4, 0.2], [0.192, 0.096], [0.177, 0.088], [0.148, 0.074]]
    assert _joints(ended, 1.0, rubs=True).verdict.tolist() == [Verdict.UNSTABLE] * 2
    assert not _joints(ended, 1.0, rubs=True).moving.any()
    # Counts are nothing in a motion so large, but may keep up a small one.
    assert not _joints(ended, 1.0, rubs=True, count=0.01).moving.any()
    assert _joints(ended, 1.0, rubs=True, count=0.1).moving.all()
    going = _joints(ended, 1.0, rubs=False)
    assert going.verdict.tolist() == [Verdict.LIMIT_CYCLE] * 2
    assert going.moving.all() and going.narrowing.all()
    # Down to a cycle of 0.361 and 0.953, by beats: it would take longer than was seen to end.
    down = [[0.422, 0.907], [0.493, 1.131], [0.464, 1.098], [0.424, 1.043]]
    for rubs in (True, False):
        assert _joints(down, 2.8, rubs=rubs).verdict.tolist() == [Verdict.LIMIT_CYCLE] * 2
    # One joint gets smaller, the other keeps going.
    one = [[0.4, 0.9], [0.192, 1.0], [0.177, 1.0], [0.148, 1.0]]
    found = _joints(one, 10.0, rubs=True)
    assert found.verdict.tolist() == [Verdict.LIMIT_CYCLE] * 2
    assert found.narrowing.tolist() == [True, False]


def test_a_joint_that_rests_in_a_start_that_cycles_does_not_make_it_grow():
    rows = _joints([[0.4, 1e-3], [0.4, 0.0], [0.4, 0.0], [0.4, 0.0]], 1.0, rubs=True)
    assert rows.verdict.tolist() == [Verdict.LIMIT_CYCLE, Verdict.UNSTABLE]
    assert int(starts.of_joints(rows).verdict) == Verdict.LIMIT_CYCLE
    still = _joints([[1e-3] * 2, [0.0] * 2, [0.0] * 2, [0.0] * 2], 1.0, rubs=True)
    assert int(starts.of_joints(still).verdict) == Verdict.UNSTABLE


def test_the_worst_start_counts():
    rest, scale = _of([1e-2, 1e-4, 1e-5, 1e-6], -1.0)
    small, _ = _of([1e-3] * 4, -1.0)
    large, _ = _of([5e-3] * 4, -1.0)

    def stack(*rows: Judgement):
        leaves = zip(*(vars(row).values() for row in rows), strict=True)
        names = Judgement.__dataclass_fields__
        return Judgement(**{n: jnp.stack(leaf) for n, leaf in zip(names, leaves, strict=True)})

    def worst(own, *others):
        found = verdicts.together(own, stack(*others), scale)
        return int(found.verdict), float(found.amplitude)

    assert worst(rest, rest, rest) == (Verdict.STABLE, pytest.approx(1e-6))
    assert worst(rest, small, large) == (Verdict.LIMIT_CYCLE, pytest.approx(5e-3))
    # Its own motion is what is measured where it goes on; within a count, the others decide.
    assert worst(large, rest, small) == (Verdict.LIMIT_CYCLE, pytest.approx(5e-3))
    assert worst(small, rest, rest)[0] == Verdict.STABLE
    # Nothing has moved a loop that grows from rest: the others say what it would become.
    still, _ = _of([0.0] * 4, 1.0)
    cycling, _ = _of([5e-3] * 4, 1.0)
    assert int(still.verdict) == Verdict.UNSTABLE
    assert worst(still, still, still)[0] == Verdict.UNSTABLE
    assert worst(still, cycling, still)[0] == Verdict.LIMIT_CYCLE
    assert worst(still, cycling, cycling) == (Verdict.LIMIT_CYCLE, pytest.approx(5e-3))
    # What moves within a count does not say what it would become.
    tremble, _ = _of([1e-3] * 4, 1.0)
    assert worst(tremble, still, still)[0] == Verdict.UNSTABLE


def test_a_start_that_grows_within_a_robots_cycle_is_on_its_way_there():
    def verdict(own, *other):
        loop = {"growth": 3.0, "plant": False, "farthest": 0.6}
        mine, scale = _of(own, **loop)
        others = jax.tree.map(lambda leaf: leaf[None], _of(other, **loop)[0])
        return int(verdicts.together(mine, others, scale).verdict)

    grows = 0.15, 0.2, 0.25, 0.3
    assert verdict([0.29, 0.38, 0.425, 0.445], *grows) == Verdict.LIMIT_CYCLE
    # That one gets wider itself, as one may that is not bounded; or the other is beyond it.
    assert verdict([0.30, 0.35, 0.38, 0.416], *grows) == Verdict.UNSTABLE
    assert verdict([0.28, 0.28, 0.28, 0.28], *grows) == Verdict.UNSTABLE


def test_a_start_that_has_diverged_is_unstable_whatever_its_numbers_look_like():
    """A kicked robot of two joints beyond 1e20 rad before a quarter of the time is over."""
    still, scale = _of([1e-9] * 4, 15.0, count=0.0, plant=False, span=0.0, farthest=1e-9)
    far = {"growth": 15.0, "count": 0.0, "plant": False, "span": 0.0, "frequency": np.nan}
    halved = _of([2.3e20, 6.7e20, 3.9e20, 2.3e20], farthest=3.0e21, **far)[0]
    level = _of([9.4e20, 3.9e21, 4.0e21, 4.0e21], farthest=2.6e22, **far)[0]
    assert [int(one.verdict) for one in (halved, level)] == [Verdict.UNSTABLE] * 2
    dying = _of([2e-3, 4e19, 3e20, 1e20], farthest=1e21, **far)[0]
    for start in (halved, level, dying):
        others = jax.tree.map(lambda leaf: leaf[None], start)
        assert int(verdicts.together(still, others, scale).verdict) == Verdict.UNSTABLE
        # A start that shakes only does not hide the one that has diverged.
        shaking = _of([0.1] * 4, farthest=0.1, **far | {"frequency": 10.0})[0]
        assert int(shaking.verdict) == Verdict.LIMIT_CYCLE
        others = jax.tree.map(lambda *rows: jnp.stack(rows), shaking, start)
        assert int(verdicts.together(still, others, scale).verdict) == Verdict.UNSTABLE
    # A fall from rest is no divergence.
    fallen = _of([0.5, 1.5, 0.2, 1e-3], farthest=2.0, **far)[0]
    assert int(fallen.verdict) == Verdict.UNSTABLE and not bool(fallen.moving)


# A leg on a vertical rail whose foot, with an elliptic cone and an unfinished solver, holds it up.
LEG = """<mujoco>
<option timestep="0.0005" cone="elliptic" solver="CG" impratio="10" iterations="50"/>
<worldbody><geom type="plane" size="5 5 1"/>
  <body pos="0 0 0.62"><joint name="z" type="slide" axis="0 0 1"/>
    <geom size="0.1" mass="3" contype="0" conaffinity="0"/>
    <body><joint name="a" axis="0 1 0" armature="0.01" damping="0.05"/>
      <geom type="capsule" fromto="0 0 0 0.1 0 -0.28" size="0.02" mass="0.3" contype="0"
            conaffinity="0"/>
      <body pos="0.1 0 -0.28"><joint name="b" axis="0 1 0" armature="0.01"/>
        <geom type="capsule" fromto="0 0 0 -0.1 0 -0.28" size="0.02" mass="0.2" contype="0"
              conaffinity="0"/>
        <geom pos="-0.1 0 -0.28" size="0.03" mass="0.05"/></body></body></body></worldbody>
<actuator><position joint="a" kp="600" kv="15"/><position joint="b" kp="400" kv="10"/></actuator>
</mujoco>"""


def _kicked(posture, force):
    """Largest deviation of the leg's joints [rad] in a second after a kick; C MuJoCo alone."""
    model = mujoco.MjModel.from_xml_string(LEG)
    off = mujoco.mjtDisableBit.mjDSBL_ACTUATION | mujoco.mjtDisableBit.mjDSBL_AUTORESET
    model.opt.disableflags |= int(off)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[1:] = posture, [0.1, -0.1]
    kp, kd, waiting, most = np.array([600, 400]), np.array([15, 10]), [force] * 5, 0.0
    for _ in range(1000):
        away = data.qpos[1:] - posture[1:]
        waiting.append(force - kp * away - kd * data.qvel[1:])
        for share in (0, 1):  # 4.5 ms are four periods and a half
            data.qfrc_applied[1:] = waiting[share]
            mujoco.mj_step(model, data)
        waiting.pop(0)
        most = max(most, float(np.abs(data.qpos[1:] - posture[1:]).max()))
        if most > 1e6:
            break
    return most


@pytest.mark.exhaustive
def test_a_robot_that_c_mujoco_throws_out_of_the_world_is_not_called_bounded(tmp_path):
    path = tmp_path / "leg.xml"
    path.write_text(LEG)
    leg = jx.robot(path, delay=[0.0, 4.5e-3])
    found = jx.sweep(leg, duration=1.0, engine="mujoco")
    scene = robots.scene(leg[1].kind.plant)
    assert _kicked(scene.posture.qpos, scene.posture.force) > 1e6
    assert found.verdict.values.tolist() == [Verdict.STABLE, Verdict.UNSTABLE]
    assert np.isnan(found.limit_cycle_amplitude.values[1])
    run = jx.simulate(leg[1], duration=1.0, engine="mujoco")
    assert int(run.verdict) == Verdict.UNSTABLE and "stays bounded" not in run.report


def test_a_fall_counts_where_it_is_the_loops_own_and_nothing_shakes():
    rest, scale = _of([1e-2, 1e-4, 1e-5, 1e-6], -1.0, plant=False)
    rolling, _ = _of([1e-1, 1e-1, 1e-1, 2e-1], -1.0, plant=False, frequency=np.nan)
    shaking, _ = _of([1e-1] * 4, -1.0, plant=False)
    assert int(shaking.verdict) == Verdict.LIMIT_CYCLE
    fell = [verdicts.of_fallen(one, jnp.asarray(True), jnp.asarray(-1.0))
            for one in (rest, rolling, shaking)]  # fmt: skip
    assert [int(one.verdict) for one in fell] == [4, 4, Verdict.LIMIT_CYCLE]
    assert not fell[1].moving and fell[2].moving
    growing, _ = _of([1e-1, 1e-1, 1e-1, 2e-1], 1.0, plant=False, frequency=np.nan)
    grown = verdicts.of_fallen(growing, jnp.asarray(True), jnp.asarray(1.0))
    assert int(grown.verdict) == int(growing.verdict) != Verdict.TOPPLES  # it fell of that
    stood = verdicts.of_fallen(rest, jnp.asarray(False), jnp.asarray(-1.0))
    assert int(stood.verdict) == Verdict.STABLE
    others = jax.tree.map(lambda leaf: leaf[None], fell[1])
    assert int(verdicts.together(rest, others, scale).verdict) == Verdict.STABLE
    assert int(verdicts.together(fell[0], others, scale).verdict) == Verdict.TOPPLES
    codes = jnp.array([[0, 4, 0], [4, 1, 0], [4, 2, 3], [0, 0, 1]])
    assert verdicts.worst(codes, axis=1).tolist() == [4, 1, 3, 1]


def test_counts_are_felt_as_positions():
    drive = Drive(
        Controller(jnp.array([100.0, 100.0, 0.0]), 5.0, command_resolution=0.2),
        sensor=Sensor(position_resolution=jnp.array([1e-4, 1e-2, 1e-4]), velocity_resolution=0.1),
    )
    np.testing.assert_allclose(scales.count(drive), [5e-3, 1e-2, 1e-4], rtol=1e-6)


@pytest.mark.exhaustive
def test_the_frequency_of_several_joints_is_that_of_the_largest_limit_cycle():
    def figures(verdict):
        given = {name: jnp.zeros((1, 3)) for name in Metrics.__dataclass_fields__}
        return Metrics(**{**given, **{
            "growth_rate": jnp.array([0.1]), "verdict": jnp.array([verdict], jnp.int8),
            "limit_cycle_amplitude": jnp.array([[0.1, 2.0, 3.0]]),
            "limit_cycle_frequency": jnp.array([[90.0, 70.0, jnp.nan]]),
        }})  # fmt: skip

    cycling = metrics.worst(figures(Verdict.LIMIT_CYCLE))
    assert cycling.limit_cycle_frequency.tolist() == [70.0]
    assert cycling.limit_cycle_amplitude.tolist() == [3.0]
    assert metrics.worst(figures(Verdict.STABLE)).limit_cycle_amplitude.tolist() == [0.0]
    fallen = metrics.worst(figures(Verdict.UNSTABLE))
    assert np.isnan([fallen.limit_cycle_amplitude[0], fallen.limit_cycle_frequency[0]]).all()


def test_a_robot_has_settled_when_all_of_its_joints_have_that_were_to_move():
    given = {name: jnp.zeros(3) for name in Metrics.__dataclass_fields__}
    given |= {"growth_rate": jnp.asarray(-1.0), "verdict": jnp.asarray(0, jnp.int8)}
    nan = jnp.nan
    moved = {"overshoot": jnp.array([0.1, nan, 0.2]), "rise_time": jnp.array([0.1, nan, 0.3])}
    never = Metrics(**given | moved | {"settling_time": jnp.array([0.4, nan, nan])})
    found = metrics.worst(never)
    assert np.isnan(found.settling_time) and float(found.rise_time) == pytest.approx(0.3)
    settled = replace(never, settling_time=jnp.array([0.4, nan, 0.2]))
    assert float(metrics.worst(settled).settling_time) == pytest.approx(0.4)
