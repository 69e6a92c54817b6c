"""`jaxact.margins`: the oracle's figures, derivatives, batches, robots, and what is refused."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from robots import QUADRUPED
from theory import CONTINUOUS, figures, plant_values, sampled_matrix

import jaxact as jx
from jaxact.loops.specification import Push

ORACLE = json.loads((Path(__file__).parents[1] / "data" / "paper_loop.json").read_text())
SHORT = {"kp": "kp", "kd": "kd", "mass": "mass", "wn": "natural_frequency",
         "zeta": "damping_ratio", "delay": "delay"}  # fmt: skip


@pytest.fixture(scope="module")
def oracle_loops():
    return jx.joint(**{name: plant_values(CONTINUOUS, key) for name, key in SHORT.items()})


def test_margins_are_those_of_the_oracle(oracle_loops):
    found = jx.margins(oracle_loops)
    for name in ("gain_margin", "delay_margin", "sensitivity_peak", "complementary_peak"):
        expected = figures(CONTINUOUS, name)
        assert getattr(found, name) == pytest.approx(expected, rel=1e-9, nan_ok=True)
    growth = figures(CONTINUOUS, "spectral_abscissa")
    assert found.growth_rate == pytest.approx(growth, rel=1e-6)
    assert found.stable.dtype == bool and not found.sampled


def test_margins_are_in_double_precision_whatever_jax_has(oracle_loops):
    assert not jax.config.jax_enable_x64
    assert jx.margins(oracle_loops).gain_margin.dtype == np.float64


@pytest.mark.exhaustive
@pytest.mark.parametrize("velocity", ["sampled", "differenced"])
def test_the_sampled_growth_rate_is_that_of_scipys_matrix(velocity):
    cutoff = 500.0 if velocity == "differenced" else np.inf
    loop = jx.joint(
        kp=[300.0, 400.0, 4000.0], kd=[10.0, 20.0, 20.0], actuator="starleth", delay=2.3e-3,
        velocity=velocity, velocity_filter=cutoff,
    )  # fmt: skip
    found = jx.margins(loop, sampled=True)
    for index, kp, kd in zip(range(3), loop.kp, loop.kd, strict=True):
        matrix = sampled_matrix(
            (kp, kd, 0.7, 110.0, 0.9, 2.3e-3), 1e-3,
            differenced=velocity == "differenced", cutoff=cutoff,
        )  # fmt: skip
        radius = np.abs(np.linalg.eigvals(matrix)).max()
        assert found.growth_rate[index] == pytest.approx(np.log(radius) / 1e-3, rel=1e-6)
        assert found.stable[index] == (radius < 1.0)


@pytest.mark.exhaustive
def test_margins_are_differentiable_by_every_parameter_of_the_loop():
    loop = jx.joint(kp=400.0, kd=20.0, mass=0.7, actuator="starleth", delay=1e-3)

    def ms(values):
        return jx.margins(loop.replace(**values)).sensitivity_peak

    with jax.enable_x64(True):
        at = {name: jnp.asarray(loop.parameters[name]) for name in
              ("kp", "kd", "mass", "wn", "zeta", "delay")}  # fmt: skip
        slopes = jax.jit(jax.grad(ms))(at)
    for name, value in at.items():
        step = 1e-5 * float(value)
        ends = [float(ms({name: float(value) + sign * step})) for sign in (-1.0, 1.0)]
        difference = (ends[1] - ends[0]) / (2.0 * step)
        assert float(slopes[name]) == pytest.approx(difference, rel=1e-5), name


@pytest.mark.exhaustive
def test_vmap_over_a_batch_gives_what_the_batch_gives():
    loop = jx.joint(kp=[200.0, 400.0, 800.0], kd=20.0, actuator="hyq", delay=1e-3)
    together = jx.margins(loop).disk_margin
    mapped = jax.vmap(lambda one: jx.margins(one).disk_margin)(loop.broadcast())
    assert np.asarray(mapped) == pytest.approx(together, rel=1e-4)


@pytest.mark.exhaustive
def test_a_traced_delay_of_a_sampled_loop_needs_its_longest():
    loop = jx.joint(actuator="starleth")

    def margin(delay, **how):
        return jx.margins(loop.replace(delay=delay), sampled=True, **how).delay_margin

    with pytest.raises(TypeError, match="max_delay_steps"):
        jax.grad(margin)(1e-3)
    slope = jax.grad(lambda delay: margin(delay, max_delay_steps=4))(1e-3)
    assert float(slope) == pytest.approx(-1.0, rel=1e-3)  # delay that is there is margin gone


@pytest.mark.exhaustive
def test_what_is_printed_names_the_loops():
    text = repr(jx.margins(jx.joint(actuator="starleth", delay=[0.0, 1e-3]), sampled="both"))
    for words in ("delay 0 ms", "delay 1 ms", "continuous", "sampled", "delay margin"):
        assert words in text


def test_a_table_says_whether_it_is_of_the_sampled_loop():
    loop = jx.joint(actuator="starleth", delay=1e-3, control_rate=500.0)
    assert repr(jx.margins(loop)).split("─")[0].split()[-1] == "continuous"
    assert "continuous" in repr(jx.margins(loop.replace(kp=np.arange(1.0, 30.0))))
    text = repr(jx.margins(loop, sampled=True))
    assert "sampled at 500 Hz" in text and "continuous" not in text


@pytest.mark.parametrize("sampled", [False, True])
def test_the_growth_rate_has_the_name_of_tables_too(sampled):
    found = jx.margins(jx.joint(kp=[200.0, 400.0]), sampled=sampled)
    np.testing.assert_array_equal(found.spectral_abscissa, found.growth_rate)
    np.testing.assert_array_equal(found.to_xarray().spectral_abscissa, found.growth_rate)


@pytest.mark.parametrize("name", ["gain_margin", "growth_rate", "spectral_radius"])
def test_a_metric_of_both_kinds_is_asked_of_one(name):
    found = jx.margins(jx.joint(), sampled="both")
    said = rf"'{name}' is of one of the two: .continuous.{name} or .sampled.{name}"
    with pytest.raises(AttributeError, match=said):
        getattr(found, name)
    with pytest.raises(AttributeError, match="margins have no 'gain'"):
        _ = found.gain


def test_phase_margins_are_in_degrees_where_they_are_written():
    found = jx.margins(jx.joint())
    written = [found.to_xarray().phase_margin.item(), json.loads(found.to_json())["phase_margin"],
               found.to_pandas().phase_margin.item()]  # fmt: skip
    assert written == pytest.approx([np.degrees(found.phase_margin)] * 3)
    assert found.to_xarray().phase_margin.attrs["units"] == "degree"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"engine": "foo"}, "`engine` = 'foo'; allowed: mujoco, mjx"),
        ({"engine": "mjx"}, "`engine` = 'mjx': is for robots"),
        ({"max_delay_steps": -2}, "`max_delay_steps` = -2: give a whole number from 0"),
        ({"max_delay_steps": "a"}, "`max_delay_steps` = 'a': give a whole number from 0"),
    ],
)
def test_arguments_that_mean_nothing_are_refused(given, said):
    with pytest.raises(jx.UserError, match=said):
        jx.margins(jx.joint(), sampled=True, **given)


@pytest.mark.exhaustive
def test_both_kinds_side_by_side_are_arrays_and_a_table_too():
    found = jx.margins(jx.joint(kp=[200.0, 400.0], delay=1e-3), sampled="both")
    data, table = found.to_xarray(), found.to_pandas()
    np.testing.assert_array_equal(data.delay_margin, found.continuous.delay_margin)
    np.testing.assert_array_equal(data.sampled_delay_margin, found.sampled.delay_margin)
    assert data.sampled_delay_margin.attrs["units"] == "s"
    assert list(table.kp) == [200.0, 400.0]
    np.testing.assert_array_equal(table.sampled_delay_margin, found.sampled.delay_margin)


@pytest.mark.exhaustive
def test_of_thousands_of_loops_both_ends_are_printed():
    text = repr(jx.margins(jx.joint(kp=np.arange(1.0, 3001.0), kd=5.0)))
    assert "delay margin [ms]" in text and "phase margin [°]" in text
    lines = [line.split()[1] for line in text.splitlines() if line.startswith(" kp ")]
    assert [float(line) for line in lines] == [*range(1, 21), *range(2981, 3001)]
    assert "3,000 loops, of which the first and the last 20 are shown" in text


def test_margins_become_datasets_and_tables():
    loop = jx.joint(actuator=["hyq", "starleth"], delay=np.array([[0.0], [1e-3]]))
    found = jx.margins(loop)
    data = found.to_xarray()
    assert data.gain_margin.dims == ("delay", "actuator")
    assert data.gain_margin.sel(delay=1e-3, actuator="starleth") == found.gain_margin[1, 1]
    assert data.delay_margin.attrs["units"] == "s"
    table = found.to_pandas()
    assert len(table) == 4 and set(table.actuator) == {"hyq", "starleth"}
    assert len(jx.margins(jx.joint()).to_pandas()) == 1


@pytest.mark.exhaustive
def test_where_a_loop_is_unstable_the_slope_to_the_boundary_leads_back():
    def of(kp, name):
        loop = jx.joint(kp=kp, kd=20.0, actuator="starleth", delay=1e-3)
        return jnp.squeeze(getattr(jx.margins(loop), name))

    assert np.isnan(of(4000.0, "delay_margin")) and of(4000.0, "log_gain_to_boundary") < 0.0
    assert float(jax.grad(of)(4000.0, "delay_margin")) == 0.0
    assert float(jax.grad(of)(4000.0, "log_gain_to_boundary")) < 0.0


def test_an_unstable_loop_has_no_margins():
    found = jx.margins(jx.joint(actuator="starleth", delay=0.05))
    assert not found.stable and np.isnan(found.gain_margin) and found.growth_rate > 0.0
    assert "NO" in repr(found)


@pytest.fixture(scope="module")
def standing():
    loop = jx.robot(QUADRUPED / "quadruped.xml", keyframe="stand", kp=600, kd=30, actuator="hyq",
                    delay=[1.3e-3, 5e-3])  # fmt: skip
    return loop, jx.margins(loop)


@pytest.mark.exhaustive
def test_a_robots_delay_margin_is_where_it_begins_to_grow(standing):
    loop, found = standing
    margin = float(found.delay_margin[0])
    around = jx.margins(loop[0].replace(delay=[1.3e-3 + 0.98 * margin, 1.3e-3 + 1.02 * margin]))
    assert list(around.stable) == [True, False]


def test_a_robots_margins_are_arrays_over_loops_and_joints(standing):
    _, found = standing
    data = found.to_xarray()
    assert data.joint_delay_margin.dims == ("delay", "joint") and data.sizes["joint"] == 12
    assert found.of_joints["kp"].shape == (2, 12) and (found.of_joints["kp"] == 600.0).all()
    assert len(found.to_pandas()) == 24
    assert list(found.verdict) == ["stable", "stable"]
    leaves = jax.tree.leaves(jax.tree.map(np.asarray, found))
    assert all(isinstance(leaf, np.ndarray) for leaf in leaves)
    assert "delay 5 ms" in repr(found) and "LF_HAA" in repr(found)


def test_what_moves_a_robot_does_not_change_its_margins(standing):
    loop, found = standing
    pushed = loop[0].replace(push={"body": "trunk", "impulse": [0, 1.0, 0.0]})
    assert pushed.kind.push == Push(body="trunk", impulse=(0.0, 1.0, 0.0))
    # Alone and in a batch the same but for rounding.
    assert jx.margins(pushed).delay_margin == pytest.approx(found.delay_margin[0], rel=1e-9)


def test_a_robot_cannot_be_traced(standing):
    loop, found = standing
    assert {"delay_margin", "joints"} <= set(dir(found))
    with pytest.raises(TypeError, match="cannot be traced"):
        jax.grad(lambda kp: jx.margins(loop[0].replace(kp=kp)).disk_margin)(600.0)


def test_controllers_may_be_as_slow_as_they_like(capsys):
    from jaxact.cli.main import main

    loop = jx.joint(kp=0.01, kd=0.1, control_rate=1.0)
    found = jx.margins(loop, sampled=True)
    radius = np.abs(
        np.linalg.eigvals(sampled_matrix((0.01, 0.1, 0.7, np.inf, 1.0, 0.0), 1.0))
    ).max()
    assert float(found.growth_rate) == pytest.approx(np.log(radius), rel=1e-6)
    asked = ["--kp", "0.01", "--kd", "0.1", "--control-rate", "1", "--json"]
    assert main(["margins", *asked]) == 0
    row = json.loads(capsys.readouterr().out)["sampled"]
    assert row["gain_margin"] == pytest.approx(float(found.gain_margin))
