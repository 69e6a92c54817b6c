"""What a hurried person gives the verbs: a line that says what to do, never a wrong answer."""

import json

import jax
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from matplotlib import pyplot
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.verbs import margin_tables

LOOP = jx.joint(mass=0.7, kp=400, kd=20, actuator="starleth", delay=1e-3)
NOTHING_HELPS = LOOP.replace(kp=4000)  # kd/kp is below the lag


@pytest.mark.parametrize(
    "verb",
    [jx.margins, jx.boundary, jx.simulate, jx.tune, jx.plot.bode, jx.plot.nyquist,
     lambda loop: jx.sweep(loop, kp=[100.0])],
    ids=["margins", "boundary", "simulate", "tune", "bode", "nyquist", "sweep"],
)  # fmt: skip
def test_what_is_not_a_loop_is_said_in_one_line(verb):
    with pytest.raises(jx.UserError, match="loop: a value of type int is not a loop; give one"):
        verb(3)


@pytest.mark.parametrize(
    "verb",
    [jx.margins, jx.boundary, jx.simulate, jx.tune, jx.check, jx.plot.bode,
     lambda loop: jx.sweep(loop, kd=[1.0]), lambda loop: jx.export(loop, "mjlab")],
    ids=["margins", "boundary", "simulate", "tune", "check", "bode", "sweep", "export"],
)  # fmt: skip
def test_a_batch_without_loops_is_said_in_one_line(verb):
    with pytest.raises(jx.UserError, match=r"is a batch without loops, of shape \(0,\)"):
        verb(jx.joint(kp=[1.0, 2.0])[0:0])


def test_a_misspelt_name_of_the_package_is_answered_with_the_nearest():
    with pytest.raises(AttributeError, match="no attribute 'margin'; did you mean 'margins'"):
        _ = jx.margin
    with pytest.raises(AttributeError, match="no attribute 'quux'$"):
        _ = jx.quux


def test_a_list_of_loops_is_one_loop_with_several_values():
    with pytest.raises(jx.UserError, match=r"several values, e.g. jaxact.joint\(kp=\[100, 400\]\)"):
        jx.margins([LOOP, LOOP])


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: LOOP.replace(kp=None), "`kp` = None is not a number"),
        (lambda: LOOP.replace(kp="400"), "`kp` = '400' is not a number"),
        (lambda: LOOP.replace(kp=["400", "500"]), "is not a number or array of numbers"),
        (
            lambda: LOOP.replace(kp=np.ma.masked_array([400.0, 500.0], [False, True])),
            "`kp`: some of its values are masked",
        ),
        (lambda: jx.boundary(LOOP, kp=100), "kp = 100: a window is"),
        (lambda: jx.boundary(LOOP, kp=(1, 10, 100)), r"kp = \(1, 10, 100\): a window is"),
        (lambda: jx.boundary(LOOP, kd=jx.log(1, 10)), "kd = .*: a window is"),
        (lambda: jx.simulate(LOOP, 0.1, "1 s"), "duration = '1 s'; allowed: a number"),
        (lambda: jx.margins(LOOP, sampled="yes"), "sampled = 'yes'; allowed"),
        (lambda: jx.tune(LOOP, max_peak="1.6"), "`max_peak`: '1.6' is not a number"),
        (lambda: jx.tune(LOOP, max_peak=None), "`max_peak`: None is not a number"),
        (lambda: jx.tune(LOOP, front=-1), "`front` -1: give between 2 and"),
        (lambda: jx.tune(LOOP, front=2.5), "`front` 2.5: give between 2 and"),
        (lambda: jx.sweep(LOOP, delay=[[0, 1e-3], [0]]), "delay: an axis is a list of values"),
        (lambda: jx.sweep(LOOP, kp=np.ones((2, 2))), "kp: an axis is a list of values"),
        pytest.param(
            lambda: jx.plot.step(jx.simulate(LOOP, 0.1, 0.01), joint="knee"),
            "run is of a single", marks=pytest.mark.exhaustive,
        ),
        (lambda: jx.tune(LOOP, steps=-1), "`steps` -1: give a whole number from 1"),
        (lambda: jx.tune(LOOP, uncertainty={"wn": (90, 130)}), "factors on the nominal wn"),
        (lambda: jx.robot(object()), "model: a value of type object is not the path of a file"),
        (lambda: jx.plot.stability_map(3), "maps: a value of type int"),
        (lambda: jx.plot.stability_map(LOOP), "maps: a value of type ControlLoop"),
        (lambda: jx.plot.step(LOOP), "run: a value of type ControlLoop without trajectories"),
        (
            lambda: jx.plot.bode(LOOP, axes=[pyplot.figure().subplots()]),
            "axes: this picture has 2 of them",
        ),
        (lambda: jx.plot.bode(LOOP, axes=[None]), "axes: .* NoneType is not Matplotlib's axes"),
        (lambda: jx.plot.bode(LOOP.replace(kp=0, kd=0)), "the open loop is zero"),
        (lambda: jx.plot.front(LOOP), "best: a value of type ControlLoop has no tuned gains"),
        (lambda: jx.plot.convergence(LOOP), "best: a value of type ControlLoop has no tuned"),
        (lambda: jx.plot.tuning_map(LOOP), "best: a value of type ControlLoop has no tuned"),
        (lambda: jx.plot.robot_gains(LOOP), "best: a value of type ControlLoop has no tuned"),
        (lambda: jx.plot.step_band(LOOP), "best: a value of type ControlLoop has no tuned gains"),
        (lambda: jx.plot.tuned_sensitivity(LOOP), "best: a value of type ControlLoop has no"),
        (lambda: jx.plot.robot_margins(LOOP), "found: a value of type ControlLoop has no margins"),
        (lambda: jx.plot.profile_likelihood(LOOP), "type ControlLoop is not an identified drive"),
        (lambda: jx.plot.residual_autocorrelation(LOOP), "is not an identified drive"),
        (
            lambda: jx.joint(wn=100, natural_frequency=200),
            "`wn` and `natural_frequency` are the same parameter; remove one",
        ),
        (lambda: LOOP.replace(kp=1, stiffness=2), "are the same parameter; remove one"),
        (lambda: jx.sweep(LOOP, kp=[1], stiffness=[2]), "stiffness: the same parameter is given"),
        (lambda: jx.joint(delay=np.timedelta64(1, "ms")), "`delay` = .*is not a number"),
        (lambda: jx.joint(kp=jx.log(10, 100, 3)), "`kp`: a range is for an axis of jaxact.sweep"),
        (lambda: jx.sweep(LOOP, kp=[100], out=""), "`out` is empty"),
        (lambda: jx.sweep(LOOP, kp=[100], memory="much"), "'much' is not a size"),
        (lambda: jx.robot(__file__, joints=3), "joints = 3; allowed: a pattern, or several"),
        (lambda: jx.robot(__file__, joints=[]), r"joints = \[\] drives none; leave it out"),
        (lambda: jx.joint(physics_step=-1), "`physics_step` = -1; allowed: 1e-07 to 1"),
        (lambda: jx.joint(physics_step=0), "`physics_step` = 0; allowed: 1e-07 to 1"),
        (lambda: LOOP.replace(physics_step="a"), "`physics_step` = 'a'; allowed: 1e-07 to 1"),
        (lambda: jx.robot(__file__, physics_step=2), "`physics_step` = 2; allowed: 1e-07 to 1"),
        (lambda: jx.joint(kp=[1, 2], names="ab"), "`names` = 'ab'; allowed: a list with a name"),
        (lambda: jx.joint(kp=[1, 2], names=3), "`names` = 3; allowed: a list with a name"),
        (lambda: jx.log(-1, 10, 3), "jaxact.log: low = -1 has no logarithm"),
        (lambda: jx.log(10, 1, 3), "jaxact.log: low = 10 is not below high = 1"),
        (lambda: jx.log(1, 10, 1), "jaxact.log.num = 1; allowed: a whole number from 2"),
        (lambda: jx.linear("a", 1, 3), "jaxact.linear: low = 'a' is not a finite number"),
        (lambda: jx.linear(0, np.inf), "jaxact.linear: high = inf is not a finite number"),
        (lambda: jx.sweep(LOOP, kp=jx.log(1, 10)), r"kp: .* jaxact.log\(1, 10, 5\), .*sobol"),
        (lambda: jx.sweep(LOOP, kp=[1], progress="x"), "`progress` = 'x'; allowed: True, False"),
        (lambda: jx.tune(LOOP, progress="x"), "`progress` = 'x'; allowed: True, False"),
        (lambda: jx.simulate(LOOP, engine="foo"), "engine = 'foo'; allowed: mass, mjx$"),
        (lambda: jx.sweep(LOOP, engine="foo", kp=[1]), "engine = 'foo'; allowed: mass, mjx$"),
        (lambda: jx.simulate(LOOP, engine="warp"), "'warp': is for robots, of jaxact.robot or"),
        (lambda: jx.check(None), "loop: a value of type NoneType is not a loop"),
        (lambda: jx.export(None, "toml"), "source: a value of type NoneType has no gains"),
        (lambda: jx.export(LOOP, "toml"), "export a loop of jaxact.robot.*and `kp` and `kd` where"),
        (lambda: jx.export(jx.joint(delay=1e-3), "toml"), "export a loop of jaxact.robot"),
        (lambda: jx.identify(None), "`logs`: a value of type NoneType is not a log"),
        (lambda: jx.identify("a.csv", validate=3), "`validate`: a value of type int is not a log"),
        (lambda: jx.joint(inertia=-1), r"`inertia` = -1.0 .*\[kg m\^2\] \(moved inertia\)"),
        (lambda: jx.joint(inertia=1).replace(kp=np.nan), r"`kp` = nan .*\[N m/rad\]"),
        (lambda: jx.robot(__file__, inertia=3), "`inertia`: only for a single joint"),
        (lambda: jx.widget(jx.robot(__file__)), "a widget is of a joint, and this is of a robot"),
    ],
)  # fmt: skip
def test_slips_are_said_in_one_line(call, said):
    with pytest.raises(jx.UserError, match=said) as raised:
        call()
    assert "\n" not in str(raised.value)


def test_a_robot_does_not_swallow_a_mass(tmp_path):
    model = tmp_path / "arm.xml"
    model.write_text("<mujoco/>")
    with pytest.raises(jx.UserError, match="mass.*masses are those of its model; payload"):
        jx.robot(model, mass=3, kp=80, kd=2)


def test_a_robot_has_no_margins_in_continuous_time(tmp_path):
    model = tmp_path / "arm.xml"
    model.write_text(
        '<mujoco><worldbody><body name="link"><joint name="hinge" type="hinge" axis="0 1 0"/>'
        '<geom size=".1" mass="1" pos="0 0 .1"/></body></worldbody>'
        '<actuator><motor joint="hinge"/></actuator></mujoco>'
    )
    with pytest.raises(jx.UserError, match="sampled = 'both' is of a joint"):
        jx.margins(jx.robot(model, kp=80, kd=2), sampled="both")


def test_batches_can_be_compared():
    batch = jx.joint(kp=[100, 400], kd=20)
    assert batch == jx.joint(kp=np.array([100.0, 400.0]), kd=20.0)
    assert batch != jx.joint(kp=[100, 401], kd=20)
    assert batch != jx.joint(kp=[100, 400])
    assert batch != jx.joint(kp=[100, 400], kd=20, velocity="differenced")
    assert batch != 3 and batch[0] == jx.joint(kp=100, kd=20)
    assert jax.jit(lambda kp: 1.0 * (LOOP.replace(kp=kp) == LOOP))(400.0) == 0.0


@pytest.mark.exhaustive
def test_no_factor_is_printed_where_no_factor_helps():
    """Held against the stability of the loop at other factors."""
    factors = np.geomspace(1e-4, 1.0, 40)
    many = LOOP.replace(kp=4000 * factors, kd=20 * factors)
    assert not np.any(jx.margins(many).stable)
    none = jx.margins(NOTHING_HELPS)
    assert "log gain to boundary -∞" in " ".join(str(none).split())
    assert json.loads(none.to_json())["log_gain_to_boundary"] == "-inf"
    assert float(none.to_xarray()["log_gain_to_boundary"]) == -np.inf
    assert ",-inf," in margin_tables.csv_text(NOTHING_HELPS, none.found)
    assert np.isneginf(margin_tables.store(NOTHING_HELPS, none.found)["log_gain_to_boundary"])
    assert np.isfinite(none.log_gain_to_boundary)  # which a derivative goes along
    helped = jx.margins(LOOP.replace(kp=2000, kd=100))
    factor = float(np.exp(helped.log_gain_to_boundary))
    for around, stable in ((0.99, True), (1.01, False)):
        there = LOOP.replace(kp=2000 * factor * around, kd=100 * factor * around)
        assert jx.margins(there).stable == stable
    assert f"{helped.log_gain_to_boundary:.4g}".replace("-", "") in str(helped)


@pytest.mark.parametrize(
    ("loop", "said"),
    [
        (LOOP.replace(kp=0, kd=0), "raise kp"),
        (LOOP.replace(kp=0), "raise kp"),
        pytest.param(LOOP.replace(joint_stiffness=-500), "raise kp", marks=pytest.mark.exhaustive),
        (NOTHING_HELPS, "raise kd against kp"),
        (LOOP.replace(kp=2000, kd=100), "lower the gains"),
    ],
    ids=["no gains", "no kp", "toppling", "no damping", "too stiff"],
)
def test_the_advice_helps(loop, said):
    assert said in " ".join(jx.simulate(loop, 0.1, 0.5).report.split())


def test_dimensions_that_xarray_would_pair_otherwise_are_refused():
    kp, kd = xr.DataArray([100.0, 400.0], dims="kp"), xr.DataArray([5.0, 20.0], dims="kd")
    with pytest.raises(jx.UserError, match=r"not by the names of dimensions: kp \(kp\), kd \(kd\)"):
        jx.joint(kp=kp, kd=kd)
    both = kp * kd  # dimensions (kp, kd), of which the last is kd's
    assert jx.joint(kp=both, kd=kd).shape == (2, 2)


def test_series_whose_indexes_differ_are_refused():
    kp, kd = pd.Series([300.0, 400.0], index=[1, 0]), pd.Series([10.0, 20.0])
    with pytest.raises(jx.UserError, match="`kp` and `kd` have different indexes"):
        jx.joint(kp=kp, kd=kd)
    assert jx.joint(kp=kp.sort_index(), kd=kd).kp.tolist() == [400.0, 300.0]


@pytest.mark.parametrize(
    ("setpoint", "said"),
    [
        (xr.DataArray([0.0, 0.1], dims="time"), "values over time would be steps"),
        (np.ma.masked_array([0.1], [True]), "`setpoint`: some of its values are masked"),
    ],
)
def test_a_setpoint_that_is_no_height_of_a_step_is_refused(setpoint, said):
    with pytest.raises(jx.UserError, match=said):
        jx.simulate(LOOP, setpoint, 0.1)


def test_memory_may_be_a_number_of_bytes():
    with pytest.raises(jx.UserError, match="memory: 4 B are too little"):
        jx.sweep(LOOP, kp=[100.0], memory=4)


def test_a_delay_of_seconds_at_a_robot_is_refused_before_it_takes_all_memory(tmp_path):
    joints = "".join(
        f'<body><joint name="j{number}" axis="0 1 0"/><geom size="0.1"/></body>'
        for number in range(4)
    )
    path = tmp_path / "four.xml"
    path.write_text(f"<mujoco><worldbody>{joints}</worldbody></mujoco>")
    robot = jx.robot(path, kp=5, kd=0.5, delay=3)  # 3 ms were meant
    with pytest.raises(jx.UserError, match=r"has 12,\d\d\d states, .*shorten a delay"):
        jx.margins(robot)


@pytest.mark.parametrize("sampled", [False, pytest.param(True, marks=pytest.mark.exhaustive)])
def test_traced_values_out_of_their_bounds_give_no_margins(sampled):
    def found(mass, delay):
        loop = LOOP.replace(mass=mass, delay=delay)
        return jx.margins(loop, sampled=sampled, max_delay_steps=2 if sampled else None).metrics

    masses = np.array([0.7, -0.7, np.nan, 0.7, 0.7])
    delays = np.array([1e-3, 1e-3, 1e-3, -1e-3, np.nan])
    with jax.enable_x64():
        own = jax.jit(jax.vmap(found))(masses, delays)
    assert own.stable.tolist() == [True, *[False] * 4]
    assert own.unstable_roots.tolist() == [0, *[-1] * 4]
    expected = jx.margins(LOOP, sampled=sampled)
    for name in ("gain_margin", "delay_margin", "sensitivity_peak", "log_gain_to_boundary"):
        values = getattr(own, name)
        assert values[0] == pytest.approx(float(getattr(expected, name)), rel=1e-9)
        assert np.isnan(values[1:]).all()
