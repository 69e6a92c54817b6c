"""Bandwidth: of joints with a spring, and of sampled loops, against responses of our own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.analysis.joint.frequency import JointLoop
from jaxact.analysis.sampled.period_map import SampledLoop
from jaxact.tuning.joint import noise
from jaxact.tuning.joint.ensemble import ensemble
from jaxact.tuning.joint.spectrum import log_metrics, tabulate
from jaxact.tuning.polish import Rows, polish

SPRUNG = (0.7, 110.0, 0.9, 1e-3)
W = np.geomspace(0.05, 3000.0, 4000)


def _of_grid(kp, kd, damping, stiffness):
    """Bandwidth and larger peak of every loop, on a dense axis; 0 where it follows nothing.

    An unstable one has no bandwidth: the phase of its characteristic turns by less than 2 pi.
    """
    m, wn, zeta, delay = SPRUNG
    s, kp, kd = 1j * W, kp[:, None], kd[:, None]
    plant = (1 + 2 * zeta * s / wn + (s / wn) ** 2) * (m * s * s + damping * s + stiffness)
    unit = np.exp(-s * delay) / plant
    loop = (kp + kd * s) * unit
    below = np.abs(kp * unit / (1 + loop)) < np.sqrt(0.5)
    peak = np.maximum(np.abs(1 / (1 + loop)), np.abs(loop / (1 + loop))).max(axis=1)
    first = W[np.argmax(below, axis=1)]
    turned = np.unwrap(np.angle(plant * (1 + loop)), axis=1)
    stable = np.abs(turned[:, -1] - turned[:, 0] - 2.0 * np.pi) < 1.0
    return np.where(below[:, 0] | ~stable, 0.0, first), peak


@pytest.mark.parametrize(("kp", "kd"), [(297.6, 17.66), (240.0, 17.0), (60.0, 14.0)])
def test_a_joint_that_a_spring_holds_back_has_no_bandwidth(kp, kd):
    with jax.enable_x64(True):
        joint = {"joint_damping": jnp.full(1, 2.0), "joint_stiffness": jnp.full(1, 100.0)}
        loop = JointLoop(*(jnp.full(1, value) for value in (kp, kd, *SPRUNG)), **joint)
        found = float(jax.jit(noise.bandwidth)(loop)[0])
    expected = _of_grid(np.array([kp]), np.array([kd]), 2.0, 100.0)[0][0]
    assert found == pytest.approx(expected, rel=5e-3)
    assert (found > 0.0) == (kp > 100.0 / (np.sqrt(2.0) - 1.0))


def test_what_is_missing_to_a_bandwidth_leads_the_descent():
    members = ensemble(*SPRUNG, 2.0, 100.0)
    table = jax.tree.map(lambda a: jnp.asarray(a[0]), tabulate(members, members.lag))

    def smooth(x):
        names = ("bandwidth",)
        return log_metrics(table, jnp.exp(x), 15.0, names, jnp.asarray(100.0))[0]["bandwidth"]

    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(smooth)))(
        jnp.log(jnp.geomspace(1, 235, 9))
    )
    assert (
        np.all(slopes > 0.1) and np.all(np.diff(values) > 0) and values[-1] < smooth(np.log(250.0))
    )


@pytest.mark.parametrize("velocity", ["sampled", "differenced"])
@pytest.mark.parametrize("joint", [None, (2.0, 30.0)])
def test_the_bandwidth_of_a_sampled_loop_is_that_at_its_ticks(velocity, joint):
    """With the resolvent of SciPy's matrices."""
    kp, kd, (m, wn, zeta, delay), period = 180.0, 9.0, SPRUNG, 5e-3
    c, k = joint or (0.0, 0.0)
    rate = np.zeros((5, 5))
    rate[0, 1], rate[2, 3] = 1.0, 1.0
    rate[1, :3] = -k / m, -c / m, 1.0 / m
    rate[3, 2:] = -(wn**2), -2.0 * zeta * wn, wn**2
    early, late = (scipy.linalg.expm(rate * t) for t in (delay, period - delay))
    phi, older, newer = late[:4, :4] @ early[:4, :4], late[:4, :4] @ early[:4, 4], late[:4, 4]

    def follows(w):
        z = np.exp(1j * w * period)
        state = np.linalg.solve(z * np.eye(4) - phi, newer + older / z)
        rate = state[1] if velocity == "sampled" else state[0] * (1.0 - 1.0 / z) / period
        return abs(kp * state[0] / (1.0 + kp * state[0] + kd * rate))

    with jax.enable_x64(True):
        own = (
            {}
            if joint is None
            else {"joint_damping": jnp.full(1, c), "joint_stiffness": jnp.full(1, k)}
        )
        rows = (jnp.full(1, value) for value in (kp, kd, *SPRUNG, period))
        loop = SampledLoop(*rows, jnp.full(1, np.inf), velocity=velocity, **own)
        found = float(jax.jit(noise.sampled_bandwidth)(loop)[0])
    assert 5.0 < found < np.pi / period
    assert follows(found) == pytest.approx(np.sqrt(0.5), rel=1e-9)
    assert all(follows(w) > np.sqrt(0.5) for w in np.geomspace(1e-2, 0.999 * found, 200))


def test_where_nothing_is_worth_anything_the_polish_stays():
    def rows(x):
        worth = np.where(x[:, :1] > 1.0, x[:, :1], -np.inf)
        slope = np.where(np.isfinite(worth)[..., None], [[[1.0, 0.0]]], np.nan)
        excess = x[:, 1:] - 2.0
        return Rows(worth, slope, excess, np.array([[[0.0, 1.0]]]), np.ones(len(x), bool))

    bounds = np.array([[-3.0, -3.0]]), np.array([[3.0, 3.0]])
    for start in ([0.9, 0.0], [0.9999, 0.0], [1.5, 2.5]):
        found = polish(rows, np.array([start]), *bounds)
        assert found.feasible[0] and found.value[0] in (-np.inf, 3.0)


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("damping", "stiffness", "peak", "start"),
    [(5.0, 300.0, 1.6, {}), (2.0, 100.0, 1.8, {}), (2.0, 100.0, 1.8, {"kp": 300.0, "kd": 15.0})],
)
def test_the_widest_bandwidth_of_a_sprung_joint_is_that_of_a_grid(damping, stiffness, peak, start):
    loop = jx.joint(
        mass=0.7, actuator="starleth", delay=1e-3, joint_stiffness=stiffness,
        joint_damping=damping, **start,
    )  # fmt: skip
    best = jx.tune(loop, "bandwidth", max_peak=peak)
    kp, kd = np.meshgrid(np.geomspace(0.01, 2000.0, 60), np.geomspace(2.0, 40.0, 40))
    width, peaks = _of_grid(kp.ravel(), kd.ravel(), damping, stiffness)
    most = width[peaks <= peak].max()
    if stiffness == 300.0:
        assert most == 0.0 and not best.certified and "bandwidth" in best.verdict
        return
    assert best.certified and 0.97 * most <= best.value <= 1.1 * most
    own, _ = _of_grid(np.array([best.kp]), np.array([best.kd]), damping, stiffness)
    assert best.value == pytest.approx(own[0], rel=5e-3)


@pytest.mark.parametrize("velocity", ["sampled", "differenced"])
@pytest.mark.parametrize("wn", [110.0, np.inf])
def test_the_noise_of_a_sampled_loop_solves_a_lyapunov_equation(velocity, wn):
    """States: joint and servo, commands until now, the reading before and the filtered velocity."""
    kp, kd, m, zeta, delay, period, cutoff = 300.0, 12.0, 0.7, 0.9, 6e-3, 5e-3, 150.0
    rate = np.zeros((5, 5))
    rate[0, 1], rate[1, 2] = 1.0, 1.0 / m
    if np.isinf(wn):
        rate[1, 2], rate[1, 4] = 0.0, 1.0 / m
    else:
        rate[2, 3], rate[3, 2:] = 1.0, (-(wn**2), -2.0 * zeta * wn, wn**2)
    part = delay - period
    early, late = (scipy.linalg.expm(rate * t) for t in (part, period - part))
    phi, older, newer = late[:4, :4] @ early[:4, :4], late[:4, :4] @ early[:4, 4], late[:4, 4]
    phi[2:] = 0.0 if np.isinf(wn) else phi[2:]
    pole = np.exp(-cutoff * period) if velocity == "differenced" else 0.0
    # x (4), u_{k-1}, u_{k-2}, then q_{k-1} + n_{k-1} (or n_{k-1} alone), and the filtered rate.
    full, noise_in = np.zeros((8, 8)), np.zeros(8)
    reading = np.eye(8)[0] if velocity == "differenced" else np.zeros(8)
    rate_row = pole * np.eye(8)[7] + (1.0 - pole) / period * (reading - np.eye(8)[6])
    own = rate_row + (0.0 if velocity == "differenced" else np.eye(8)[1])
    command = -(kp * np.eye(8)[0] + kd * own)
    command_noise = -(kp + kd * (1.0 - pole) / period)
    full[:4, :4] = phi
    full[:4, 4], full[:4, 5] = newer, older
    full[4], noise_in[4] = command, command_noise
    full[5, 4] = 1.0
    full[6], noise_in[6] = reading, 1.0
    full[7], noise_in[7] = rate_row, (1.0 - pole) / period
    assert np.abs(np.linalg.eigvals(full)).max() < 1.0
    covariance = np.outer(noise_in, noise_in) / 12.0
    for _ in range(30):  # of one noise, two, four, ...
        covariance, full = covariance + full @ covariance @ full.T, full @ full
    expected = np.sqrt(covariance[5, 5] if np.isinf(wn) else covariance[2, 2])
    with jax.enable_x64(True):
        rows = (jnp.full(1, value) for value in (kp, kd, m, wn, zeta, delay, period, cutoff))
        found = jax.jit(noise.sampled_noise_gain)(SampledLoop(*rows, velocity=velocity))
    assert float(found[0]) == pytest.approx(expected, rel=2e-4)
