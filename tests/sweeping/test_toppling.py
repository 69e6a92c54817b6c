"""Robots that fall and robots that shake, told apart in sweeps, stores and maps."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
import quickly
import scipy.linalg
import xarray as xr

import jaxact as jx
from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.plotting import field, panels, stability_map
from jaxact.simulation import execute
from jaxact.simulation.spectra import Rates
from jaxact.status import Verdict

PERIOD, DELAY = 1e-3, 4
KP, KD = 20.0, 0.5
# An upright pole with a wheel at its top, of which only the wheel is driven.
POLE = 0.3
WHEEL = 0.01
WEIGHT = 1.0 * 9.81 * 0.5
MODEL = f"""
<mujoco><option timestep="2e-5"/><worldbody><body>
  <joint name="pole" axis="0 1 0"/>
  <inertial pos="0 0 0.5" mass="1" diaginertia="{POLE - 0.25} {POLE - 0.25} 0.01"/>
  <body pos="0 0 1"><joint name="wheel" axis="0 1 0"/>
    <inertial pos="0 0 0" mass="1e-9" diaginertia="{WHEEL} {WHEEL} {WHEEL}"/></body>
</body></worldbody>
<actuator><position joint="wheel" kp="{KP}" kv="{KD}"/></actuator></mujoco>
"""
SCALES = [0.5, 2.0, 4.0, 8.0]
SWEEP = f"""
engine = "mujoco"
duration = 0.02
[plant]
model = "pole.xml"
[parameters]
control_rate = {1 / PERIOD}
delay = {DELAY * PERIOD}
initial_velocity = 0.01
[axes]
gain_scale = {SCALES}
"""


@pytest.fixture(autouse=True)
def quickly_compiled():
    with quickly.optimised_little():
        yield


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pole")
    (folder / "pole.xml").write_text(MODEL)
    specification = reading.parse(SWEEP, folder)
    with quickly.optimised_little():
        return execute.run(specification, expand(specification))


def _rates(scale):
    """Logarithms of the loop's roots over a period, by SciPy: z of [x, commands on their way]."""
    # Angle of the pole, angle of the wheel on it: I q'' + ... = u, with the reaction on the pole.
    inertia = np.array([[POLE + WHEEL, WHEEL], [WHEEL, WHEEL]])
    A, B = np.zeros((4, 4)), np.zeros((4, 1))
    A[:2, 2:] = np.eye(2)
    A[2:, 0] = np.linalg.solve(inertia, [WEIGHT, 0.0])
    B[2:, 0] = np.linalg.solve(inertia, [0.0, 1.0])
    held = scipy.linalg.expm(np.block([[A, B], [np.zeros((1, 5))]]) * PERIOD)
    size = 4 + DELAY
    whole = np.zeros((size, size))
    whole[:4, :4], whole[:4, 4] = held[:4, :4], held[:4, 4]
    whole[np.arange(4, size - 1), np.arange(5, size)] = 1.0
    whole[-1, [1, 3]] = -scale * KP, -scale * KD
    return np.log(np.linalg.eigvals(whole).astype(complex)) / PERIOD


@pytest.mark.exhaustive
def test_growth_and_shaking_rates_are_those_of_the_equations_of_motion(found):
    rates = [_rates(scale) for scale in SCALES]
    growth = [rate.real.max() for rate in rates]
    swings = [rate[np.abs(rate.imag) > np.abs(rate.real)].real.max() for rate in rates]
    assert min(growth) > 3.0 and min(swings) < -5.0 and max(swings) > 20.0
    np.testing.assert_allclose(found["growth_rate"], growth, rtol=0.02)
    # Without a slow motion that swings, the rate is that of one control period.
    assert swings[1] < -500.0 and found["shaking_rate"][1] == -1.0 / PERIOD
    slow = [0, 2, 3]
    np.testing.assert_allclose(found["shaking_rate"][slow], np.array(swings)[slow], rtol=0.03)


@pytest.mark.exhaustive
def test_what_falls_without_shaking_topples(found):
    shakes = found["shaking_rate"] > 0.0
    assert shakes.any() and not shakes.all()
    np.testing.assert_array_equal(found["verdict"][~shakes], Verdict.TOPPLES)
    np.testing.assert_array_equal(found["verdict"][shakes], Verdict.UNSTABLE)


def test_maps_of_robots_that_topple_show_where_they_shake():
    shaking = np.array([[-3.0, -1.0, 2.0], [-2.0, 1.0, 4.0]])
    verdict = np.where(shaking < 0.0, Verdict.TOPPLES, Verdict.UNSTABLE).astype(np.int8)
    dims = ("kp", "kd")
    data = xr.Dataset(
        {
            "growth_rate": (dims, np.maximum(shaking, 3.0)),
            "shaking_rate": (dims, shaking),
            "verdict": (dims, verdict),
        },
        {"kp": ("kp", [1.0, 2.0]), "kd": ("kd", [1.0, 2.0, 3.0])},
    )
    assert field.usual(data) == "shaking_rate"
    assert field.usual(data.drop_vars("shaking_rate")) == "growth_rate"
    figure = stability_map.stability_map(
        data, panels.arrange(data), variable=field.usual(data), linearised=True
    )
    words = {text.get_text() for text in figure.legends[0].get_texts()}
    assert {"topples", "unstable", "linearised boundary of shaking"} <= words
    (line,) = (line for line in figure.axes[0].lines if len(line.get_xdata()) > 1)
    assert np.isfinite(line.get_xdata()).any()
    plt.close(figure)


def test_what_has_fallen_and_does_not_swing_is_no_limit_cycle():
    rows = {
        "verdict": np.full(3, Verdict.LIMIT_CYCLE, np.int8),
        "limit_cycle_amplitude": np.full(3, 0.5),
        "limit_cycle_frequency": np.array([np.nan, 30.0, np.nan]),
    }
    rates = Rates(growth=np.array([2.0, 2.0, 2.0]), shaking=np.array([-1.0, -1.0, 2.0]))
    found = execute.with_rates(rows, rates)
    assert found["verdict"].tolist() == [Verdict.TOPPLES, Verdict.LIMIT_CYCLE, Verdict.LIMIT_CYCLE]
    assert np.isnan(found["limit_cycle_amplitude"]).tolist() == [True, False, False]


ARM = """
<mujoco><option timestep="0.001"><flag contact="disable"/></option><worldbody>
<body><joint name="j1" axis="0 1 0" damping="0.1"/><geom size="0.05" mass="2" pos="0 0 -0.3"/>
<body pos="0 0 -0.5"><joint name="j2" axis="0 1 0" armature="0.01"/>
<geom size="0.04" mass="1" pos="0.05 0 -0.25"/></body></body></worldbody>
<actuator><motor joint="j1"/><motor joint="j2"/></actuator>
<keyframe><key name="k" qpos="0.4 0.3"/></keyframe></mujoco>
"""


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "moved",
    [
        {"setpoint": 0.1},
        {"initial_velocity": 0.7, "setpoint": 0.1},
    ],
)
def test_what_swings_back_slowly_is_not_lost(tmp_path, moved):
    """Soft arms speed up on their way back, and are not back when a short run ends."""
    (tmp_path / "arm.xml").write_text(ARM)
    loop = jx.robot(
        tmp_path / "arm.xml", keyframe="k", wn=110, zeta=0.9, delay=2e-3, control_rate=500, **moved
    )
    gains = {"kp": jx.log(2, 60, 6), "kd": jx.log(0.2, 2, 4)}
    found = jx.sweep(loop, **gains, duration=0.5, engine="mujoco", progress=False)
    calm = (found.growth_rate < 0.0).values
    assert 6 <= calm.sum() < calm.size
    assert not (found.verdict.values[calm] == Verdict.UNSTABLE).any()
    assert not (found.verdict.values[~calm] == Verdict.STABLE).any()
