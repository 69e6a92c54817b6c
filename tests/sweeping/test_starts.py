"""From where loops that are not linear are judged: robots with friction, and at rest."""

import json

import mujoco
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from scipy.linalg import expm

from jaxact.cli.main import main
from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.simulation import execute, plans
from jaxact.status import Verdict

HINGE = """
<mujoco>
  <option timestep="0.0005" gravity="0 0 0"/>
  <worldbody><body>
    <joint name="hinge" axis="0 1 0" armature="0.02" frictionloss="{friction}"/>
    <geom type="sphere" size="0.02" mass="0.001" contype="0" conaffinity="0"/>
  </body></worldbody>
  <actuator><motor joint="hinge" forcerange="-5 5"/></actuator>
</mujoco>
"""
PERIOD, KP, WN, ZETA = 1e-3, 80.0, 110.0, 0.9


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("hinge")
    for name, friction in (("rough", 0.3), ("smooth", 0.0)):
        (place / f"{name}.xml").write_text(HINGE.format(friction=friction))
    return place


def _asked(folder, model, *, kd, engine="mujoco", more="", axes="gain_scale = [1.0]"):
    path = folder / "loop.toml"
    path.write_text(
        f'engine = "{engine}"\nprecision = "float64"\nduration = 2.0\n[plant]\n'
        f'model = "{model}.xml"\n[parameters]\nkp = {KP}\nkd = {kd}\nwn = {WN}\nzeta = {ZETA}\n'
        f"{more}\n[axes]\n{axes}\n"
    )
    return reading.load(path)


def _run(asked):
    return execute.run(asked, expand(asked))


def _in_c(folder, kd, kick, seconds=2.0):
    """The rough hinge and its drive written out: positions at the ticks after a kick [rad/s]."""
    model = mujoco.MjModel.from_xml_path(str(folder / "rough.xml"))
    data, step = mujoco.MjData(model), 1e-5
    data.qvel[0] = kick
    force = rate = 0.0
    positions = []
    for _ in range(round(seconds / PERIOD)):
        command = -KP * data.qpos[0] - kd * data.qvel[0]
        for _ in range(round(PERIOD / model.opt.timestep)):
            mean = 0.0
            for _ in range(round(model.opt.timestep / step)):
                rate += step * (WN * WN * (command - force) - 2.0 * ZETA * WN * rate)
                force += step * rate
                mean += force * step / model.opt.timestep
            data.ctrl[0] = np.clip(mean, -5.0, 5.0)
            mujoco.mj_step(model, data)
        positions.append(data.qpos[0])
    return np.array(positions)


@pytest.mark.exhaustive
@pytest.mark.parametrize("engine", ["mujoco", "mjx"])
def test_a_hinge_with_friction_shakes_as_in_c_although_nothing_disturbs_it(folder, engine):
    asked = _asked(folder, "rough", kd=2.0, engine=engine)
    assert plans.groups(asked, expand(asked))[0].case.starts == ("slide",)
    found = _run(asked)
    last = _in_c(folder, 2.0, 2.0)[1500:]
    rising = np.flatnonzero((last[:-1] < 0.0) & (last[1:] >= 0.0))
    frequency = 2.0 * np.pi * (len(rising) - 1) / ((rising[-1] - rising[0]) * PERIOD)
    assert found["growth_rate"][0] > 0.0
    assert found["verdict"][0] == Verdict.LIMIT_CYCLE
    assert found["limit_cycle_amplitude"][0] == pytest.approx(0.5 * np.ptp(last), rel=0.05)
    assert found["limit_cycle_frequency"][0] == pytest.approx(frequency, rel=0.05)


@pytest.mark.exhaustive
def test_a_hinge_with_friction_that_decays_when_it_moves_is_stable(folder):
    found = _run(_asked(folder, "rough", kd=2.0, axes="gain_scale = [0.05, 0.5]"))
    assert (found["growth_rate"] < 0.0).all() and (found["verdict"] == Verdict.STABLE).all()


@pytest.mark.exhaustive
def test_a_robot_that_nothing_disturbs_is_kicked(folder):
    asked = _asked(folder, "smooth", kd=2.0)
    assert plans.groups(asked, expand(asked))[0].case.starts == ("kick",)
    found = _run(asked)
    assert found["growth_rate"][0] > 0.0 and found["verdict"][0] == Verdict.LIMIT_CYCLE
    moved = _asked(folder, "smooth", kd=2.0, more="setpoint = 0.1")
    assert plans.groups(moved, expand(moved))[0].case.starts == ()


def test_linear_loops_have_no_other_start():
    asked = reading.parse("[parameters]\nposition_noise = 1e-4\n[axes]\nkp = [100.0, 400.0]\n")
    assert plans.groups(asked, expand(asked))[0].case.starts == ()


@pytest.mark.exhaustive
def test_simulate_says_what_came_of_each_start(tmp_path, capsys):
    loop = ("--position-resolution", "1e-3", "--control-rate", "200", "--wn", "110")
    how = ("--velocity", "differenced", "--duration", "2", "--out", str(tmp_path / "loop.png"))
    assert main(["simulate", *loop, *how]) == 0
    assert "From 4 starts: " in capsys.readouterr().out
    assert main(["simulate", *loop, *how, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    names = [start["start"] for start in document["starts"]]
    assert names == ["own", "on", "between", "near"]
    worst = max(document["starts"], key=lambda start: start["verdict"] == "limit cycle")
    assert document["verdict"] == worst["verdict"] == "limit cycle"


def _stepped(kp, kd, step, kick, periods):
    """A mass of 1 kg under commands in steps, control at 1 kHz: positions after a kick [m/s]."""
    positions, velocity = [0.0], kick
    for _ in range(periods):
        force = np.round((-kp * positions[-1] - kd * velocity) / step) * step
        positions.append(positions[-1] + velocity * 1e-3 + 0.5e-6 * force)
        velocity += 1e-3 * force
    return np.array(positions)


@pytest.mark.exhaustive
def test_commands_in_steps_stop_a_mass_after_a_setpoint_step_but_not_after_a_kick():
    kp, kd, step = 1e4, 30.0, 1.0
    asked = reading.parse(
        f'precision = "float64"\nduration = 2.0\n[parameters]\nmass = 1.0\nkp = {kp}\nkd = {kd}\n'
        f"command_resolution = {step}\n[axes]\nsetpoint = [0.0, 0.1, 1.0]\n"
        "initial_velocity = [0.0, 0.0123]\n"
    )
    found = _run(asked)
    last = _stepped(kp, kd, step, 0.0123, 2000)[-500:]
    size = 0.5 * np.ptp(last)
    assert 0.2 * step / kp < size < step / kp
    assert (found["verdict"] == Verdict.LIMIT_CYCLE).all()
    assert found["limit_cycle_amplitude"].reshape(3, 2)[0, 1] == pytest.approx(size, rel=0.05)
    assert (found["limit_cycle_amplitude"] < step / kp).all()
    assert plans.groups(asked, expand(asked))[0].case.starts == ("on", "between", "near", "drift")


def _limited(mass, kp, kd, delay, most, seconds):
    """A mass behind the actuator and a limit, in steps of 0.1 ms: the positions of its end."""
    step, late = 1e-4, round(delay / 1e-4)
    matrix = np.array([[0.0, 1.0, 0.0], [-(WN**2), -2.0 * ZETA * WN, WN**2], [0.0, 0.0, 0.0]])
    advance = expm(matrix * step)
    state, waiting = np.zeros(3), [0.0] * (late + 1)
    position, velocity, positions = 0.0, 0.1, []
    for tick in range(round(seconds / step)):
        if tick % 10 == 0:
            command = -kp * position - kd * velocity
        waiting = [command, *waiting[:-1]]
        state[2], before = waiting[late], state[0]
        state = advance @ state
        force = np.clip(0.5 * (before + state[0]), -most, most)
        position += velocity * step + 0.5 * force / mass * step**2
        velocity += force / mass * step
        positions.append(position)
    return np.array(positions[-len(positions) // 4 :])


@pytest.mark.exhaustive
def test_a_limit_cycle_is_one_however_small_the_step_was_that_it_grew_from():
    mass, kp, kd, delay, most = 0.7, 2000.0, 60.0, 5e-3, 100.0
    asked = reading.parse(
        f'precision = "float64"\nduration = 3.0\n[parameters]\nmass = {mass}\nkp = {kp}\n'
        f"kd = {kd}\nwn = {WN}\nzeta = {ZETA}\ndelay = {delay}\nforce_limit = {most}\n"
        "[axes]\nsetpoint = [1e-6, 1e-5, 1e-2, 0.1]\n"
    )
    last = _limited(mass, kp, kd, delay, most, 3.0)
    up = np.flatnonzero((last[:-1] < 0.0) & (last[1:] >= 0.0))
    turns = 2.0 * np.pi * (len(up) - 1) / (1e-4 * (up[-1] - up[0]))
    found = _run(asked)
    assert (found["verdict"] == Verdict.LIMIT_CYCLE).all()
    np.testing.assert_allclose(found["limit_cycle_amplitude"], 0.5 * np.ptp(last), rtol=0.02)
    np.testing.assert_allclose(found["limit_cycle_frequency"], turns, rtol=0.02)


@pytest.mark.exhaustive
def test_what_grows_towards_a_cycle_that_other_starts_show_is_that_cycle():
    """Quantised, limited, linearly unstable: one of the starts grows for longer than the others."""
    asked = reading.parse(
        'precision = "float64"\nduration = 2.0\nvelocity = "differenced"\n[parameters]\n'
        "mass = 0.11775\nkp = 1445.9\nkd = 64.827\nmeasurement_delay = 0.00055898\n"
        "velocity_filter = 61.581\nposition_resolution = 0.001\nforce_limit = 75.816\n"
        "[axes]\nsetpoint = [0.01, 0.0234, 0.1]\n"
    )
    found = _run(asked)
    assert (found["growth_rate"] > 1.0).all()
    assert (found["verdict"] == Verdict.LIMIT_CYCLE).all()
    assert 0.015 < found["limit_cycle_amplitude"][2] < 0.02


@pytest.mark.exhaustive
def test_what_a_limit_does_not_bound_is_no_limit_cycle():
    """Damped by less than the actuator lags: from near and from far it grows without end."""
    asked = reading.parse(
        'precision = "float64"\nduration = 2.0\n[parameters]\nmass = 0.10779\nkp = 9365.1\n'
        "kd = 10.854\nwn = 288.35\nzeta = 0.2\nposition_resolution = 0.001\n"
        "command_resolution = 22.426\nforce_limit = 48.162\n[axes]\nsetpoint = [0.01, 1.0]\n"
    )
    assert 10.854 / 9365.1 < 2.0 * 0.2 / 288.35
    assert (_run(asked)["verdict"] == Verdict.UNSTABLE).all()
