"""Gains in other people's files: read by content, matched by name, written and read back."""

import itertools
import json
import random
import re

import hypothesis.strategies as st
import mujoco
import numpy as np
import pytest
from command_line import jaxact
from hypothesis import given, settings

import jaxact as jx
from jaxact.environments.gain_formats import FORMATS
from jaxact.errors import UserError
from jaxact.gains import reading
from jaxact.gains.table import matched
from jaxact.loops import robots

NAMES = ("left_hip_joint", "left_hip_roll_joint", "left_knee_joint", "right_knee_joint")
ACTUATORS = tuple(name.removesuffix("_joint") for name in NAMES)
PAIRS = list(zip(NAMES, ACTUATORS, strict=True))


def model_text(actuators=True, damping=0.0, ranges='range="-2 2"'):
    """Links that hang one below the other, each with a position actuator."""
    body = ""
    for name in reversed(NAMES):
        body = (
            f'<body pos="0 0 -0.2"><joint name="{name}" axis="0 1 0" armature="0.01" {ranges} '
            f'damping="{damping}"/><geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.2" '
            f'contype="0" conaffinity="0"/>{body}</body>'
        )
    rows = "".join(
        f'<position name="{short}" joint="{name}" kp="40" kv="1" forcerange="-30 30"/>'
        for name, short in PAIRS
    )
    section = f"<actuator>{rows}</actuator>" if actuators else ""
    key = '<keyframe><key name="home" qpos="0.1 -0.2 0.3 -0.4"/></keyframe>'
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="0.001"/><worldbody>{body}</worldbody>'
        f"{section}{key}</mujoco>"
    )


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("gains") / "legs.xml"
    path.write_text(model_text())
    return path


def gains_of(model, file, **more):
    """kp and kd of the joints of the robot that has them from a file."""
    joints = robots.read(jx.robot(model, gains=file, **more).kind.plant).joints
    return {one.name: (one.kp, one.kd) for one in joints}


DEPLOY = """joint_ids_map: [2, 0, 3, 1]
joint_names: [left_knee_joint, left_hip_joint, right_knee_joint, left_hip_roll_joint]
step_dt: 0.02
stiffness: [10.5, 20.5, 30.5, 40.5]   # in the order of the motors
damping: [1, 2, 3, 4]
"""
RL_GYM = "kps: [10.5, 20.5, 30.5, 40.5]\nkds: [1, 2, 3, 4]\nsimulation_dt: 0.002\n"
RL_SAR = """legs/robot_lab:
  joint_names: ["left_knee_joint", "left_hip_joint", "right_knee_joint", "left_hip_roll_joint"]
  rl_kp: [30.5, 10.5, 40.5, 20.5]
  rl_kd: [3, 1, 4, 2]
  fixed_kp: [80, 80, 80, 80]
  fixed_kd: [3, 3, 3, 3]
"""
LEGGED_GYM = """
class LegsCfg(LeggedRobotCfg):
    class control(LeggedRobotCfg.control):
        stiffness = {"hip": 10.5, "hip_roll": 20.5, "left_knee": 61 / 2, "right_knee": 40.5}
        damping = {"hip": 1.0, "hip_roll": 2, "left_knee": 3, "right_knee": 4}
"""
ISAAC_LAB = """
import math
SCALE = 2.0 * math.pi
LEGS_CFG = ArticulationCfg(
    spawn=sim_utils.UsdFileCfg(usd_path=f"{ROOT}/legs.usd"),
    actuators={
        "hips": DCMotorCfg(joint_names_expr=[".*_hip_joint", ".*_hip_roll_joint"],
            stiffness={".*_hip_joint": 10.5, ".*_roll_joint": 20.5},
            damping={".*_hip_joint": SCALE / (2 * math.pi), ".*_roll_joint": 2.0},
            effort_limit=23.5, velocity_limit=30.0),
        "knee": DCMotorCfg(joint_names_expr=["left_knee.*"], stiffness=30.5, damping=3.0),
        "other": DCMotorCfg(joint_names_expr=["right_knee.*"], stiffness=40.5, damping=4.0),
    },
)
"""
ENV_YAML = """
sim: {dt: 0.005, gravity: !!python/tuple [0.0, 0.0, -9.81]}
scene:
  robot:
    class_type: isaaclab.assets.articulation.articulation:Articulation
    spawn: {func: !!python/name:isaaclab.sim.spawn ''}
    actuators:
      hips:
        joint_names_expr: [.*_hip_joint, .*_hip_roll_joint]
        effort_limit: null
        effort_limit_sim: 23.5
        stiffness: {.*_hip_joint: 10.5, .*_hip_roll_joint: 20.5}
        damping: {.*_hip_joint: 1.0, .*_hip_roll_joint: 2.0}
      left:
        joint_names_expr: !!python/tuple [left_knee_joint]
        stiffness: 30.5
        damping: 3.0
      right: {joint_names_expr: [right_knee_joint], stiffness: 40.5, damping: 4.0}
"""
MJLAB = """
ARMATURE = 0.02
HIP = BuiltinPositionActuatorCfg(target_names_expr=(".*_hip_joint",), stiffness=10.5, damping=1.0)
ROLL = BuiltinPositionActuatorCfg(target_names_expr=(".*roll.*",), stiffness=20.5, damping=2.0)
LEFT = BuiltinPositionActuatorCfg(target_names_expr=("left_knee_joint",), stiffness=30.5,
    damping=150 * ARMATURE, armature=ARMATURE)
RIGHT = BuiltinPositionActuatorCfg(target_names_expr=("right_knee_joint",), stiffness=40.5,
    damping=4.0)
"""
TOML = '[kp]\n".*hip_joint" = 10.5\n".*roll.*" = 20.5\nleft_knee_joint = 30.5\nright_knee = 40.5\n'
TOML += '[kd]\n".*hip_joint" = 1\n".*roll.*" = 2\nleft_knee_joint = 3\nright_knee = 4\n'
MJCF = "<mujoco><actuator>" + "".join(
    f'<position joint="{name}" kp="{kp}" kv="{kd}"/>'
    for name, kp, kd in zip(NAMES, (10.5, 20.5, 30.5, 40.5), (1, 2, 3, 4), strict=True)
) + "</actuator></mujoco>"  # fmt: skip
FILES = {
    "deploy.yaml": ("deploy-yaml", DEPLOY),
    "gym.yaml": ("rl-gym", RL_GYM),
    "config.yaml": ("rl-sar", RL_SAR),
    "legs_config.py": ("legged-gym", LEGGED_GYM),
    "legs.py": ("isaaclab", ISAAC_LAB),
    "env.yaml": ("isaaclab", ENV_YAML),
    "constants.py": ("mjlab", MJLAB),
    "gains.toml": ("toml", TOML),
    "gains.xml": ("mjcf", MJCF),
}
EXPECTED = dict(zip(NAMES, zip((10.5, 20.5, 30.5, 40.5), (1, 2, 3, 4), strict=True), strict=True))


@pytest.mark.parametrize("name", FILES)
def test_every_format_is_told_from_its_content(model, tmp_path, name):
    kind, text = FILES[name]
    file = tmp_path / name
    file.write_text(text)
    assert reading.read(file).format == kind
    found = gains_of(model, file)
    for joint, pair in EXPECTED.items():
        assert found[joint] == pytest.approx(pair, rel=1e-15)


@pytest.mark.parametrize("order", list(itertools.permutations(range(4)))[1::5])
def test_a_permuted_joint_map_gives_the_same_by_name(model, tmp_path, order):
    """The gains stay in the order of the motors, whatever the order of the policy's joints."""
    motors = {"left_hip_joint": 0, "left_hip_roll_joint": 1, "left_knee_joint": 2,
              "right_knee_joint": 3}  # fmt: skip
    names = [NAMES[i] for i in order]
    file = tmp_path / "deploy.yaml"
    file.write_text(
        f"joint_ids_map: {[motors[name] for name in names]}\njoint_names: {names}\n"
        "stiffness: [10.5, 20.5, 30.5, 40.5]\ndamping: [1, 2, 3, 4]\n"
    )
    assert gains_of(model, file) == EXPECTED


def test_unused_motors_have_no_joint(model, tmp_path):
    """Without names the motors that the map names are the driven joints, in their order."""
    file = tmp_path / "deploy.yaml"
    file.write_text(
        "joint_ids_map: [5, 0, 2, 3]\nstiffness: [10.5, 0, 20.5, 30.5, 0, 40.5]\n"
        "damping: [1, 0, 2, 3, 0, 4]\n"
    )
    assert gains_of(model, file) == EXPECTED


def test_a_joint_of_legged_gym_takes_the_last_key_in_its_name(tmp_path):
    """As its loop over all keys does, which this restates."""
    keys = {"hip": 1.0, "left": 2.0, "knee": 3.0, "right_k": 4.0}
    file = tmp_path / "c.py"
    file.write_text(f"class control:\n    stiffness = {keys}\n    damping = {keys}\n")
    found = matched(reading.read(file), PAIRS).parameters["kp"]
    for name in NAMES:
        wanted = None
        for key, value in keys.items():
            if key in name:
                wanted = value
        assert found.get(name) == wanted


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("seed", range(3))
def test_what_is_written_is_read_back_with_all_digits(model, tmp_path, kind, seed):
    rng = random.Random(f"{kind} {seed}")
    kp = {name: 10 ** rng.uniform(-3, 4) for name in NAMES}
    kd = {name: 10 ** rng.uniform(-6, 2) for name in NAMES}
    loop = jx.robot(model, kp=kp, kd=kd, keyframe="home")
    suffix = {"mjcf": ".xml", "toml": ".toml", "deploy-yaml": ".yaml", "rl-gym": ".yaml"}
    file = tmp_path / f"gains{suffix.get(kind, '.py')}"
    written = jx.export(loop, kind, file)
    assert file.read_text() == written.text
    found = gains_of(model, file)
    for name in NAMES:
        assert found[name] == pytest.approx((kp[name], kd[name]), rel=1e-14)
    assert reading.read(file).format == kind


@pytest.mark.exhaustive
def test_margins_of_gains_that_went_out_and_in_are_the_same(model, tmp_path):
    loop = jx.robot(model, kp=35.7, kd=1.23, gain_scale=1.1, delay=2e-3, keyframe="home")
    jx.export(loop, "deploy-yaml", tmp_path / "deploy.yaml")
    again = jx.robot(model, gains=tmp_path / "deploy.yaml", delay=2e-3, keyframe="home")
    before, after = jx.margins(loop), jx.margins(again)
    for name in ("gain_margin", "delay_margin", "sensitivity_peak", "growth_rate"):
        assert float(getattr(after, name)) == pytest.approx(float(getattr(before, name)), rel=1e-9)


def test_written_mjcf_compiles_and_has_the_gains(model, tmp_path):
    text = jx.export(jx.robot(model, kp=12.5, kd=0.75), "mjcf").text
    section = re.search(r"<actuator>.*</actuator>", text, re.DOTALL)[0]
    compiled = mujoco.MjModel.from_xml_string(
        model_text(actuators=False).replace("<keyframe>", section + "<keyframe>")
    )
    np.testing.assert_allclose(compiled.actuator_gainprm[:, 0], 12.5)
    np.testing.assert_allclose(compiled.actuator_biasprm[:, 2], -0.75)
    np.testing.assert_allclose(compiled.actuator_forcerange, [[-30, 30]] * 4)


@pytest.mark.parametrize("kind", ("legged-gym", "isaaclab", "mjlab"))
def test_written_configurations_are_python(model, kind):
    """And hold what the frameworks would look up, with stand-ins for their classes."""
    found = {}

    class Cfg:
        def __init__(self, **fields):
            self.__dict__.update(fields)

    text = re.sub(
        r"^from .*$", "", jx.export(jx.robot(model, kp=3.25, kd=0.5), kind).text, flags=re.M
    )
    exec(text, {"IdealPDActuatorCfg": Cfg, "IdealPdActuatorCfg": Cfg}, found)
    if kind == "legged-gym":
        assert found["control"].stiffness == dict.fromkeys(NAMES, 3.25)
    elif kind == "isaaclab":
        assert found["ACTUATORS"]["joints"].damping == dict.fromkeys(NAMES, 0.5)
    else:
        assert [one.stiffness for one in found["ACTUATORS"]] == [3.25]


def test_a_name_that_is_part_of_another_does_not_take_its_gains(model, tmp_path):
    """left_hip is part of left_hip_roll."""
    loop = jx.robot(
        model, kp={".*": 2.0, "left_hip_joint": 1.0, "left_hip_roll_joint": 3.0}, kd=0.1
    )
    jx.export(loop, "legged-gym", tmp_path / "c.py")
    found = gains_of(model, tmp_path / "c.py")
    assert (found["left_hip_joint"][0], found["left_hip_roll_joint"][0]) == (1.0, 3.0)


@pytest.mark.exhaustive
def test_a_result_that_was_tuned_is_exported(model, tmp_path):
    best = jx.tune(jx.robot(model, keyframe="home", delay=1e-3), max_peak=1.6, steps=20, starts=1)
    found = jx.export(best, "toml", tmp_path / "gains.toml").joints
    np.testing.assert_allclose(found.kp, best.kp, rtol=1e-9)
    again = list(gains_of(model, tmp_path / "gains.toml").values())
    np.testing.assert_allclose(again, np.transpose([best.kp, best.kd]), rtol=1e-9)


def test_what_does_not_match_is_listed(model, tmp_path):
    file = tmp_path / "gains.toml"
    file.write_text("[kp]\nleft_hip_joint = 5\nneck = 3\n[kd]\nleft_hip_joint = 1\nneck = 1\n")
    with pytest.warns(jx.GainsWarning, match="gains.toml: of none of the robot's joints: neck"):
        robot = robots.read(jx.robot(model, gains=file).kind.plant)
    words = robot.findings[-1].advice
    assert "neck" in words and "right_knee_joint" in words
    assert robot.joints[0].kp == 5.0 and robot.joints[3].kp == 40.0  # the model's own


def test_parameters_of_the_drive_in_a_file_of_gains_are_said_not_to_be_taken(model, tmp_path):
    file = tmp_path / "gains.toml"
    file.write_text("[kp]\n'.*' = 5\n[kd]\n'.*' = 1\n[delay]\n'.*' = 0.003\n[about]\nby = 'me'\n")
    words = robots.read(jx.robot(model, gains=file).kind.plant).findings[-1].advice
    assert words.endswith("not taken, to be given as parameters: delay")


def test_damping_that_stood_for_kd_is_said(tmp_path):
    text = model_text(damping=1.5).replace('kv="1"', "")
    path = tmp_path / "legs.xml"
    path.write_text(text)
    file = tmp_path / "gym.yaml"
    file.write_text(RL_GYM)
    words = robots.read(jx.robot(path, gains=file).kind.plant).findings[-1].advice
    assert "damping of their own" in words
    inside = robots.read(jx.robot(path, gains=file, damping="drive").kind.plant)
    assert inside.joints[0].kd == 1.0 and not inside.model.dof_damping.any()
    assert "damping of their own" not in inside.findings[-1].advice


def test_a_store_knows_what_the_file_said(model, tmp_path):
    """The digest of the robot follows the numbers, not the file's place."""
    first, second = tmp_path / "a.yaml", tmp_path / "b.yaml"
    first.write_text(RL_GYM)
    second.write_text(RL_GYM + "# the same\n")

    def digest(file):
        return robots.read(jx.robot(model, gains=file).kind.plant).digest

    assert digest(first) == digest(second)
    second.write_text(RL_GYM.replace("10.5", "10.6"))
    assert digest(first) != digest(second)


BAD = {
    "lengths.yaml": ("kps: [1, 2]\nkds: [1]\n", "kds has 1"),
    "words.yaml": ("kps: [1, two]\nkds: [1, 2]\n", "kps"),
    "count.yaml": ("kps: [1, 2]\nkds: [1, 2]\n", "4 driven joints"),
    "negative.yaml": ("kps: [1, 2, 3, -4]\nkds: [1, 2, 3, 4]\n", "-4"),
    "nan.yaml": ("kps: [1, 2, 3, .nan]\nkds: [1, 2, 3, 4]\n", "nan"),
    "twice.yaml": (DEPLOY.replace("[2, 0, 3, 1]", "[2, 0, 3, 3]"), "joint_ids_map"),
    "beyond.yaml": (DEPLOY.replace("[2, 0, 3, 1]", "[2, 0, 3, 9]"), "motor 9"),
    "other.yaml": ("policy: walk\n", "no gains"),
    "broken.yaml": ("kps: [1, 2\nkds: [1\n", "YAML"),
    "empty.yaml": ("", "not a file of gains"),
    "computed.py": (MJLAB.replace("0.02", "inertia(3)"), "line 2"),
    "key.py": ('A = X(joint_names_expr=[".*"], stiffness={[1]: 3}, damping=1)\n', "line 1"),
    "nothing.py": ("x = 1\n", "neither"),
    "syntax.py": ("def f(:\n", "line 1"),
    "overlap.py": (MJLAB.replace(".*_hip_joint", ".*hip.*"), "both give"),
    "lonely.toml": ("[gains]\nkp = 3\nkd = 1\n", "single joint"),
    "names.toml": ("[kp]\nneck = 1\n[kd]\nneck = 1\n", "none of its joints"),
    "pattern.toml": ('[kp]\n"(" = 1\n[kd]\n"(" = 1\n', "regular expression"),
    "text.toml": ('[kp]\nneck = "1"\n[kd]\nneck = 1\n', "give a number"),
    "urdf.xml": ("<robot/>", "not MJCF"),
    "bare.xml": ("<mujoco><actuator/></mujoco>", "no position actuators"),
    "policy.onnx": ("x\0y", "not an ONNX file"),
    "policy.pt": ("x\0y", "not a text file"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_read_is_said_in_a_line(model, tmp_path, name):
    text, words = BAD[name]
    file = tmp_path / name
    file.write_text(text)
    with pytest.raises(UserError, match=re.escape(words)) as caught:
        gains_of(model, file)
    assert "\n" not in str(caught.value)


WRONG = ("-1.5", "1e999", "many", "", "[1, 2]", '"', "nan")


@pytest.mark.parametrize("name", FILES)
def test_malformed_files_are_refused_in_a_line_by_the_command_line(model, tmp_path, name):
    """Each stiffness made negative, infinite, a word, nothing, a list, a quote, not a number: more
    than 200 files in all."""
    text = FILES[name][1]
    for number in ("10.5", "20.5", "30.5", "40.5"):
        for wrong in WRONG if number in text else ():
            file = tmp_path / name
            file.write_text(text.replace(number, wrong))
            ran = jaxact("check", model, "--gains", file)
            assert ran.returncode == 2 and ran.stderr.startswith("jaxact: "), (number, wrong)
            assert ran.stderr.count("\n") == 1 and not ran.stdout, (number, wrong)


def onnx(**metadata):
    """A policy, as Protocol Buffers encode it: some fields of each kind, and the metadata."""

    def message(field, content):
        assert len(content) < 2**14
        size = len(content)
        length = bytes([size]) if size < 128 else bytes([size & 127 | 128, size >> 7])
        return bytes([field << 3 | 2]) + length + content

    graph = message(2, b"main") + message(5, b"\x00" * 300) + b"\x0d\x01\x02\x03\x04"
    parts = [b"\x08\x0a", message(2, b"pytorch"), message(7, graph)]
    for key, value in metadata.items():
        parts.append(message(14, message(1, key.encode()) + message(2, value.encode())))
    return b"".join(parts)


POLICY = {
    "joint_names": ",".join(reversed(NAMES)), "joint_stiffness": "40.500,30.500,20.500,10.500",
    "joint_damping": "4.000,3.000,2.000,1.000", "default_joint_pos": "0,0,0,0",
}  # fmt: skip


def test_gains_of_a_policy_are_read_from_its_metadata(model, tmp_path):
    file = tmp_path / "policy.onnx"
    file.write_bytes(onnx(**POLICY))
    assert gains_of(model, file) == EXPECTED and reading.read(file).format == "onnx"
    assert "default_joint_pos" in reading.read(file).notes[0]
    for change, words in (
        ({"joint_damping": "4,3,2"}, "4 entries"), ({"joint_stiffness": "1,2,x,4"}, "give numbers"),
        ({"joint_names": "a,a,b,c"}, "twice"), ({"joint_stiffness": "1,2,-3,4"}, "-3"),
    ):  # fmt: skip
        file.write_bytes(onnx(**POLICY | change))
        with pytest.raises(UserError, match=words):
            gains_of(model, file)
    file.write_bytes(onnx(joint_names="a"))
    with pytest.raises(UserError, match="no joint_stiffness"):
        gains_of(model, file)


@settings(max_examples=300)
@given(st.integers(0, 10_000), st.binary(min_size=1, max_size=4))
def test_damaged_policies_are_read_or_refused(tmp_path_factory, place, new):
    raw = bytearray(onnx(**POLICY))
    at = place % len(raw)
    raw[at : at + len(new)] = new
    file = tmp_path_factory.getbasetemp() / "damaged.onnx"
    file.write_bytes(bytes(raw))
    try:
        matched(reading.read(file), PAIRS)
    except UserError as error:
        assert "\n" not in str(error)


def test_several_configurations_of_a_source_have_names(model, tmp_path):
    file = tmp_path / "robots.py"
    file.write_text(ISAAC_LAB + ISAAC_LAB.replace("LEGS_CFG", "ARMS_CFG").replace("10.5", "99.5"))
    with pytest.raises(UserError, match="name one"):
        gains_of(model, file)
    assert gains_of(model, f"{file}:LEGS_CFG") == {
        name: pytest.approx(pair) for name, pair in EXPECTED.items()
    }
    assert gains_of(model, f"{file}:ARMS_CFG")["left_hip_joint"][0] == 99.5
    with pytest.raises(UserError, match="LEGS_CFG"):
        gains_of(model, f"{file}:LEGS")


@settings(max_examples=400)
@given(
    st.sampled_from(sorted(FILES)),
    st.lists(
        st.tuples(st.floats(0, 1), st.sampled_from("dict"), st.binary(max_size=3)), max_size=4
    ),
)
def test_damaged_files_are_read_or_refused_in_a_line(tmp_path_factory, name, damages):
    """Bytes deleted, inserted, changed, and the end cut off."""
    raw = bytearray(FILES[name][1].encode())
    for place, kind, new in damages:
        at = int(place * len(raw))
        if kind == "c":
            del raw[at:]
        elif kind == "d":
            del raw[at : at + 7]
        else:
            raw[at : at + (len(new) if kind == "t" else 0)] = new
    file = tmp_path_factory.getbasetemp() / f"damaged_{name}"
    file.write_bytes(bytes(raw))
    try:
        matched(reading.read(file), PAIRS)
    except UserError as error:
        assert "\n" not in str(error)


def test_the_command_line_takes_gains(model, tmp_path):
    file = tmp_path / "deploy.yaml"
    file.write_text(DEPLOY)
    found = json.loads(jaxact("check", model, "--gains", file, "--json").stdout)
    assert [one["kp"] for one in found["joints"]] == [10.5, 20.5, 30.5, 40.5]
    shown = jaxact("margins", "--model", model, "--gains", file, "--delay", "0.001")
    assert "40.5" in shown.stdout and "step_dt" in shown.stderr
    out = tmp_path / "out.py"
    done = jaxact("export", file, "--to", "isaaclab", "--model", model, "--out", out)
    assert "4 joints" in done.stdout and gains_of(model, out) == EXPECTED
    file.write_text("kps: [1]\nkds: [1]\n")
    again = jaxact("export", file, "--to", "toml", "--model", model, "--out", out)
    bad = jaxact("margins", "--model", model, "--gains", file)
    for ran, word in ((bad, "4 driven joints"), (again, "--overwrite")):
        assert ran.returncode == 2 and ran.stderr.startswith("jaxact: ") and word in ran.stderr
        assert ran.stderr.count("\n") == 1


@pytest.mark.exhaustive
def test_a_sweep_takes_gains(model, tmp_path):
    """Their file is named from here, the specification's model from its own folder."""
    (tmp_path / "gym.yaml").write_text(RL_GYM)
    spec = tmp_path / "specs" / "map.toml"
    spec.parent.mkdir()
    spec.write_text(
        f'engine = "mujoco"\nduration = 0.2\n[plant]\nmodel = "{model}"\n[parameters]\n'
        "delay = 0.001\n[axes]\ngain_scale = [0.5, 1.0]\n"
    )
    ran = jaxact("sweep", spec, "--gains", "gym.yaml", "--out", "found", "--quiet", cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    found = jx.load_result(tmp_path / "found")
    assert "gym.yaml" in found.attrs["specification"]
    alone = jx.sweep(spec)
    assert not np.allclose(found.growth_rate, alone.growth_rate)
