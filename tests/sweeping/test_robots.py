"""Sweeps of robots: parameters of joints, changes of the model, motions, pushes, both engines."""

import contextlib
import dataclasses
import re

import mujoco
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from quickly import optimised_fully
from robots import HOPPER, PENDULUM, QUADRUPED, sagged

from jaxact.errors import UserError
from jaxact.loops import reading, robots, strength
from jaxact.loops.samples import ends, expand
from jaxact.plants.mjx import plant as mjx
from jaxact.robots import model as models
from jaxact.simulation import engines, execute, kernel, plans, single
from jaxact.status import Verdict
from jaxact.sweeping import cache, execution, location, throughput
from jaxact.verbs import sweep_options

REFEREE = ("time", "setpoint", "position", "velocity", "command", "delayed_command", "force")
DRIVE = "wn = 300\nzeta = 0.7\ndelay = 0.0013\nmeasurement_delay = 0.0006\noutput_delay = 0.0005\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robots")
    (folder / "pendulum.xml").write_text(PENDULUM)
    (folder / "hopper.xml").write_text(HOPPER)
    (folder / "slide.xml").write_text(mjx.SLIDE.read_text())
    return folder


def _parsed(folder, plant, parameters="", axes="feedforward = [0.0]", **options):
    lines = [f"{name} = {value!r}" for name, value in options.items()]
    text = "\n".join([*lines, "[plant]", plant, "[parameters]", parameters, "[axes]", axes])
    return reading.parse(text, folder)


def _rows(asked):
    return execute.run(asked, expand(asked))


PUSH = '[push]\nbody = "box"\nimpulse = [0, 0, 30.0]\ntime = 0.01\nduration = 0.0125\n'
HOME = 'model = "pendulum.xml"\nkeyframe = "home"'
CASES = {
    "pendulum": (HOME + '\n[motion]\nkind = "sine"\nfrequency = 9.0\n', "setpoint = 0.2"),
    "hopper": ('model = "hopper.xml"\n' + PUSH, "kp = 60\nkd = 2\nsetpoint = 0.1"),
}


@pytest.mark.exhaustive
@pytest.mark.parametrize("case", CASES)
def test_both_engines_simulate_the_same_loop(case, folder):
    plant, parameters = CASES[case]
    found = {}
    for engine in ("mujoco", "mjx"):
        options = {"engine": engine, "duration": 0.1, "precision": "float64"}
        asked = _parsed(folder, plant, DRIVE + parameters, **options)
        asked = dataclasses.replace(asked, integrator_correction=case == "pendulum")
        found[engine] = single.simulate(asked)
    for name in REFEREE:
        one, other = (getattr(run.trajectory, name) for run in found.values())
        np.testing.assert_allclose(one, other, atol=1e-6 * max(1.0, np.abs(one).max()))
    assert np.ptp(found["mjx"].trajectory.position, axis=0).max() > 0.02
    # One takes its figures from the rows that it kept, the other on the way.
    figures = found["mujoco"].results
    assert found["mjx"].results == pytest.approx(figures, rel=1e-4, nan_ok=True)
    assert figures["integrated_squared_error"] > 0.0 and figures["peak_force"] > 0.0


def test_pushes_one_after_another_are_each_their_own_though_one_kernel_serves_them(folder):
    """A cart of 2 kg that nothing holds: ``v = J / m`` behind a push, ``J t / (m T)`` within it."""
    cart = (
        '<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body name="cart">'
        '<joint name="rail" type="slide" axis="1 0 0"/><geom size="0.1" mass="2"/></body>'
        '</worldbody><actuator><motor joint="rail"/></actuator></mujoco>'
    )
    (folder / "cart.xml").write_text(cart)
    settings = set()
    for impulse, begin, lasts in ((3.0, 0.01, 0.02), (-1.0, 0.005, 0.04)):
        push = f'[push]\nbody = "cart"\nimpulse = [{impulse}, 0, 0]\ntime = {begin}\n'
        asked = _parsed(folder, f'model = "cart.xml"\n{push}duration = {lasts}', "kp = 0\nkd = 0",
                        engine="mjx", duration=0.1, precision="float64")  # fmt: skip
        path = single.simulate(asked).trajectory
        gone = np.clip((path.time - begin) / lasts, 0.0, 1.0)
        np.testing.assert_allclose(path.velocity[:, 0], impulse / 2.0 * gone, atol=1e-9)
        settings.add(kernel.split_push(asked.setting, float)[0])
    assert len(settings) == 1


def test_gains_of_the_model_are_the_default_and_patterns_override_them(folder):
    plain = robots.scene(_parsed(folder, HOME).plant)
    own = robots.brought(plain)
    np.testing.assert_allclose([own["kp"], own["kd"]], [[80, 30], [4, 1]])
    text = 'kp = 50\nkd = { ".*" = 3, elbow_servo = 2 }'
    asked = _parsed(folder, HOME, text)
    values = {name: np.float32(value) for name, value in asked.nominal.items()}
    masks = {key: robots.matched(plain, key) for key in asked.setting.keys}
    found = robots.each_joint(values, own, masks)
    np.testing.assert_allclose(found["kp"], [50, 50])
    np.testing.assert_allclose(found["kd"], [3, 2])
    np.testing.assert_allclose(found["wn"], np.inf)


@pytest.mark.exhaustive
def test_per_joint_axes_scale_like_the_whole(folder):
    """A gain scale of 2 is the same loop as twice the gains, joint by joint."""
    scaled = _rows(_parsed(folder, HOME, DRIVE, "gain_scale = [2.0]", duration=0.05))
    twice = "kd = { shoulder = 8, elbow = 2 }\n'kp@shoulder' = 160\n" + DRIVE
    given = _rows(_parsed(folder, HOME, twice, "'kp@elbow' = [60.0, 30.0]", duration=0.05))
    assert scaled["growth_rate"][0] == pytest.approx(given["growth_rate"][0], rel=1e-6)
    assert scaled["growth_rate"][0] != pytest.approx(given["growth_rate"][1], rel=1e-3)


CHANGES = {
    "payload": 0.8,
    "inertia_scale": 1.5,
    "joint_damping": 0.7,
    "joint_armature": 0.02,
}


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", CHANGES)
def test_a_varied_model_is_the_model_edited_by_hand(name, folder):
    value, plant = CHANGES[name], HOME + '\npayload_body = "lower"'
    axis = f"{name} = [{0.0 if name != 'inertia_scale' else 1.0}, {value}]"
    options = {"duration": 0.05, "precision": "float64", "engine": "mujoco"}
    swept = _rows(_parsed(folder, plant, DRIVE + "setpoint = 0.1", axis, **options))
    edited = models.read(folder / "pendulum.xml", keyframe="home").model
    if name == "payload":
        edited.body("lower").mass += value
    elif name == "inertia_scale":
        edited.body_mass[1:] *= value
        edited.body_inertia[1:] *= value
    else:
        field = {"joint_damping": "dof_damping", "joint_armature": "dof_armature"}[name]
        getattr(edited, field)[:] += value
    scene = robots.scene(_parsed(folder, plant).plant)
    kp, home = np.array([80.0, 30.0]), scene.posture
    rest = sagged(edited, home.qpos, home.force, kp)  # the controllers do not know of the change
    assert (np.abs(rest - home.qpos).max() > 0.005) == (name in ("payload", "inertia_scale"))
    A, B = _linear(edited, rest)
    changed = _parsed(folder, plant, DRIVE + "setpoint = 0.1", axis, **options)
    (plan,) = plans.groups(changed, expand(changed))
    from jaxact.simulation import changed_models

    moved = changed_models.moved(plan.case, changed.setting, expand(changed).take(np.array([0, 1])))
    np.testing.assert_allclose(moved[0][1], A, atol=1e-6)
    np.testing.assert_allclose(moved[1][1], B, atol=1e-6)
    assert abs(swept["growth_rate"][1] - swept["growth_rate"][0]) > 0.05
    assert swept["peak_force"][1] != swept["peak_force"][0]


def _linear(model, where):
    """mjd_transitionFD at a configuration, called here on its own."""
    data = mujoco.MjData(model)
    data.qpos = where
    mujoco.mj_inverse(model, data)
    data.ctrl = data.qfrc_inverse  # that bear the model's own weight
    mujoco.mj_forward(model, data)
    A, B = np.zeros((4, 4)), np.zeros((4, 2))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, A, B, None, None)
    return A, B


@pytest.mark.exhaustive
def test_a_push_gives_its_impulse(folder):
    """A free box at rest on the ground, pushed up: its momentum is the impulse, less gravity's."""
    text = (
        f'duration = 0.048\nengine = "mujoco"\nprecision = "float64"\n{PUSH}'
        '[plant]\nmodel = "hopper.xml"\n[parameters]\nkp = 300\nkd = 9\n'
        "[axes]\nfeedforward = [0.0]\n"
    )
    run = single.simulate(reading.parse(text, folder))
    height = run.trajectory.configuration[:, 2]
    model = models.read(folder / "hopper.xml").model
    mass = model.body_mass.sum()
    # Contact has ended when the push has: what is left is flight.
    late = np.polyfit(np.arange(30, 40) * 1e-3, height[30:40], 2)
    rate = np.polyval(np.polyder(late), 0.0225)
    assert rate == pytest.approx((30.0 - mass * 9.81 * 0.0125) / mass, rel=0.1)


@pytest.mark.exhaustive
def test_setpoints_move_as_specified(folder, tmp_path):
    base = "kp = 200\nkd = 8\n"
    sine = _moved(folder, base + "setpoint = 0.05", 'kind = "sine"\nfrequency = 5.0')
    time, rest = sine.trajectory.time, robots.scene(_parsed(folder, HOME).plant).positions
    want = rest + 0.05 * np.sin(2 * np.pi * 5.0 * time)[:, None]
    np.testing.assert_allclose(sine.trajectory.setpoint, want, atol=1e-7)
    chirp = _moved(
        folder, base + "setpoint = 0.05", 'kind = "chirp"\nfrequency = 1.0\nend_frequency = 9.0'
    )
    phase = 2 * np.pi * (time + 0.5 * 8.0 / 0.2 * time**2)
    np.testing.assert_allclose(
        chirp.trajectory.setpoint, rest + 0.05 * np.sin(phase)[:, None], atol=1e-7
    )
    rows = np.column_stack([[0.0, 0.1, 0.2], [0.4, 0.5, 0.45]])
    np.savetxt(
        folder / "path.csv", rows, delimiter=",", header="time [s],shoulder [rad]", comments=""
    )
    track = _moved(folder, base, 'kind = "file"\nfile = "path.csv"')
    np.testing.assert_allclose(track.trajectory.setpoint[:, 0], np.interp(time, *rows.T), atol=1e-7)
    np.testing.assert_allclose(track.trajectory.setpoint[:, 1], rest[1], atol=1e-7)
    np.savetxt(folder / "path.csv", rows, delimiter=",", header="time,wrist", comments="")
    with pytest.raises(UserError, match="'wrist'.*allowed: shoulder, elbow"):
        _moved(folder, base, 'kind = "file"\nfile = "path.csv"')


def _moved(folder, parameters, motion):
    text = (
        f'duration = 0.2\nengine = "mujoco"\nprecision = "float64"\n[plant]\n{HOME}\n[motion]\n'
        f"{motion}\n[parameters]\n{parameters}\n[axes]\nfeedforward = [0.0]\n"
    )
    return single.simulate(reading.parse(text, folder))


@pytest.mark.exhaustive
def test_a_robot_at_rest_stays_there_and_a_shaking_one_is_told(folder):
    axes = "gain_scale = [1.0, 60.0]"
    rows = _rows(_parsed(folder, HOME, DRIVE, axes, duration=0.5, engine="mujoco"))
    assert list(rows["verdict"]) == [Verdict.STABLE, Verdict.UNSTABLE]
    assert rows["growth_rate"][0] < 0.0 < rows["growth_rate"][1]
    assert rows["limit_cycle_amplitude"][0] == 0.0


WRONG = {
    "no gains": ('model = "hopper.xml"', "kd = 3", "kp: joint 'lift' needs one"),
    "no joint": (HOME, "'kp@wrist' = 3", "kp@wrist: matches no driven joint; they are shoulder"),
    "no keyframe": ('model = "pendulum.xml"\nkeyframe = "hom"', "", "home"),
    "no body": (HOME + '\npayload_body = "boxx"', "", "plant.payload_body.*no such body"),
    "no pattern": (HOME + '\njoints = ["hip"]', "", "hip"),
}


@pytest.mark.parametrize("case", WRONG)
def test_mistakes_about_a_robot_are_told_in_one_line(case, folder):
    plant, parameters, said = WRONG[case]
    with pytest.raises(UserError, match=said) as raised:
        _rows(_parsed(folder, plant, parameters, duration=0.05))
    assert "\n" not in str(raised.value)


def test_a_robot_that_falls_is_not_settled(folder):
    (folder / "pole.xml").write_text(
        """<mujoco><worldbody><body><freejoint/><geom size="0.1"/><body><joint name="j"/>
        <geom size="0.05" pos="0 0 0.3"/></body></body></worldbody>
        <actuator><motor joint="j"/></actuator></mujoco>"""
    )
    with pytest.raises(UserError, match="falls from its keyframe"):
        _rows(_parsed(folder, 'model = "pole.xml"', "kp = 9\nkd = 1", duration=0.05))


@pytest.mark.exhaustive
def test_the_quadruped_holds_its_posture(folder):
    plant = f'model = "{QUADRUPED / "quadruped.xml"}"\nkeyframe = "stand"'
    parameters = "kp = 800\nkd = 12\nwn = 800\nzeta = 0.45\ndelay = 0.001"
    rows = _rows(_parsed(folder, plant, parameters, "gain_scale = [0.2, 1.0]", duration=0.3))
    # At a fifth of the stiffness gravity wins.
    assert rows["growth_rate"][0] > 0.0 > rows["growth_rate"][1]
    assert rows["verdict"][1] == Verdict.STABLE


@pytest.mark.exhaustive
def test_both_engines_draw_the_same_map_with_contacts(folder):
    """32 x 32 gains: 95 % of the verdicts agree, the others lie within 5 % of the boundary."""
    axes = (
        'kp = { min = 40, max = 160, num = 32, spacing = "log" }\n'
        'kd = { min = 0.5, max = 2, num = 32, spacing = "log" }'
    )
    parameters = "wn = 300\nzeta = 0.8\ndelay = 0.002\ninitial_velocity = 0.5"
    verdicts = {}
    for engine in ("mujoco", "mjx"):
        asked = _parsed(
            folder, 'model = "hopper.xml"', parameters, axes, engine=engine, duration=0.4
        )
        with optimised_fully() if engine == "mjx" else contextlib.nullcontext():
            verdicts[engine] = _rows(asked)["verdict"].reshape(32, 32)
    one, other = verdicts["mujoco"] == Verdict.STABLE, verdicts["mjx"] == Verdict.STABLE
    assert 0.1 < one.mean() < 0.9
    assert (one == other).mean() >= 0.95
    # A cell is 4.6 % of the gain: a differing one must touch a cell of the other verdict.
    for row, column in np.argwhere(one != other):
        around = one[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        assert around.any() and not around.all()


@pytest.mark.exhaustive
def test_a_body_without_children_feels_its_changed_inertia(folder):
    """C MuJoCo keeps the inertia of such bodies from when the model was compiled."""
    axes = "inertia_scale = [1.0, 4.0]"
    asked = _parsed(
        folder, 'model = "slide.xml"', "kp = 400\nkd = 20", axes, engine="mujoco", duration=0.02
    )
    # -kd / (2 m) for an undelayed, lightly damped loop, up to sampling
    want = [-20.0 / (2 * 0.7), -20.0 / (2 * 2.8)]
    np.testing.assert_allclose(_rows(asked)["growth_rate"], want, rtol=0.02)


def test_auto_is_the_engine_that_was_faster_on_this_machine(folder, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache.usable() == ""
    asked = _parsed(folder, HOME, DRIVE, engine="auto", duration=0.1)
    samples, said = expand(asked), []
    assert engines.able(asked) == ("mjx", "mujoco")
    assert throughput.fastest(asked, samples, say=said.append) == "mujoco", "short: expected"
    assert said == []
    for engine, rate in (("mjx", 2e6), ("mujoco", 1e6)):
        one = dataclasses.replace(asked, engine=engine)
        plan = plans.groups(one, samples)[0]
        throughput.keep(plan, one, rate, throughput.ROLLOUTS)
    assert throughput.fastest(asked, samples, say=None) == "mujoco", "a CPU does as expected"
    monkeypatch.setattr(throughput, "_unsure", lambda: True)
    assert throughput.fastest(asked, samples, say=None) == "mujoco", "compiling takes longer"
    monkeypatch.setattr(engines, "compiling_pays", lambda *_: True)
    assert throughput.fastest(asked, samples, say=None) == "mjx", "measured"
    fixed = dataclasses.replace(asked, engine="mujoco")
    assert throughput.fastest(fixed, samples, say=None) == "mujoco", "the specification says it"


@pytest.mark.exhaustive
def test_a_sweep_that_goes_on_keeps_its_engine(folder, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    asked = _parsed(folder, HOME, DRIVE, engine="auto", duration=0.1)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(throughput, "fastest", lambda *_, **__: "mjx")
        how = execution.SweepOptions(resume=True)
        assert sweep_options.settled(asked, location.at(tmp_path / "out"), how).engine == "mjx", (
            "nothing there"
        )
        execution.sweep(
            dataclasses.replace(asked, engine="mujoco"),
            location.at(tmp_path / "out"),
            execution.SweepOptions(),
        )
        assert sweep_options.settled(asked, location.at(tmp_path / "out"), how).engine == "mujoco"
        overwriting = execution.SweepOptions(overwrite=True)
        assert (
            sweep_options.settled(asked, location.at(tmp_path / "out"), overwriting).engine == "mjx"
        )


def test_any_control_rate_suits_a_robot_without_a_step_of_its_own(folder):
    """The step is the longest that divides the period and is no longer than the model's 1 ms."""
    asked = _parsed(folder, HOME, "control_rate = 333", duration=0.1)
    assert [plan.case.drive.substeps for plan in plans.groups(asked, expand(asked))] == [4]
    with pytest.raises(UserError, match="not a multiple of the physics step 0.002 s"):
        _parsed(folder, HOME, "control_rate = 333", duration=0.1, physics_step=0.002)


@pytest.mark.exhaustive
def test_loops_of_other_control_rates_are_what_they_are_alone(folder):
    """Above the model's own rate each control rate is another physics step."""
    slow = "pendulum_slow.xml"
    (folder / slow).write_text(PENDULUM.replace('timestep="0.001"', 'timestep="0.01"'))
    plant = HOME.replace("pendulum.xml", slow)
    options = {"engine": "mujoco", "duration": 0.2, "precision": "float64"}

    def found(rates):
        parameters = DRIVE + "setpoint = 0.1"
        rows = _rows(_parsed(folder, plant, parameters, f"control_rate = {rates}", **options))
        return rows["growth_rate"], rows["integrated_squared_error"]

    alone = [found([rate]) for rate in (200, 400)]
    for together, *apart in zip(found([200, 400]), *alone, strict=True):
        np.testing.assert_allclose(together, np.concatenate(apart), rtol=1e-9)
        assert np.ptp(together) > 0.01 * np.abs(together).max()


def test_joints_that_are_too_weak_for_their_posture_are_named(folder):
    text = """<mujoco><worldbody><body><joint name="j" axis="0 1 0"/>
        <geom size="0.05" mass="2" pos="0.5 0 0"/></body></worldbody>
        <actuator><motor joint="j" forcerange="{} {}" forcelimited="true"/></actuator></mujoco>"""
    line = "stall_force = {}\nno_load_speed = 9"
    cases = (  # of the model, of the drive, and the least that there is at standstill
        ((-5, 5), "", 5), ((-20, 20), "", None), ((-5, 5), "force_limit = 20", None),
        ((-20, 20), "force_limit = 4", 4), ((-20, 20), line.format(3), 3),
        ((-20, 20), f"force_limit = 2\n{line.format(3)}", 2), ((-20, 20), line.format(10), None),
        ((-6, 20), "force_limit = 40", 6), ((-6, 20), "force_limit = 4", 4),
        ((-20, 20), "force_limit = 4\nforce_limit@j = 15", None),
        ((-20, 20), "force_limit = 15\nforce_limit@.* = 15\nforce_limit@j = 1.5", 1.5),
    )  # fmt: skip
    for (low, high), given, limit in cases:
        (folder / "arm.xml").write_text(text.format(low, high))
        drive = "kp = 90\nkd = 9\n" + re.sub(r"(\w+@\S+)", r'"\1"', given)
        asked = _parsed(folder, 'model = "arm.xml"\nposture = "keyframe"', drive)
        weak = strength.overloaded(robots.scene(asked.plant), ends(asked))
        said = () if limit is None else (f"j holds the posture with 9.81 of {limit} N m",)
        assert weak == said, given
    swept = _parsed(folder, 'model = "arm.xml"', "kp = 90\nkd = 9", "force_limit = [50, 7, 20]")
    assert [end.tolist() for end in strength.limits(robots.scene(swept.plant), ends(swept))] == [
        [-7.0], [7.0]
    ]  # fmt: skip
