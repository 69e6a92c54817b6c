"""Loops built by the names that everybody knows: what they hold, and what is refused."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from robots import QUADRUPED

import jaxact as jx
from jaxact.errors import UserError
from jaxact.loops import conversion
from jaxact.parameters import PARAMETERS, PRESETS


def test_every_parameter_of_the_table_is_an_attribute_with_its_default():
    loop = jx.joint()
    for name, parameter in PARAMETERS.items():
        assert getattr(loop, name) == parameter.default
        long_name = parameter.long_name.replace(" ", "_")
        assert getattr(loop, long_name.replace("-", "-")) == parameter.default or "-" in long_name
    with pytest.raises(AttributeError, match="no 'stiffnes'"):
        _ = loop.stiffnes


def test_long_names_are_those_of_the_short_ones():
    assert jx.joint(stiffness=300.0, natural_frequency=90.0).values == {"kp": 300.0, "wn": 90.0}


@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_sets_the_actuator(preset):
    loop = jx.joint(actuator=preset)
    assert (loop.wn, loop.zeta) == PRESETS[preset]


def test_values_broadcast_to_a_batch_that_can_be_indexed():
    loop = jx.joint(kp=[100.0, 200.0, 300.0], delay=np.array([[0.0], [1e-3]]), mass=0.5)
    assert loop.shape == (2, 3) and len(loop) == 2
    one = loop[1, 2]
    assert (one.shape, one.kp, one.delay, one.mass) == ((), 300.0, 1e-3, 0.5)
    assert [row.shape for row in loop] == [(3,), (3,)]
    assert loop.broadcast().values["mass"].shape == (2, 3)


def test_a_batch_that_is_broadcast_keeps_every_digit():
    loop = jx.joint(kp=np.array([100.1, 200.2]), kd=7.3, delay=1e-3).broadcast()
    assert (loop.kp.dtype, loop.kp.tolist(), loop.kd[1]) == (float, [100.1, 200.2], 7.3)
    doubled = jax.vmap(lambda one: 2.0 * one.kp + one.delay)(loop)
    assert np.asarray(doubled) == pytest.approx([200.201, 400.401], rel=1e-6)


def test_replacing_keeps_the_rest():
    loop = jx.joint(kp=100.0, kd=5.0, actuator="hyq").replace(kp=200.0, actuator="starleth")
    assert (loop.kp, loop.kd, loop.wn) == (200.0, 5.0, 110.0)
    assert (
        loop.replace(velocity="differenced", velocity_filter=300.0).kind.velocity == "differenced"
    )


def test_gains_that_are_not_one_number_are_not_told_as_one():
    robot = jx.robot(QUADRUPED / "quadruped.xml", keyframe="stand", kp={".*": 600, ".*KFE": 500})
    with pytest.raises(AttributeError, match=r"kp: not one number .*joints\.kp has each joint's"):
        _ = robot.kp
    assert jx.robot(QUADRUPED / "quadruped.xml", keyframe="stand", kp=600, kd=3).kp == 600


def test_a_loop_says_what_it_is():
    said = repr(jx.joint(kp=400, delay=[0, 1e-3]))
    assert "kp 400 N/m" in said and "delay [0, 0.001] s" in said and "2 loops" in said
    assert repr(jx.joint(unit="rad")).startswith("<rotary joint: ")
    robot = jx.robot(QUADRUPED / "quadruped.xml", keyframe="stand", base="fixed", kp=600, kd=30)
    assert "quadruped.xml, keyframe stand, base fixed" in repr(robot)


def test_a_loop_is_a_pytree_of_its_values():
    loop = jx.joint(kp=[100.0, 200.0], delay=1e-3)
    leaves, structure = jax.tree.flatten(loop)
    assert len(leaves) == 2
    assert jax.tree.unflatten(structure, leaves).kind == loop.kind
    doubled = jax.jit(lambda loop: jax.tree.map(lambda leaf: 2.0 * leaf, loop))(loop)
    assert jnp.array_equal(doubled.kp, jnp.array([200.0, 400.0]))


@pytest.mark.parametrize(
    "given, said",
    [
        ({"kq": 3}, "unknown parameter; did you mean 'kp'"),
        ({"stiffnes": 3}, "unknown parameter; did you mean 'stiffness'"),
        ({"mass": -1.0}, "out of range"),
        ({"kp": "stiff"}, "`kp` = .* is not a number"),
        ({"kp": [1.0, float("nan")]}, "not a number"),
        ({"kp": True}, "not a number"),
        ({"kp": []}, "empty"),
        ({"kp": [1, 2], "kd": [1, 2, 3]}, "do not broadcast"),
        ({"actuator": "hy"}, "did you mean 'hyq'"),
        ({"actuator": "hyq", "wn": 100.0}, "`wn`: the actuator preset sets it already"),
        ({"payload": 1.0}, "only a robot has it"),
        ({"kp@.*": 1.0}, "only a robot has it"),
        ({"velocity": "guessed"}, "`velocity` = 'guessed'"),
        ({"velocity_filter": 100.0}, "a sampled velocity has no such filter"),
        ({"velocity": "differenced", "velocity_noise": 1.0}, "is of the velocity's own sensor"),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(given, said):
    with pytest.raises(UserError, match=said):
        jx.joint(**given)


def test_an_unknown_parameter_is_answered_with_those_of_such_a_loop():
    for make, some, none in (
        (jx.joint, {"mass", "joint_stiffness"}, {"payload", "inertia_scale"}),
        (partial(jx.robot, QUADRUPED / "quadruped.xml"), {"payload"}, {"mass", "joint_stiffness"}),
    ):
        with pytest.raises(UserError, match="^`bogus`: unknown parameter; allowed: ") as raised:
            make(bogus=3)
        names = set(str(raised.value).partition("allowed: ")[2].split(", "))
        assert some | {"kp", "actuator"} <= names and not none & names


def test_a_robot_that_is_not_there_is_refused():
    with pytest.raises(UserError, match="nowhere.xml: no such model file"):
        jx.robot("nowhere.xml")


def test_patterns_of_joints_are_parameters_of_some():
    loop = jx.robot(QUADRUPED / "quadruped.xml", kp={".*_HAA": 500, ".*_HFE": 600})
    assert loop.values == {"kp@.*_HAA": 500.0, "kp@.*_HFE": 600.0}


def test_what_all_joints_share_is_not_given_to_some():
    with pytest.raises(UserError, match="gain_scale is one number for all joints; give it alone"):
        jx.robot(QUADRUPED / "quadruped.xml", kp=500, kd=20, gain_scale={".*_HAA": 1.0})


def test_dimensions_are_named_by_what_varies_along_them():
    loop = jx.joint(actuator=["hyq", "starleth"], delay=np.array([[0.0], [1e-3], [5e-3]]))
    samples = conversion.samples(loop)
    assert samples.dims == ("delay", "actuator") and samples.shape == (3, 2)
    assert list(samples.coords["actuator"].values) == ["hyq", "starleth"]
    together = conversion.samples(jx.joint(kp=[1.0, 2.0], kd=[3.0, 4.0]))
    assert together.dims == ("loop",)
    assert list(together.values["kd"]) == [3.0, 4.0]


def test_all_delays_of_the_loop_count_and_that_of_the_setpoint_does_not():
    loop = jx.joint(delay=1e-3, measurement_delay=2e-3, output_delay=3e-3, setpoint_delay=0.1)
    assert float(conversion.continuous(loop.parameters).delay) == pytest.approx(6e-3, rel=1e-6)
    sampled = conversion.sampled(loop.parameters, "sampled")
    assert float(sampled.delay) == pytest.approx(6e-3, rel=1e-6)


def test_the_gain_scale_is_part_of_both_gains():
    found = conversion.continuous(jx.joint(kp=100.0, kd=4.0, gain_scale=3.0).parameters)
    assert (float(found.kp), float(found.kd)) == (300.0, 12.0)


def test_the_loops_of_a_specification_are_a_batch_over_its_axes(tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text(
        'velocity = "differenced"\n[parameters]\nmass = 0.5\n[axes]\n'
        'actuator = ["hyq", "starleth"]\nkp = { min = 10, max = 1000, num = 3, spacing = "log" }\n'
    )
    loop = jx.loop_of(path)
    assert loop.shape == (2, 3) and loop.kind.velocity == "differenced"
    assert [one.wn for one in loop[:, 0]] == [PRESETS["hyq"][0], PRESETS["starleth"][0]]
    assert loop[1].kp == pytest.approx([10.0, 100.0, 1000.0]) and loop.mass == 0.5
    assert conversion.samples(loop).dims == ("actuator", "kp")
    with pytest.raises(UserError, match="has axes of its own"):
        jx.loop_of(path, kp=3.0)


def test_listed_loops_keep_their_names_wherever_they_are_put(tmp_path):
    path = tmp_path / "loops.toml"
    path.write_text(
        '[[loop]]\nname = "soft"\nkp = 10\n[[loop]]\nname = "stiff"\nactuator = "hyq"\n'
    )
    loop = jx.loop_of(path, kd=5.0, kp=300.0)
    assert loop.kp.tolist() == [10.0, 300.0] and loop.wn.tolist() == [np.inf, PRESETS["hyq"][0]]
    assert loop[1].kind.names == ("stiff",) and loop[::-1].kind.names == ("stiff", "soft")
    assert repr(jx.margins(loop)).index("soft") < repr(jx.margins(loop)).index("stiff")
    path.write_text("[[loop]]\nkp = [1, 2]\n")
    with pytest.raises(UserError, match=r"loops.toml: loop\[0\].kp = .*; give one value"):
        jx.loop_of(path)


def test_there_is_a_name_for_each_loop():
    assert jx.joint(kp=[1.0, 2.0], names=["a", "b"])[0].kind.names == ("a",)
    with pytest.raises(UserError, match="`names`: 1 names for 2 loops"):
        jx.joint(kp=[1.0, 2.0], names=["a"])
