"""Loops with roots on the imaginary axis or the unit circle are not stable, held against NumPy and
SciPy."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.analysis.sampled.period_map import SampledLoop
from jaxact.analysis.sampled.roots import spectral_radius

MASS, WN, ZETA = 0.7, 800.0, 0.45
EDGE = 1e-9
PERIOD = 1e-3
LOOPS = [
    {"kp": 0, "kd": 0},
    {"kp": 0, "kd": 5},
    {"kp": 0, "kd": -5},
    {"kp": 400, "kd": 0},
    {"kp": 0, "kd": 0, "joint_damping": 3},
    {"kp": 0, "kd": 0, "joint_stiffness": 3},
    {"kp": 0, "kd": 0, "joint_stiffness": 3, "joint_damping": 1},
    {"kp": 0, "kd": 0, "joint_stiffness": -3},
    {"kp": 400, "kd": 0, "joint_stiffness": 100},
    {"kp": 400, "kd": 0, "joint_stiffness": 1000},
    {"kp": 400, "kd": 0, "joint_stiffness": -100},
    {"kp": 100, "kd": 0, "joint_stiffness": -100},
    {"kp": 100, "kd": 5, "joint_stiffness": -100},
    {"kp": 100, "kd": -5, "joint_stiffness": -100},
]


def poles(kp, kd, joint_damping=0.0, joint_stiffness=0.0, *, servo=False):
    """Roots of (m s^2 + c s + k) D(s) + kp + kd s by NumPy."""
    denominator = [1 / WN**2, 2 * ZETA / WN, 1.0] if servo else [1.0]
    plant = np.polymul([MASS, joint_damping, joint_stiffness], denominator)
    return np.roots(np.polyadd(plant, [kd, kp]))


@pytest.fixture(scope="module")
def of_all():
    """Margins of all loops at once, continuous and sampled: fields of shape (ideal or servo, n)."""
    names = ("kp", "kd", "joint_damping", "joint_stiffness")
    given = {name: [float(one.get(name, 0)) for one in LOOPS] for name in names}
    loop = jx.joint(
        mass=MASS, wn=[[np.inf], [WN]], zeta=ZETA, control_rate=1 / PERIOD,
        **{name: np.array(row) for name, row in given.items()},
    )  # fmt: skip
    return jx.margins(loop), jx.margins(loop, sampled=True)


def one_of(found, *index):
    names = ("stable", "unstable_roots", "gain_margin", "growth_rate", "spectral_radius")
    own = {name: getattr(found, name, None) for name in names}
    return SimpleNamespace(**{name: x[index] for name, x in own.items() if x is not None})


EACH = pytest.mark.parametrize("number", range(len(LOOPS)), ids=[str(one) for one in LOOPS])
SERVO = pytest.mark.parametrize("servo", [False, True], ids=["ideal", "servo"])


@pytest.mark.exhaustive
@SERVO
@EACH
def test_roots_on_the_axis_count_as_unstable(of_all, number, servo):
    own = poles(**LOOPS[number], servo=servo)
    found = one_of(of_all[0], int(servo), number)
    assert found.unstable_roots == np.sum(own.real >= -EDGE)
    assert found.stable == (own.real.max() < -EDGE)
    assert np.isnan(found.gain_margin) != found.stable
    assert found.growth_rate == pytest.approx(own.real.max(), abs=1e-6)


def test_the_table_of_a_joint_that_nothing_holds_says_so():
    text = " ".join(str(jx.margins(jx.joint(mass=MASS, kp=0, kd=0, actuator="starleth"))).split())
    assert "unstable roots 2" in text
    assert "rightmost root 0 1/s" in text


def moduli(kp, kd, joint_damping=0.0, joint_stiffness=0.0, *, servo=False):
    """|z| of x' = F x + g u, u = -(kp q + kd v) held over a period, by SciPy."""
    size = 4 if servo else 2
    F, g, gains = np.zeros((size, size)), np.zeros((size, 1)), np.zeros((1, size))
    F[0, 1] = 1.0
    F[1, :2] = -joint_stiffness / MASS, -joint_damping / MASS
    gains[0, :2] = kp, kd
    if servo:
        F[1, 2], F[2, 3] = 1 / MASS, 1.0
        F[3, 2:] = -(WN**2), -2 * ZETA * WN
        g[3] = WN**2
    else:
        g[1] = 1 / MASS
    whole = scipy.linalg.expm(PERIOD * np.block([[F, g], [np.zeros((1, size + 1))]]))
    return np.abs(np.linalg.eigvals(whole[:size, :size] - whole[:size, size:] @ gains))


@SERVO
@EACH
def test_roots_on_the_unit_circle_count_as_unstable(of_all, number, servo):
    own = moduli(**LOOPS[number], servo=servo)
    found = one_of(of_all[1], int(servo), number)
    # Two roots at 1 are apart by the root of rounding.
    assert found.unstable_roots == np.sum(own >= 1 - 1e-7)
    assert found.stable == (own.max() < 1 - 1e-7)
    assert np.isnan(found.gain_margin) != found.stable
    assert found.spectral_radius == pytest.approx(own.max(), abs=1e-7)


@pytest.mark.exhaustive
def test_without_gains_the_radius_changes_with_the_joints_own_damping():
    def radius(damping):
        loop = SampledLoop(
            0.0, 0.0, MASS, WN, ZETA, 0.0, PERIOD, joint_stiffness=3.0, joint_damping=damping
        )
        return spectral_radius(jax.tree.map(jnp.asarray, loop), 0)

    with jax.enable_x64():
        slope = jax.jit(jax.grad(radius))(1.0)
    ends = [
        moduli(0, 0, joint_damping=c, joint_stiffness=3, servo=True).max() for c in (0.999, 1.001)
    ]
    assert slope == pytest.approx((ends[1] - ends[0]) / 0.002, rel=1e-5)
