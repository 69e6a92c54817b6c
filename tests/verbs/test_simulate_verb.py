"""`jaxact.simulate`: trajectories against SciPy, batches, robots, and what is refused."""

import numpy as np
import pytest
import scipy.linalg
from robots import PENDULUM

import jaxact as jx
from jaxact.errors import UserError
from jaxact.plants.mjx.plant import SLIDE


def _by_scipy(kp, kd, mass, wn, zeta, setpoint, ticks, period):
    """Positions at the ticks of a loop without delay, by the matrix exponential."""
    flow = np.zeros((5, 5))
    flow[0, 1], flow[1, 2], flow[2, 3] = 1.0, 1.0 / mass, 1.0
    flow[3, 2:5] = -(wn**2), -2.0 * zeta * wn, wn**2
    step = scipy.linalg.expm(flow * period)
    state, found = np.zeros(4), []
    for _ in range(ticks):
        found.append(state[0])
        command = kp * (setpoint - state[0]) - kd * state[1]
        state = step[:4, :4] @ state + step[:4, 4] * command
    return np.array(found)


@pytest.mark.exhaustive
def test_a_trajectory_is_scipys():
    loop = jx.joint(kp=400.0, kd=20.0, mass=0.7, actuator="starleth")
    run = jx.simulate(loop, setpoint=0.1, duration=0.3)
    expected = _by_scipy(400.0, 20.0, 0.7, 110.0, 0.9, 0.1, run.sizes["time"], 1e-3)
    assert run.position.values == pytest.approx(expected, abs=1e-12)
    assert run.time.values[1] == pytest.approx(1e-3)
    assert (run.position.attrs["units"], run.force.attrs["units"]) == ("m", "N")


@pytest.mark.exhaustive
def test_a_batch_has_its_dimensions_and_metrics():
    loop = jx.joint(actuator="starleth", delay=[0.0, 1e-3, 0.05])
    run = jx.simulate(loop, duration=0.5)
    assert run.position.dims == ("delay", "time")
    meanings = run.verdict.attrs["flag_meanings"].split()
    words = [meanings[int(value)] for value in run.verdict]
    assert words == ["stable", "stable", "unstable"]
    assert run.growth_rate.values == pytest.approx(
        jx.margins(loop, sampled=True).growth_rate, rel=1e-6
    )


@pytest.mark.exhaustive
def test_setpoints_of_a_batch_scale_a_linear_loop():
    run = jx.simulate(jx.joint(actuator="hyq"), setpoint=[0.1, 0.2], duration=0.2)
    assert run.position.dims == ("setpoint_height", "time")
    small, large = run.position.values
    assert large == pytest.approx(2.0 * small, abs=1e-12)


@pytest.mark.exhaustive
def test_loops_with_other_control_rates_are_for_one_by_one():
    with pytest.raises(UserError, match="control_rate"):
        jx.simulate(jx.joint(control_rate=[500.0, 1000.0]), duration=0.2)


@pytest.mark.exhaustive
def test_a_robot_has_joints_and_their_units(tmp_path):
    path = tmp_path / "pendulum.xml"
    path.write_text(PENDULUM)
    run = jx.simulate(jx.robot(path, keyframe="home"), duration=0.2)
    assert run.position.dims == ("time", "joint")
    assert list(run.joint.values) == ["shoulder", "elbow"]
    assert (run.position.attrs["units"], run.force.attrs["units"]) == ("rad", "N m")
    assert run.position.values[0] == pytest.approx([0.4, -0.7], abs=1e-3)


@pytest.mark.exhaustive
@pytest.mark.parametrize("engine", ["mujoco", "mjx", None])
def test_a_loop_with_a_velocity_has_been_seen_to_come_whatever_simulates_it(engine):
    """As long as measurements are from before time 0, commands follow from x0 + v0 t alone."""
    late, start, period = 2.3e-3, {"initial_position": 0.02, "initial_velocity": -0.4}, 1e-3
    drive = {"kp": 400.0, "kd": 20.0, "measurement_delay": late, "velocity": "differenced"}
    if engine is None:
        loop = jx.joint(mass=0.7, **drive, **start)
    else:
        loop = jx.robot(SLIDE, physics_step=period, **drive, **start)
    run = jx.simulate(loop, setpoint=0.0, duration=0.01, engine=engine, precision="float64")
    seen = 0.02 - 0.4 * (period * np.arange(3) - late)
    expected = 400.0 * (0.0 - seen) + 20.0 * 0.4
    assert run.command.values.ravel()[:3] == pytest.approx(expected, rel=1e-9)


def test_an_engine_that_cannot_is_refused():
    with pytest.raises(UserError, match="is for robots"):
        jx.simulate(jx.joint(), engine="mujoco")


@pytest.mark.exhaustive
def test_a_setpoint_that_moves_is_no_step(tmp_path):
    """Alone and in a sweep: nothing is said against a step that nobody asked for."""
    (tmp_path / "arm.xml").write_text(PENDULUM)
    how = {"duration": 0.1, "engine": "mujoco"}
    loop = jx.robot(
        tmp_path / "arm.xml", keyframe="home", motion={"kind": "sine", "frequency": 5.0}
    )
    alone = jx.simulate(loop, setpoint=0.01, **how)
    grid = jx.sweep(loop, setpoint=[0.005, 0.01], progress=False, **how)
    for name in ("overshoot", "rise_time", "settling_time"):
        assert np.isnan(alone[name].values).all() and np.isnan(grid[name].values).all()
    assert float(grid.peak_force[1]) == pytest.approx(float(alone.peak_force), rel=1e-5)
