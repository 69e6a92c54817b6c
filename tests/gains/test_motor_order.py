"""Files whose lists are in the order of a policy's joints, and say which motor each of them is."""

import itertools

import pytest

from jaxact.errors import UserError
from jaxact.gains import reading
from jaxact.gains.table import matched
from jaxact.loops.reading import parse

NAMES = ("left_hip", "left_roll", "left_knee", "right_knee")
KP, KD, LIMIT = (10.5, 20.5, 30.5, 40.5), (1.0, 2.0, 3.0, 4.0), (11.0, 22.0, 33.0, 44.0)


def _rl_sar(order, names=""):
    """As rl_sar has it: entry i of the lists is motor `joint_mapping[i]`."""
    lists = {"rl_kp": KP, "rl_kd": KD, "torque_limits": LIMIT}
    rows = [f"  {key}: {[values[motor] for motor in order]}" for key, values in lists.items()]
    return "\n".join(["robot/policy:", *rows, f"  joint_mapping: {list(order)}", names])


@pytest.mark.parametrize("order", list(itertools.permutations(range(4)))[1::6])
@pytest.mark.parametrize("names", ["", f"  joint_names: {list(NAMES)}"])
def test_rl_sars_mapping_is_followed(tmp_path, order, names):
    file = tmp_path / "config.yaml"
    file.write_text(_rl_sar(order, names))
    found = matched(reading.read(file), [(name, name) for name in NAMES])
    for parameter, values in (("kp", KP), ("kd", KD), ("force_limit", LIMIT)):
        assert found.parameters[parameter] == dict(zip(NAMES, values, strict=True))
    assert ("motor i" in str(found.notes)) == (not names)


def test_without_a_mapping_the_lists_are_in_the_order_of_the_joints(tmp_path):
    file = tmp_path / "config.yaml"
    file.write_text("\n".join(_rl_sar(range(4)).splitlines()[:-1]))
    found = matched(reading.read(file), [(name, name) for name in NAMES])
    assert found.parameters["force_limit"] == dict(zip(NAMES, LIMIT, strict=True))
    assert "in the order of the model's driven joints" in str(found.notes)


@pytest.mark.parametrize("mapping", ["[0, 1, 2]", "[0, 1, 1, 2]", "[0, 1, 2, 9]", "[0, 1, 2, a]"])
def test_a_mapping_that_does_not_fit_is_refused(tmp_path, mapping):
    file = tmp_path / "config.yaml"
    file.write_text(_rl_sar(range(4)).replace("[0, 1, 2, 3]", mapping))
    with pytest.raises(UserError, match="joint_mapping"):
        reading.read(file)


def test_a_gear_that_turns_the_other_way_keeps_its_limit(tmp_path):
    file = tmp_path / "gains.xml"
    file.write_text(
        '<mujoco><actuator><position joint="left_hip" kp="5" kv="1" gear="-2"'
        ' forcerange="-10 10"/></actuator></mujoco>'
    )
    found = matched(reading.read(file), [("left_hip", "left_hip")])
    assert found.parameters["kp"]["left_hip"] == 20.0
    assert found.parameters["force_limit"]["left_hip"] == 20.0


# Unitree's H1: of its motors 0 to 19 none is number 9, and the right leg comes first.
LEGS, REST = (7, 3, 4, 5, 10, 8, 0, 1, 2, 11), (6, 16, 17, 18, 19, 12, 13, 14, 15)
LEG_KP, REST_KP = [150, 150, 150, 200, 40] * 2, [300, *[100, 100, 50, 50] * 2]


def _rl_gym(file, legs, rest=(), leg_kp=LEG_KP, rest_kp=REST_KP):
    rows = [f"leg_joint2motor_idx: {list(legs)}", f"kps: {leg_kp}", f"kds: {leg_kp}"]
    if rest:
        rows += [f"arm_waist_joint2motor_idx: {list(rest)}"]
        rows += [f"arm_waist_kps: {rest_kp}", f"arm_waist_kds: {rest_kp}"]
    file.write_text("\n".join(rows))
    return reading.read(file)


@pytest.mark.parametrize(
    ("legs", "rest", "joints", "words"),
    [(LEGS, REST, 19, "motor 19, and none of motor 9"), (LEGS, REST, 20, "none of motor 9"),
     (LEGS, (), 19, "motor 11, and none of motor 6"), ([*range(10)], (), 9, "has 9 driven joints"),
     ([*range(1, 11)], (), 12, "none of motor 0")],
)  # fmt: skip
def test_motors_that_are_not_the_joints_in_order_are_refused(tmp_path, legs, rest, joints, words):
    file = _rl_gym(tmp_path / "h1.yaml", legs, rest)
    names = [(f"joint_{i}", f"joint_{i}") for i in range(joints)]
    with pytest.raises(UserError, match=f"{words}.* give a TOML file with .kp. and .kd. of joint"):
        matched(file, names)


def test_motors_that_are_the_first_joints_are_taken(tmp_path):
    """Of a robot whose map turns the legs round, and leaves its last joints as they are."""
    motors = [3, 0, 2, 1]
    file = _rl_gym(tmp_path / "legs.yaml", motors, leg_kp=[KP[motor] for motor in motors])
    found = matched(file, [(name, name) for name in (*NAMES, "torso")])
    assert found.parameters["kp"] == dict(zip(NAMES, KP, strict=True))
    assert found.without == ("torso",)


LIST, OTHER = [3, 0, 2, 1], [0, 1, 2, 3]


def _lists(file, text):
    file.write_text(f"kps: {[KP[motor] for motor in LIST]}\nkds: {[*KD]}\n{text}\n")
    return reading.read(file)


@pytest.mark.parametrize("text", [
    f"joint2motor_idx: {LIST}", f"leg_joint2motor_idx: {OTHER[:3]}\njoint2motor_idx: {LIST}",
    f"leg_joint2motor_idx: {LIST}\njoint2motor_idx: {[*LIST, 4, 5]}",
    f"leg_joint2motor_idx: {LIST}\njoint2motor_idx: {LIST}",
])  # fmt: skip
def test_the_list_of_motors_is_the_one_that_is_as_long_as_the_gains(tmp_path, text):
    found = matched(_lists(tmp_path / "legs.yaml", text), [(name, name) for name in NAMES])
    assert found.parameters["kp"] == dict(zip(NAMES, KP, strict=True))


@pytest.mark.parametrize(("text", "words"), [
    (f"leg_joint2motor_idx: {LIST}\njoint2motor_idx: {OTHER}",
     "leg_joint2motor_idx and joint2motor_idx differ; leave one of them out"),
    (f"joint2motor_idx: {OTHER[:3]}", "kps has 4 entries and joint2motor_idx has 3"),
    ("leg_joint2motor_idx: legs", "leg_joint2motor_idx = 'legs'; give the number of each"),
    (f"leg_joint2motor_idx: {LIST}\narm_waist_joint2motor_idx: [3]\narm_waist_kps: [1]\n"
     "arm_waist_kds: [1]", "the motors of all its joints = .*, each once"),
])  # fmt: skip
def test_lists_of_motors_that_do_not_fit_are_refused(tmp_path, text, words):
    with pytest.raises(UserError, match=words) as caught:
        _lists(tmp_path / "legs.yaml", text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("which", [f"joint_names: {list(NAMES)}", "", f"joint2motor_idx: {LIST}"])
def test_gains_of_arms_that_are_not_taken_are_said(tmp_path, which):
    text = f"{which}\narm_waist_kps: [300, 100]\narm_waist_kds: [3, 1]"
    assert "arm_waist_kps, arm_waist_kds" in _lists(tmp_path / "legs.yaml", text).notes[-1]


def test_tables_of_rl_sar_that_differ_are_refused(tmp_path):
    """The gains of neither are more the robot's than those of the other."""
    file, table = tmp_path / "config.yaml", _rl_sar(range(4))
    file.write_text(f"{table}\n{table.replace('robot/', 'other/')}")
    assert reading.read(file).entries == reading.read(_alone(file, table)).entries
    file.write_text(f"{table}\n{table.replace('robot/', 'other/').replace('30.5', '31')}")
    words = "has several robots, robot/policy and other/policy, whose gains differ; name one: "
    with pytest.raises(UserError, match=f"{words}{file}:robot/policy$"):
        reading.read(file)


def test_one_of_the_robots_of_rl_sar_is_named(tmp_path, monkeypatch):
    """In full or by the last part of its name, in a specification too."""
    file, table = tmp_path / "config.yaml", _rl_sar(range(4))
    other = table.replace("robot/policy", "29dof/other-one").replace("30.5", "31")
    file.write_text(f"{table}\n{other}")
    alone = [reading.read(_alone(file, one)).entries for one in (table, other)]
    for name in ("robot/policy", "policy"):
        assert reading.read(f"{file}:{name}").entries == alone[0]
    for name in ("29dof/other-one", "other-one"):
        assert reading.read(f"{file}:{name}").entries == alone[1]
    for name in ("robot", "policies", "scene.robot"):
        with pytest.raises(UserError, match=f"has no single robot '{name}'; .*robot/policy"):
            reading.read(f"{file}:{name}")
    monkeypatch.chdir(tmp_path)  # what is a path and not a name stays one
    with pytest.raises(UserError, match="one:two/three.toml: No such file"):
        reading.read("one:two/three.toml")
    (tmp_path / "legs.xml").write_text("<mujoco/>")
    text = '[plant]\nmodel = "legs.xml"\ngains = "config.yaml:29dof/other-one"\n[axes]\nkp = [1]\n'
    plant = parse(text, tmp_path).plant
    assert plant is not None and reading.read(plant.gains).entries == alone[1]


def _alone(file, text):
    other = file.with_name("alone.yaml")
    other.write_text(text)
    return other
