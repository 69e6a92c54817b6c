"""Roots that grow: computed, also from powers, and where they begin to."""

import numpy as np
import pytest

import jaxact as jx
from jaxact.analysis.robot import stability
from jaxact.analysis.robot.modes import shaking, swinging, toppling


def _of_radius(rng, size, radius):
    """A matrix that is far from normal, of states in very different units."""
    M = np.triu(rng.normal(size=(size, size))) + 0.1 * rng.normal(size=(size, size))
    M *= radius / np.abs(np.linalg.eigvals(M)).max()
    scale = 10.0 ** rng.uniform(-3.0, 3.0, size)
    return M * scale[:, None] / scale


@pytest.mark.parametrize("size", [1, 5, 30])
def test_what_grows_is_told_from_what_decays(size):
    rng = np.random.default_rng(size)
    for _ in range(50):
        inside, outside = _of_radius(rng, size, 1.0 - 1e-7), _of_radius(rng, size, 1.0 + 1e-7)
        assert stability.excess(inside) < 0.0 < stability.excess(outside)


def _of_roots(rng, pairs, ahead):
    """A matrix with complex pairs of roots and a line of delays, mixed, in different units."""
    size = 2 * len(pairs) + ahead
    M = np.diag(np.ones(size - 1), 1)
    for place, root in zip(range(0, size, 2), pairs, strict=False):
        M[place : place + 2] = 0.0
        M[place : place + 2, place : place + 2] = [
            [root.real, root.imag], [-root.imag, root.real]
        ]  # fmt: skip
        if ahead:
            M[place : place + 2, -1] = rng.normal(size=2)
    Q, _ = np.linalg.qr(rng.normal(size=(size, size)))
    scale = 10.0 ** rng.uniform(-3.0, 3.0, size)
    return (Q @ M @ Q.T) * scale[:, None] / scale


@pytest.mark.parametrize(("slow", "ahead"), [(5, 60), (12, 36), (15, 20), (20, 0), (0, 40)])
@pytest.mark.parametrize("radius", [0.9, 1.0 - 1e-8, 1.0 + 1e-8, 1.02, 30.0])
def test_the_largest_root_is_found_among_slow_motions_fast_ones_and_delays(slow, ahead, radius):
    rng = np.random.default_rng(slow)
    others = rng.uniform(0.97, 0.9999, slow) * np.exp(1j * rng.uniform(0.0, 0.5, slow))
    fast = 0.5 * np.exp(1j * rng.uniform(0.0, 3.0, 6))
    roots = np.array([*others, *fast])
    roots = np.concatenate([roots[np.abs(roots) < radius], [radius * np.exp(0.1j)]])
    M = _of_roots(rng, roots, ahead)
    expected = radius - 1.0 - stability.MARGINAL
    assert stability.excess(M) == pytest.approx(expected, abs=1e-10 * radius)


def _delayed_oscillator(ahead, gain):
    """A motion whose velocity is in units a million times too small, fed back after a delay."""
    M = np.diag(np.ones(ahead + 1), 1)
    turn = np.array([[1.0, 1e-3], [-40.0, 0.8]])
    M[:2, :2], M[1, 2] = turn, 1e3
    M[-1] = 0.0
    M[-1, :2] = -gain * np.array([1e-2, 1e-6])
    return M


@pytest.mark.parametrize("ahead", [6, 30])
@pytest.mark.parametrize("gain", [0.1, 1.0, 3.0, 4.0, 8.0])
def test_motions_that_are_slow_are_told_apart_beside_powers_that_grow_at_first(gain, ahead):
    M = _delayed_oscillator(ahead, gain)
    inside = np.abs(np.linalg.eigvals(M)).max() < 1.0
    assert (stability.excess(M) < 0.0) == inside
    slow = np.zeros((len(M) + 1,) * 2)
    slow[:-1, :-1], slow[-1, -1] = M, 1.0 - 1e-6
    assert (stability.excess(slow) < 0.0) == inside
    slow[-1, -1] = 1.0 + 1e-8
    assert stability.excess(slow) > 0.0


def test_motions_that_grow_much_before_they_are_gone_hide_no_slow_one():
    """As large as a million, and as good as gone after a hundred periods."""
    rng = np.random.default_rng(3)
    for radius in (1.0 - 1e-8, 1.0 + 1e-8):
        M = np.diag([radius, *np.full(29, 0.5)]) + 1.2 * np.triu(rng.normal(size=(30, 30)), 1)
        # Coupled so little that rounding of the matrix moves its root by less than 1e-8.
        M[0, 1:] *= 1e-12
        power, largest = M, 0.0
        for _ in range(7):
            largest, power = max(largest, np.abs(power).max()), power @ power
        assert largest > 1e6
        Q, _ = np.linalg.qr(rng.normal(size=M.shape))
        expected = radius - 1.0 - stability.MARGINAL
        assert np.sign(stability.excess(Q @ M @ Q.T)) == np.sign(expected)


def test_what_is_not_a_number_grows_and_what_is_gone_at_once_does_not():
    line = np.diag(np.ones(39), 1)
    assert stability.excess(line) == stability.excess(np.zeros((40, 40))) == -1.0
    with pytest.raises(np.linalg.LinAlgError):
        stability.excess(np.full((40, 40), np.nan))


def test_only_roots_that_count_grow():
    turn = 1.01 * np.array([[np.cos(0.2), -np.sin(0.2)], [np.sin(0.2), np.cos(0.2)]])
    M = np.zeros((3, 3))
    M[:2, :2], M[2, 2] = turn, 1.02
    beyond = np.array([0.01, 0.02]) - stability.MARGINAL
    assert stability.excess(M, shaking) == pytest.approx(beyond[0], rel=1e-9)
    assert stability.excess(M, toppling) == pytest.approx(beyond[1], rel=1e-9)
    assert stability.excess(M) == pytest.approx(beyond[1], rel=1e-9)
    still = np.eye(1) * (1.0 + 1e-6)
    assert stability.excess(still) > 0.0
    assert stability.excess(still, stability.moving) == -1.0


@pytest.mark.parametrize("at", [1e-6, 0.3, 7.0])
def test_where_a_root_begins_to_grow_is_found_to_rounding(at):
    def growth(value):
        return stability.excess(np.diag([0.5, (1.0 + stability.MARGINAL) * (value / at) ** 3]))

    assert stability.switch(growth, 0.1 * at, 3.0 * at) == pytest.approx(at, rel=1e-12)
    assert stability.switch(lambda value: -growth(value), 0.1 * at, 3.0 * at) == pytest.approx(at)
    assert stability.switch(growth, 0.1 * at, 0.2 * at) == 0.2 * at  # it does not change


def test_what_grows_there_and_back_from_tick_to_tick_shakes_however_fast():
    """|Im s| of a sampled motion ends at pi / T, its growth does not."""
    there_and_back = np.array([-1.1, -22.0, -40.0, -1e5, -30.0 + 1.0j])
    assert swinging(there_and_back).all()
    assert not swinging(np.array([1.1, 40.0, 1e5, 30.0 + 1.0j])).any()


def test_a_light_joint_with_too_much_damping_shakes_and_does_not_topple(tmp_path):
    """A hinge of 1e-3 kg m^2 in the void: nothing there could topple."""
    step, inertia, kp, kd = 1e-3, 1e-3, 500.0, 40.0
    (tmp_path / "hinge.xml").write_text(
        f"""<mujoco><option timestep="{step}" gravity="0 0 0"/><worldbody><body>
        <joint name="j" axis="0 1 0"/><inertial pos="0 0 0" mass="1"
        diaginertia="{inertia} {inertia} {inertia}"/></body></worldbody>
        <actuator><position joint="j" kp="{kp}" kv="{kd}"/></actuator></mujoco>"""
    )

    def largest(scale):
        """Root of one semi-implicit Euler step with the force held, the largest."""
        gain, damping = scale * step * kp / inertia, scale * step * kd / inertia
        roots = np.linalg.eigvals([[1 - step * gain, step * (1 - damping)], [-gain, 1 - damping]])
        return roots[np.argmax(np.abs(roots))]

    found = jx.margins(jx.robot(tmp_path / "hinge.xml", control_rate=1 / step))
    assert largest(1.0) < -np.exp(np.pi)
    assert found.verdict == "shakes" and found.toppling_rate < 0.0
    assert found.growth_rate == pytest.approx(np.log(abs(largest(1.0))) / step, rel=1e-6)
