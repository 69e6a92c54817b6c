"""Of the values of a parameter the one that is given last counts, those of some joints included."""

import itertools

import jax
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.cli import _arguments, _loops, export
from jaxact.errors import InexactWarning, UserError
from jaxact.loops import reading, robots
from jaxact.loops.building import loop_of
from jaxact.loops.samples import expand
from jaxact.simulation import kernel

# Tables whose last pattern has every joint are what some of these are about.
pytestmark = pytest.mark.filterwarnings("ignore:kp. 'a' changes nothing")

ARM = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body>
<joint name="a" axis="0 1 0"/><geom type="capsule" size=".03" fromto="0 0 0 .5 0 0" mass="1"/>
<body pos=".5 0 0"><joint name="b" axis="0 1 0"/>
<geom type="capsule" size=".03" fromto="0 0 0 .5 0 0" mass="1"/></body></body></worldbody>
<actuator><motor joint="a"/><motor joint="b"/></actuator></mujoco>"""
TEXT = """[plant]
model = "arm.xml"
[parameters]
kd = 5.0
{parameters}
[axes]
{axes}
"""


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    return path


def _kp(loop):
    return jx.export(loop, "toml").joints.kp


@pytest.mark.parametrize(
    ("first", "then", "kp"),
    [
        ({".*": 100.0}, 300.0, (300, 300)),
        ({"a": 50.0, ".*": 200.0}, 300.0, (300, 300)),
        ({"a": 10.0, ".*": 20.0}, {"a": 50.0}, (50, 20)),
        ({".*": 20.0, "a": 10.0}, {".*": 50.0}, (50, 50)),
        (100.0, {"a": 50.0}, (50, 100)),
        ({"a": 10.0, "b": 20.0}, {"b": 30.0}, (10, 30)),
    ],
)
def test_what_replace_is_given_counts(arm, first, then, kp):
    loop = jx.robot(arm, kp=first, kd=5.0).replace(kp=then)
    assert _kp(loop) == kp
    assert _kp(jax.tree.map(lambda leaf: leaf, loop)) == kp


def test_patterns_count_in_their_order_in_what_is_compiled_too(arm):
    """JAX sorts the keys of what it compiles: `.*` before `a`."""
    scene = robots.scene(jx.robot(arm).kind.plant)
    for order in (("kp@a", "kp@.*"), ("kp@.*", "kp@a")):
        masks = {key: robots.matched(scene, key) for key in order}
        values = {"kp": 1.0, "kp@a": 50.0, "kp@.*": 200.0}
        arrays = {key: np.float32(value) for key, value in values.items()}
        found = jax.jit(lambda values, masks=masks: robots.each_joint(values, {}, masks))(arrays)
        assert found["kp"].tolist() == [200.0 if order[1] == "kp@.*" else 50.0, 200.0]


@pytest.mark.exhaustive
def test_the_setpoint_of_a_simulation_is_that_of_every_joint(arm):
    loop = jx.robot(arm, kp={"a": 50.0, ".*": 200.0}, kd=5.0, setpoint={"a": 0.2, "b": 0.3})
    run = jx.simulate(loop, setpoint=0.1, duration=0.02, engine="mujoco")
    np.testing.assert_allclose(run.setpoint[0], 0.1, rtol=1e-12)
    np.testing.assert_allclose(run.command[0], [20.0, 20.0], rtol=1e-9)  # kp times the setpoint


PATTERNS = 'kp = { a = 50.0, ".*" = 100.0 }'


@pytest.mark.parametrize(
    ("override", "parameters", "axes"),
    [
        ("kp=500", {"kp": 500}, {}),
        ("stiffness=500", {"kp": 500}, {}),
        ("parameters.kp=500", {"kp": 500}, {}),
        ("kp=[50, 500]", {}, {"kp": (50, 500)}),
        ("axes.kp=[50, 500]", {}, {"kp": (50, 500)}),
        ("kp@.*=500", {"kp@.*": 500}, {}),
        ("kp@a=500", {"kp@.*": 100, "kp@a": 500}, {}),
        ("kp@a=[50, 500]", {"kp@.*": 100}, {"kp@a": (50, 500)}),
    ],
)
def test_what_set_gives_counts(arm, override, parameters, axes):
    asked = reading.parse(
        TEXT.format(parameters=PATTERNS, axes="delay = [0.0, 1e-3]"), arm.parent, [override]
    )
    assert list(asked.parameters.items()) == [("kd", 5), *parameters.items()]
    assert {axis.name: axis.listed for axis in asked.axes} == {"delay": (0, 1e-3)} | axes


def test_an_axis_that_is_fixed_for_all_joints_is_none(arm):
    text = TEXT.format(parameters="", axes='"kp@a" = [1.0, 2.0]\ndelay = [0.0, 1e-3]')
    asked = reading.parse(text, arm.parent, ["kp=500"])
    assert [axis.name for axis in asked.axes] == ["delay"]
    asked = reading.parse(text.replace("kp@a", "wn@a"), arm.parent, ["actuator=hyq"])
    assert [axis.name for axis in asked.axes] == ["delay"]


def test_an_option_of_the_command_line_counts_before_the_patterns_of_its_file(arm):
    file = arm.parent / "sweep.toml"
    file.write_text(TEXT.format(parameters=PATTERNS, axes="delay = [0.0, 1e-3]"))
    given = _loops.specified(_arguments.Robot(spec=file), {"kp": 500.0}, {})
    assert _kp(loop_of(given)) == (500, 500)


def test_axes_of_a_sweep_count_before_what_the_loop_has(arm):
    loop = jx.robot(arm, kp={".*": 100.0, "a": 70.0}, kd=5.0)
    file = arm.parent / "sweep.toml"
    file.write_text(TEXT.format(parameters=PATTERNS, axes="delay = [0.0]"))
    alone = [jx.margins(jx.robot(arm, kp=kp, kd=5.0)).gain_margin for kp in (50.0, 500.0)]
    for one in (loop, file):
        for name in ("kp", "kp@.*"):
            swept = jx.sweep(one, **{name: [50.0, 500.0]}, engine="linear", progress=False)
            np.testing.assert_allclose(np.ravel(swept.gain_margin), alone, rtol=1e-3)


def test_an_axis_of_some_joints_counts_before_what_is_fixed(arm):
    """Whether in a file or of a batch, whose order is that of its values."""
    axes, parameters = '"kp@a" = [50.0, 500.0]', 'kp = { ".*" = 100.0 }'
    asked = reading.parse(TEXT.format(parameters=parameters, axes=axes), arm.parent)
    assert asked.setting.keys == ("kp@.*", "kp@a")
    assert reading.parse(asked.text).setting.keys == asked.setting.keys
    assert [_kp(one) for one in loop_of(asked)] == [(50, 100), (500, 100)]
    batch = jx.robot(arm, kp={".*": [50.0, 500.0], "a": 100.0}, kd=5.0)
    assert [_kp(one) for one in batch] == [(100, 50), (100, 500)]


@pytest.mark.parametrize(
    ("parameters", "axes", "said"),
    [
        ('kp = { ".*" = 100.0 }', "kp = [50.0, 500.0]", "kp: varies, and changes no joint"),
        ("kp = { a = 1.0, b = 2.0 }", "kp = [5.0, 6.0]", "since kp@a and kp@b has each"),
        ("", "kp = [5.0, 6.0]\n'kp@a' = [7.0, 8.0]\n'kp@.*' = [9.0]", "kp@a: varies"),
    ],
)
def test_an_axis_that_changes_no_joint_is_refused(arm, parameters, axes, said):
    asked = reading.parse(TEXT.format(parameters=parameters, axes=axes), arm.parent)
    with pytest.raises(UserError, match=said) as raised:
        kernel.occurring(asked.setting, expand(asked).along)
    assert "\n" not in str(raised.value)


def test_an_axis_of_all_joints_beside_a_fixed_one_of_some_varies_the_others(arm):
    asked = reading.parse(
        TEXT.format(parameters="kp = { a = 50.0 }", axes="kp = [10.0, 20.0]"), arm.parent
    )
    kernel.occurring(asked.setting, expand(asked).along)
    assert [_kp(one) for one in loop_of(asked)] == [(50, 10), (50, 20)]


def test_taking_a_loop_apart_leaves_it_as_it_was(arm):
    loop = jx.robot(arm, kp={"a": 50.0, ".*": 200.0}, kd=1.0)
    keys = list(loop.values)
    values, structure = jax.tree.flatten(loop, is_leaf=lambda part: isinstance(part, dict))
    again = jax.tree.unflatten(structure, values)
    assert list(loop.values) == keys and loop.values == again.values


def test_a_pattern_of_a_table_that_changes_nothing_is_said(arm):
    """Whether of `.*` or of another that has the joint; not where the later has fewer joints."""
    gains, plain = arm.parent / "gains.toml", arm.parent / "plain.toml"
    for table, words in (
        ({"b": 50.0, ".*": 200.0}, "kp: 'b' changes nothing, since '.*' comes later"),
        ({"b": 50.0, "a|b": 200.0}, "kp: 'b' changes nothing, since 'a|b' comes later"),
        ({"[ab]": 50.0, ".*": 200.0}, r"kp: '\[ab\]' changes nothing"),
    ):
        rows = ", ".join(f"'{key}' = {value}" for key, value in table.items())
        gains.write_text("[kp]\n" + rows.replace(", ", "\n") + "\n[kd]\n'.*' = 1.0\n")
        with pytest.warns(InexactWarning, match=words):
            assert _kp(jx.robot(arm, kp=table, kd=5.0)) == (200, 200)
        with pytest.warns(InexactWarning, match=words):
            text = TEXT.format(parameters=f"kp = {{ {rows} }}", axes="delay = [0.0]")
            assert _kp(loop_of(reading.parse(text, arm.parent))) == (200, 200)
        with pytest.warns(InexactWarning, match=f"gains.toml: {words}"):
            assert _kp(jx.robot(arm, gains=gains)) == (200, 200)
    for table in ({".*": 200.0, "b": 50.0}, {"a|b": 200.0, "b": 50.0}, {"a": 200.0, "b": 50.0}):
        assert _kp(jx.robot(arm, kp=table, kd=5.0)) == (200, 50)
    plain.write_text(TEXT.format(parameters="kp = { b = 50.0 }", axes="delay = [0.0]"))
    assert _kp(loop_of(reading.load(plain, ["kp@a|b=200"]))) == (200, 200)  # given anew


@pytest.mark.parametrize("order", [*itertools.permutations(("kp=200", "kp@a=50", "kp@a|b=70"))])
def test_set_of_export_counts_in_its_order_as_that_of_a_specification(arm, order):
    """Also where one is given again."""
    for overrides in (order, (*order, order[0])):
        asked = reading.parse(TEXT.format(parameters="kp = 1.0", axes="delay = [0.0]"),
                              arm.parent, overrides)  # fmt: skip
        found = jx.export(arm, "toml", parameters={"kd": 5.0, **export._parameters(overrides)})
        assert found.joints.kp == _kp(loop_of(asked))
