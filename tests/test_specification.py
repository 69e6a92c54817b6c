"""Specifications: what is accepted, what is refused, and in which words."""

import json
import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from robots import PENDULUM

from jaxact.errors import UserError
from jaxact.loops import checks, drives, toml
from jaxact.loops.reading import load, parse
from jaxact.parameters import PARAMETERS, canonical

GOOD = """
description = "a test"
engine = "mass"
[parameters]
mass = 0.7
kp = 400
[axes]
actuator = ["ideal", "hyq", "starleth"]
delay = [0, 0.001, 0.005]
kp = { min = 10, max = 1e5, num = 5, spacing = "log" }
kd = { min = 0.5, max = 2, num = 4 }
"""

# TOML text, and what the one line must contain: the key, what was given, what is allowed
REFUSED = {
    "unknown option": ("engin = 'mass'", ["engin", "did you mean 'engine'"]),
    "unknown parameter": ("[parameters]\nmas = 1", ["parameters.mas", "did you mean 'mass'"]),
    "unknown axis": ("[axes]\nzetta = [1]", ["axes.zetta", "did you mean 'zeta'"]),
    "unknown range key": ("[axes]\nkp = {min=1, max=2, nun=3}", ["axes.kp.nun", "'num'"]),
    "unknown sampling key": ("[sampling]\nmethods = 'sobol'", ["sampling.methods", "'method'"]),
    "empty key": ("'' = 1", ["unknown key"]),
    "parameter at the top": ("kp = 3", ["kp", "[parameters]"]),
    "option as parameter": ("[parameters]\nduration = 3", ["parameters.duration", "option"]),
    "unknown engine": ("engine = 'mjxx'", ["engine = 'mjxx'", "'mjx'", "mass, mjx"]),
    "unknown velocity": ("velocity = 'sample'", ["velocity", "sampled, differenced"]),
    "negative duration": ("duration = -1", ["duration = -1", "greater than 0"]),
    "duration NaN": ("duration = nan", ["duration = nan", "finite"]),
    "duration text": ("duration = '2'", ["duration = '2'", "a number"]),
    "duration true": ("duration = true", ["duration", "a number"]),
    "short duration": ("duration = 0.001\n[axes]\nkp=[1]", ["duration = 0.001", "0.01 s"]),
    "long duration": (
        "duration = 1e5\n[parameters]\ncontrol_rate=1e6\n[axes]\nkp=[1]",
        ["duration = 100000", "physics steps"],
    ),
    "seed fraction": ("seed = 1.5", ["seed = 1.5", "a whole number"]),
    "tile zero": ("tile = 0", ["tile = 0", "1"]),
    "negative mass": ("[parameters]\nmass = -1", ["parameters.mass = -1", "kg"]),
    "zeta zero": ("[parameters]\nzeta = 0", ["parameters.zeta = 0", "1e-06 to 1000"]),
    "zeta negative on an axis": ("[axes]\nzeta = [0.5, -1]", ["axes.zeta[1] = -1", "1e-06"]),
    "NaN on an axis": ("[axes]\nkp = [nan]", ["axes.kp[0] = nan", "not a number"]),
    "huge": ("[parameters]\nkp = 1e300", ["parameters.kp = 1e+300", "1e+09"]),
    "huge integer": ("[parameters]\nkp = 1" + "0" * 400, ["parameters.kp", "1e+09"]),
    "text on an axis": ("[axes]\nkp = ['a']", ["axes.kp[0] = 'a'", "not a number"]),
    "date": ("[parameters]\nkp = 1979-05-27", ["parameters.kp = 1979-05-27", "not a number"]),
    "list as a value": ("[parameters]\nkp = [1]", ["parameters.kp = [1]", "not a number"]),
    "empty axis": ("[axes]\nkp = []", ["axes.kp = []", "empty"]),
    "number as axis": ("[axes]\nkp = 3", ["axes.kp = 3", "a list, or a range"]),
    "range without end": ("[axes]\nkp = {min=1, num=3}", ["axes.kp.max", "missing"]),
    "range without number": ("[axes]\nkp = {min=1, max=3}", ["axes.kp.num", "missing"]),
    "range turned": ("[axes]\nkp = {min=2, max=1, num=3}", ["axes.kp", "min = 2", "max = 1"]),
    "range of one": ("[axes]\nkp = {min=1, max=2, num=1}", ["axes.kp.num = 1", "from 2"]),
    "range to infinity": ("[axes]\nwn = {min=1, max=inf, num=3}", ["axes.wn.max", "inf"]),
    "log from zero": (
        "[axes]\nkp = {min=0, max=1, num=3, spacing='log'}",
        ["axes.kp.min = 0", "above 0"],
    ),
    "unknown spacing": (
        "[axes]\nkp = {min=1, max=2, num=3, spacing='logg'}",
        ["axes.kp.spacing = 'logg'", "'log'"],
    ),
    "value twice": ("[axes]\nkp = [1, 2, 1.0]", ["axes.kp", "more than once"]),
    "key twice": ("[axes]\nkp = [1]\nkp = [2]\nkd = [1]\n", ["TOML", "line 3, column"]),
    "parameter twice": ("[axes]\nkp = [1]\nstiffness = [2]", ["axes.stiffness", "twice"]),
    "no axis": ("engine = 'mass'", ["axes", "none given"]),
    "too many": (
        "[axes]\nkp = {min=1, max=2, num=100000}\nkd = {min=1, max=2, num=100000}",
        ["kp 100,000 x kd 100,000", "2,000,000,000"],
    ),
    "unknown preset": ("[axes]\nactuator = ['hyk']", ["'hyk'", "'hyq'", "ideal, hyq, starleth"]),
    "preset and wn": (
        "[parameters]\nactuator = 'hyq'\nwn = 3\n[axes]\nkp = [1]",
        ["wn", "preset"],
    ),
    "actuator range": ("[axes]\nactuator = {min=1, max=2, num=3}", ["axes.actuator", "hyq"]),
    "half a torque-speed line": (
        "[parameters]\nstall_force = 3\n[axes]\nkp = [1]",
        ["no_load_speed", "stall_force"],
    ),
    "engine that is a number": ("engine = 3\n[axes]\nkp = [1]", ["engine = 3; allowed: mass, mjx"]),
    "control period": (
        "engine = 'mjx'\nphysics_step = 0.0003\n[axes]\nkp = [1]",
        ["control_rate = 1000", "0.0003 s", "physics_step = 0.00025"],
    ),
    "control period on an axis": (
        "engine = 'mjx'\n[axes]\ncontrol_rate = [1000, 3000]",
        ["control_rate = 3000", "multiple"],
    ),
    "control rate drawn": (
        "engine='mjx'\n[axes]\ncontrol_rate={min=100,max=1000}\n[sampling]\nmethod='sobol'\n"
        "samples=4",
        ["axes.control_rate", "list"],
    ),
    "delay beyond the history": ("[axes]\ndelay = [9.0]", ["delay = 9", "4.096 s"]),
    "two delays beyond the history": (
        "[parameters]\noutput_delay = 3\n[axes]\ndelay = [2.0]",
        ["delay + output_delay = 5", "4.096 s"],
    ),
    "missing model": ("[plant]\nmodel = 'no.xml'", ["plant.model = 'no.xml'", "no such file"]),
    "model no path": ("[plant]\nmodel = 3", ["plant.model = 3"]),
    "model empty": ("[plant]\nmodel = ''", ["plant.model = ''"]),
    "model above": ("model = 'no.xml'", ["model", "[plant]"]),
    "plant without model": ("[plant]\nkeyframe = 'home'", ["plant.model", "missing"]),
    "pattern of joints": ("[plant]\nmodel = 'no.xml'\njoints = ['(']", ["plant.", "no such file"]),
    "push no impulse": ("[push]\nbody = 'a'\nimpulse = [1, 2]", ["push.impulse", "three numbers"]),
    "motion unknown": ("[motion]\nkind = 'wave'", ["motion.kind", "allowed: step, sine"]),
    "motion file missing": ("[motion]\nkind = 'file'\nfile = 'a.csv'", ["motion.file", "no such"]),
    "pattern broken": ("[parameters]\n'kp@(' = 3", ["parameters.kp@(", "regular expression"]),
    "pattern of all": ("[parameters]\n'mass@a' = 3", ["mass@a", "all joints"]),
    "payload of a mass": ("[parameters]\npayload = 3", ["payload", "only a robot", "[plant]"]),
    "joints of a mass": ("[parameters]\n'kp@.*' = 3", ["kp@.*", "only a robot"]),
    "push on a mass": ("[push]\nbody = 'a'\nimpulse = [1, 2, 3]", ["push", "only for a robot"]),
    "motion of a mass": ("[motion]\nkind = 'sine'", ["motion", "only for a robot"]),
    "section no table": ("axes = 3", ["axes = 3", "table"]),
    "sampling no table": ("sampling = 3", ["sampling = 3", "table"]),
    "sampling without number": ("[sampling]\nmethod = 'sobol'", ["sampling.samples", "missing"]),
    "unknown method": (
        "[sampling]\nmethod = 'sob'\nsamples = 3",
        ["sampling.method = 'sob'", "latin-hypercube, sobol"],
    ),
    "nothing to sample": (
        "[sampling]\nmethod = 'sobol'\nsamples = 3\n[axes]\nkp = [1]",
        ["sampling", "range"],
    ),
    "number in a sampled range": (
        "[sampling]\nmethod = 'sobol'\nsamples = 3\n[axes]\nkp = {min=1, max=2, num=3}",
        ["axes.kp.num", "sampling.samples"],
    ),
    "syntax": ("a = 1\nb =", ["TOML", "value"]),
    "nesting": ("a = " + "[" * 100_000, ["TOML", "nested"]),
    "digits": ("seed = " + "9" * 5000, ["TOML", "digits"]),
    "unprintable": ("'kp\\u0000\\nx' = 1", ["unknown key"]),
}


@pytest.mark.parametrize(("end", "fits"), [(0.5, True), (0.6, False)])
def test_a_push_leaves_time_to_see_what_comes_of_it(end, fits, tmp_path):
    (tmp_path / "leg.xml").write_text("<mujoco/>")
    text = (
        f"duration = 1.0\n[plant]\nmodel = 'leg.xml'\n[push]\nbody = 'a'\nimpulse = [1, 0, 0]\n"
        f"time = {end - 0.1}\nduration = 0.1\n[axes]\nkp = [1.0]"
    )
    if fits:
        assert parse(text, tmp_path).push is not None
    else:
        with pytest.raises(UserError, match=r"ends at 0\.6 s; allowed: .* up to 0\.5 s"):
            parse(text, tmp_path)


@pytest.mark.parametrize(
    "plant, allowed",
    [("", "mass, mjx"), ("[plant]\nmodel = 'leg.xml'", "mjx, mujoco, warp, auto, linear")],
)
def test_an_unknown_engine_is_answered_with_those_of_such_a_plant(plant, allowed, tmp_path):
    (tmp_path / "leg.xml").write_text("<mujoco/>")
    with pytest.raises(UserError, match=f"^engine = 'foo'; allowed: {allowed}$"):
        parse(f"engine = 'foo'\n{plant}\n[axes]\nkp = [1.0]", tmp_path)


@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_one_line_that_says_key_given_and_allowed(case, tmp_path):
    text, parts = REFUSED[case]
    path = tmp_path / "sweep.toml"
    path.write_text(text.replace("'kp\\u0000\\nx'", '"kp\\u0000\\nx"'))
    with pytest.raises(UserError) as raised:
        load(path)
    message = str(raised.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message and message.isprintable()
    for part in parts:
        assert part in message


def test_reads_every_part_of_a_specification():
    specification = parse(GOOD)
    assert specification.engine == "mass" and specification.description == "a test"
    assert [axis.name for axis in specification.axes] == ["actuator", "delay", "kp", "kd"]
    np.testing.assert_allclose(specification.axes[2].values, [10, 100, 1e3, 1e4, 1e5])
    np.testing.assert_allclose(specification.axes[3].values, [0.5, 1.0, 1.5, 2.0])
    assert specification.nominal["kp"] == 400 and specification.nominal["kd"] == 20


def test_text_reads_back_as_the_same_specification(tmp_path):
    (tmp_path / "leg.xml").write_text("<mujoco/>")
    sampled = """
    engine = "mjx"
    [plant]
    model = "leg.xml"
    keyframe = "home"
    joints = [".*_hip", ".*_knee"]
    [motion]
    kind = "chirp"
    frequency = 1.0
    end_frequency = 20.0
    [push]
    body = "trunk"
    impulse = [0, 10, 0]
    [parameters]
    zeta = 0.8
    force_limit = inf
    kd = { ".*_hip" = 3, ".*_knee" = 2 }
    [axes]
    "kp@.*_knee" = { min = 1, max = 10, spacing = "log" }
    wn = [100.0, 200.0]
    [sampling]
    method = "latin-hypercube"
    samples = 16
    """
    for text in (GOOD, sampled):
        specification = parse(text, tmp_path)
        assert parse(specification.text) == specification


def test_model_is_relative_to_the_specification(tmp_path, monkeypatch):
    monkeypatch.chdir("/")
    (tmp_path / "leg.xml").write_text("<mujoco/>")
    (tmp_path / "sweep.toml").write_text("engine='mjx'\n[plant]\nmodel='leg.xml'\n[axes]\nkp=[1]")
    assert load(tmp_path / "sweep.toml").model == tmp_path / "leg.xml"


@pytest.mark.parametrize(
    "content", [b"\xff\xfe\x00", b"\x00" * 10, b"kp" * 400_000, b"# caf\xe9\n"]
)
def test_a_file_that_is_no_text_is_refused(content, tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_bytes(content)
    with pytest.raises(UserError, match="TOML"):
        load(path)


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path):
    marked = tmp_path / "marked.toml"
    marked.write_text(GOOD, encoding="utf-8-sig")
    assert load(marked) == parse(GOOD)
    assert drives.named_by(marked) is None and not drives.is_drive(marked)


@pytest.mark.parametrize("path", ["absent.toml", ".", "/dev/zero", "absent/\n/x.toml"])
def test_a_path_that_is_no_file_is_refused(path):
    with pytest.raises(UserError, match="file"):
        load(Path(path))


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("kp=4", ({"kp": 4.0}, ["actuator", "delay", "kd"])),
        ("stiffness=4", ({"kp": 4.0}, ["actuator", "delay", "kd"])),
        ("parameters.kp=4", ({"kp": 4.0}, ["actuator", "delay", "kp", "kd"])),
        ("parameters.stiffness=4", ({"kp": 4.0}, ["actuator", "delay", "kp", "kd"])),
        ("wn=inf", None),
        ("actuator=hyq", ({"actuator": "hyq", "kp": 400.0}, ["delay", "kp", "kd"])),
        ("mass=[1, 2]", ({"mass": 0.7}, ["actuator", "delay", "kp", "kd", "mass"])),
        ("axes.mass={min=1, max=2, num=2}", ({}, ["actuator", "delay", "kp", "kd", "mass"])),
        ("axes.kp.num=7", ({}, ["actuator", "delay", "kp", "kd"])),
        (" duration = 3 ", ({}, ["actuator", "delay", "kp", "kd"])),
    ],
)
def test_overrides(override, expected, tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text(GOOD)
    if expected is None:
        with pytest.raises(UserError, match="^--set: wn: the actuator preset"):
            load(path, [override])
        return
    parameters, axes = expected
    specification = load(path, [override])
    assert [axis.name for axis in specification.axes] == axes
    assert parameters.items() <= specification.parameters.items()
    if "num" in override and "kp" in override:
        assert len(specification.axes[2]) == 7
    if "duration" in override:
        assert specification.duration == 3.0


@pytest.mark.parametrize(
    ("override", "part"),
    [
        ("kp", "key=value"),
        ("=3", "key=value"),
        ("kp.=3", "key=value"),
        ("kpp=3", "did you mean 'kp'"),
        ("mass=-1", "parameters.mass = -1"),
        ("engine=mas", "did you mean 'mass'"),
        ("duration=", "not a value"),
        ("duration='x", "not a value"),
        ("kp=1\nkd=3", "not a value"),
        ("kp=nan", "not a number"),
        ("axes.kp.num=0", "axes.kp.num = 0"),
        ("axes.delay.num=3", "not a table"),
        ("a.b.c=3", "unknown key"),
        ("actuator=spot", "not an actuator preset"),
        ("delay=[8]", "history"),
        ("axes=3", "axes = 3 is not a table"),
        ("parameters=[1]", "parameters = [1] is not a table"),
        ("plant=3", "plant = 3 is not a table"),
        ("sampling='sobol'", "sampling = 'sobol' is not a table"),
        ("axes={stiffnes=[1, 2]}", "axes.stiffnes: unknown key"),
    ],
)
def test_wrong_overrides_are_refused_by_name(override, part, tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text(GOOD)
    with pytest.raises(UserError) as raised:
        load(path, [override])
    message = str(raised.value)
    assert message.startswith("--set") and part in message and "\n" not in message


def test_a_whole_section_is_overridden_by_either_name_of_a_parameter(tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text(GOOD)
    found = load(path, ["axes={damping=[1, 2]}", "parameters={stiffness=3}"])
    assert [axis.name for axis in found.axes] == ["kd"] and found.parameters == {"kp": 3.0}
    with pytest.raises(UserError, match="^--set axes = 3 is not a table"):
        load(path, ["axes=3", "kp=4"])


@pytest.mark.parametrize("override", ["axes.inertia.num=5", "axes={inertia=[1, 2]}"])
def test_an_overridden_inertia_says_that_the_joint_is_rotary(override, tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text("[axes]\nmass = { min = 0.1, max = 1, num = 3 }")
    assert load(path).unit is None
    assert load(path, [override]).unit == "rad"
    with pytest.raises(UserError, match="^--set unit=m: an inertia is of a rotary joint"):
        load(path, [override, "engine=mass", "unit=m"])
    assert load(path, [override, "unit=m", "mass=[1, 2]"]).unit == "m"
    path.write_text('unit = "m"\n' + path.read_text())
    with pytest.raises(UserError, match="^--set inertia: is that of a rotary joint"):
        load(path, [override])


def test_the_inertia_of_a_file_is_not_taken_for_a_mass(tmp_path):
    """A number in kg m^2 would stand there in kg."""
    path = tmp_path / "sweep.toml"
    path.write_text("[axes]\nkp = [1, 2]\n[parameters]\ninertia = 0.02")
    with pytest.raises(UserError, match="^--set unit=m: an inertia is of a rotary joint"):
        load(path, ["unit=m"])
    found = load(path, ["moved_mass=0.7", "unit=m"])
    assert found.unit == "m" and found.parameters["mass"] == 0.7


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("[parameters]\n'delay@j1' = 4\n[axes]\nkp = [1]", ""),
        ("[parameters]\n'delay@j1' = 3\n'output_delay@j2' = 3\n[axes]\nkp = [1]", ""),
        ("[parameters]\n'delay@j1' = 6\n[axes]\nkp = [1]", "delay@j1 = 6"),
        ("[axes]\n'delay@j1' = [1, 6]", "delay@j1 = 6"),
        ("[axes]\n'setpoint_delay@j1' = { min = 1, max = 5, num = 3 }", "setpoint_delay@j1 = 5"),
        (
            "[parameters]\noutput_delay = 3\n'delay@j1' = 2\n[axes]\nkp = [1]",
            "delay@j1 + output_delay@j1 = 5",
        ),
    ],
)
def test_a_delay_of_some_joints_is_no_longer_than_a_loop_keeps(given, said, tmp_path):
    (tmp_path / "leg.xml").write_text("<mujoco/>")
    text = f"[plant]\nmodel = 'leg.xml'\n{given}"
    if said:
        with pytest.raises(UserError, match=f"^{re.escape(said)}: .* up to 4.096 s at 1000 Hz$"):
            parse(text, tmp_path)
    else:
        assert parse(text, tmp_path).plant is not None


def test_a_file_that_is_wrong_is_blamed_even_with_overrides(tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text(GOOD + "mass = 1\n")
    with pytest.raises(UserError, match=r"sweep.toml: axes.mass = 1"):
        load(path, ["duration=3"])


def test_default_physics_step_is_the_control_period_for_the_mass_and_a_quarter_ms_for_mjx():
    mass, mjx = parse("[axes]\nkp=[1]"), parse("engine='mjx'\n[axes]\nkp=[1]")
    assert checks.physics_step(mass, 500.0) == 0.002
    assert checks.physics_step(mjx, 500.0) == 0.00025
    given = parse("physics_step=0.0005\n[axes]\nkp=[1]")
    assert checks.physics_step(given, 500.0) == 0.0005


def test_every_parameter_has_a_default_in_its_bounds_and_says_what_it_is():
    for name, parameter in PARAMETERS.items():
        assert parameter.minimum <= parameter.default <= parameter.maximum or (
            parameter.infinite and math.isinf(parameter.default)
        )
        assert parameter.unit and parameter.description.endswith(".")
        assert canonical(parameter.long_name.replace(" ", "_")) == name == canonical(name)


_SCALARS = st.one_of(
    st.text(max_size=20),
    st.integers(),
    st.floats(),
    st.booleans(),
    st.sampled_from(["kp", "hyq", "sobol", "log", 1.0, 2, 10]),
)
_NAMES = st.one_of(
    st.sampled_from(["engine", "model", "duration", "seed", "axes", "parameters", "sampling"]),
    st.sampled_from(["kp", "kd", "wn", "zeta", "delay", "mass", "actuator", "min", "max", "num"]),
    st.sampled_from(["method", "samples", "spacing", "tile", "physics_step", "control_rate"]),
    st.text(max_size=8),
)
_VALUES = st.recursive(
    _SCALARS,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(_NAMES, inner, max_size=4)
    ),
    max_leaves=8,
)


@given(st.dictionaries(_NAMES, _VALUES, max_size=6))
@example({"axes": {"kp": {"min": 1, "max": 2, "num": 10**6}, "kd": {"min": 1, "max": 1e300}}})
def test_any_document_is_read_or_refused_in_one_line(document):
    text = toml.dumps(document)
    try:
        specification = parse(text)
    except UserError as error:
        assert str(error) and "\n" not in str(error)
    else:
        assert parse(specification.text) == specification


@given(st.dictionaries(st.text(max_size=8), _VALUES, max_size=5))
def test_written_toml_reads_back(document):
    back = tomllib.loads(toml.dumps(document))
    assert json.dumps(back, sort_keys=True) == json.dumps(document, sort_keys=True)


def test_a_setpoint_beside_positions_from_a_file_is_refused(tmp_path):
    (tmp_path / "robot.xml").write_text(PENDULUM)
    (tmp_path / "path.csv").write_text("time,j\n0,0\n1,1\n")
    text = (
        '[plant]\nmodel = "robot.xml"\n[motion]\nkind = "file"\nfile = "path.csv"\n'
        "[parameters]\nsetpoint = {}\n[axes]\nkp = [10]\n"
    )
    assert parse(text.format(0.0), tmp_path).motion.kind == "file"
    with pytest.raises(UserError, match=r"^setpoint: motion.file says .*; remove one of the two$"):
        parse(text.format(1.0), tmp_path)
