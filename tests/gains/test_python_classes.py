"""Gains that classes of a Python source hold or set: as running the file gives, or refused."""

import copy
import re
import types

import pytest

from jaxact.errors import UserError
from jaxact.gains import reading
from jaxact.gains.table import matched

JOINTS = [("hip", "hip"), ("knee", "knee")]
A = 'A_CFG = RobotCfg(actuators={"legs": LegCfg(joint_names_expr=[".*"], stiffness=%s, '
A += "damping=0.5)}, init_state=SceneCfg(pos=(0.0, 0.0, 0.4)))\n"
PLAIN = A % "25.0"
LEGS = '{"legs": LegCfg(joint_names_expr=[".*"], stiffness=60.0, damping=6.0)}'
STIFF = (
    "@configclass\nclass StiffEnvCfg(DirectRLEnvCfg):\n"
    f'    robot = A_CFG.replace(prim_path="x", actuators={LEGS})\n'
)
NESTED = (
    f"@configclass\nclass SceneEnvCfg(EnvCfg):\n    @configclass\n    class scene(SceneCfg):\n"
    f"        num_envs = 3\n        robot: RobotCfg = RobotCfg(actuators={LEGS})\n"
)
START = "@configclass\nclass GoEnvCfg(EnvCfg):\n    def __post_init__(self):\n"
USE = '        self.scene.robot = A_CFG.replace(prim_path="x")\n'
CHANGE = '        self.scene.robot.actuators["legs"].stiffness = 60.0\n'
GYM = """
class A1Cfg(LeggedRobotCfg):
    class control(LeggedRobotCfg.control):
        stiffness = {"hip": 20.0, "knee": 20.0}
        damping = {"hip": 0.5, "knee": 0.5}
"""


class Cfg:
    """Keeps copies of what its class has and what it is given, as Isaac Lab's classes do."""

    def __init__(self, **fields):
        self.scene = types.SimpleNamespace()
        for one in reversed(type(self).__mro__[:-2]):
            for name in [name for name in vars(one) if name[:2] != "__"]:
                value = vars(one)[name]
                self.__dict__[name] = value() if name == "scene" else copy.deepcopy(value)
        self.__dict__.update(copy.deepcopy(fields))
        self.__post_init__()

    def __post_init__(self):
        pass

    def copy(self):
        return copy.deepcopy(self)

    def replace(self, **fields):
        return type(self)(**{**self.__dict__, **fields})


CLASSES = "RobotCfg LegCfg EnvCfg SceneCfg DirectRLEnvCfg MotorCfg".split()


def ran(text, name):
    """kp and kd of both joints after the source has run and the class has been made."""
    names = dict.fromkeys(CLASSES, Cfg) | {"configclass": lambda cls: cls, "copy": copy}
    exec(text, names)
    of = names[name.split(".")[0]]
    of = of() if isinstance(of, type) else of
    for part in name.split(".")[1:]:
        of = getattr(of, part)
    while not hasattr(of, "actuators"):
        of = of.robot if hasattr(of, "robot") else of.scene
    (group,) = of.actuators.values()
    return dict.fromkeys(("hip", "knee"), (group.stiffness, group.damping))


def read(tmp_path, text, name=None):
    file = tmp_path / "robots.py"
    file.write_text(text)
    return reading.read(file if name is None else f"{file}:{name}")


def gains(tmp_path, text, name=None):
    """kp and kd of the two joints."""
    found = matched(read(tmp_path, text, name), JOINTS).parameters
    return {joint: (found["kp"][joint], found["kd"][joint]) for joint in found["kp"]}


FOLLOWED = {
    "field": (PLAIN + STIFF, "StiffEnvCfg.robot"),
    "class": (PLAIN + STIFF, "StiffEnvCfg"),
    "module": (PLAIN + STIFF, "A_CFG"),
    "only a field": (STIFF.replace("A_CFG.replace", "RobotCfg"), None, "StiffEnvCfg"),
    "nested": (PLAIN + NESTED, "SceneEnvCfg.scene.robot"),
    "nested class": (PLAIN + NESTED, "SceneEnvCfg"),
    "only nested": (NESTED, None, "SceneEnvCfg"),
    "inherited": (PLAIN + STIFF + "@configclass\nclass Play(StiffEnvCfg):\n    n = 3\n", "Play"),
    "overridden": (PLAIN + STIFF + "@configclass\nclass Play(StiffEnvCfg):\n    robot = A_CFG\n",
                   "Play"),
    "class of actuators": (f"class GoCfg(RobotCfg):\n    actuators = {LEGS}\n", None, "GoCfg"),
    "object": (PLAIN + STIFF + "ENV = StiffEnvCfg(n=3)\n", "ENV"),
    "object's own": (PLAIN + STIFF + "ENV = StiffEnvCfg(robot=A_CFG)\n", "ENV"),
    "same": (PLAIN + "class EnvCfg_(EnvCfg):\n    robot = A_CFG\n", None, "A_CFG"),
    "method that uses": (PLAIN + START + USE, None, "GoEnvCfg"),
    "method that uses it as it is": (PLAIN + START + "        self.scene.robot = A_CFG\n", None,
                                     "A_CFG"),
    "method that changes a copy": (PLAIN + START + USE + CHANGE, "A_CFG"),
    "method that replaces": (PLAIN + START + f"        self.scene.robot = A_CFG.replace("
                             f"actuators={LEGS})\n", "A_CFG"),
    "method that changes a deep copy": (PLAIN + START + "        robot = copy.deepcopy(A_CFG)\n"
                                        "        robot.actuators['legs'].damping = 3.0\n", "A_CFG"),
    "method that sets other fields": (
        PLAIN + START + USE + "        self.decimation = 4\n"
        "        self.start = A_CFG.init_state.pos\n"
        "        self.scale = 0.25 / A_CFG.actuators['legs'].stiffness\n"
        "        self.scene.robot.soft_limit = 0.9\n"
        "        self.scene.robot.actuators['legs'].min_delay = 4\n", None, "GoEnvCfg"),
    "field that a method changes": (PLAIN + STIFF.replace(f", actuators={LEGS}", "")
                                    + START[START.index("    def"):]
                                    + CHANGE.replace(".scene", ""), "A_CFG"),
    "object of a class that uses": (PLAIN + START + USE + "ENV = GoEnvCfg(n=3)\n", "A_CFG"),
    "object that a method leaves": (
        PLAIN + STIFF + "    def __post_init__(self):\n        self.decimation = 4\n"
        "ENV = StiffEnvCfg(n=3)\n", "ENV"),
    "actuator's class": (PLAIN + "class Motor:\n    def __init__(self, cfg):\n"
                         "        self.stiffness = cfg.stiffness\n", None, "A_CFG"),
}  # fmt: skip


@pytest.mark.parametrize("case", FOLLOWED)
def test_what_is_read_of_a_class_is_what_making_it_gives(tmp_path, case):
    text, name, *same = FOLLOWED[case]
    assert gains(tmp_path, text, name) == ran(text, (same or [name])[0])


def test_a_name_is_asked_for_where_a_class_holds_other_gains(tmp_path):
    for text, name in ((STIFF, "StiffEnvCfg.robot"), (NESTED, "SceneEnvCfg.scene.robot")):
        words = f"has several configurations; name one: .*A_CFG.* {name}"
        with pytest.raises(UserError, match=words):
            gains(tmp_path, PLAIN + text)


ALIAS = "        self.scene.robot = A_CFG\n"
HELPER = "def stiffen(cfg):\n    cfg.actuators['legs'].stiffness = 60.0\n"
REFUSED = {
    "changes": (USE + CHANGE, "line 6"),
    "loop": (USE + "        for one in self.scene.robot.actuators.values():\n"
             "            one.stiffness *= 2\n", "line 7"),
    "local": (USE + '        legs = self.scene.robot.actuators["legs"]\n'
              "        legs.damping = 3.0\n", "line 7"),
    "replaces": (f"        self.scene.robot = A_CFG.replace(actuators={LEGS})\n", "line 5"),
    "creates": ("        self.scene.robot = RobotCfg(actuators={'a': MotorCfg(joint_names_expr="
                "['.*'], stiffness=1.0, damping=2.0)})\n", "line 5"),
    "setattr": (USE + '        setattr(self.scene.robot.actuators["legs"], NAME, 3.0)\n', "line 6"),
    "update": (USE + "        self.scene.robot.actuators.update(OTHERS)\n", "line 6"),
    "entry": (USE + "        self.scene.robot.actuators['legs'] = OTHER\n", "line 6"),
    "given away": (USE + "        soften(self.scene.robot)\n", "line 6"),
    "given away with it": (USE + "        soften(self.scene)\n", "line 6"),
    "method of it": (USE + "        self.stiffen()\n    def stiffen(self):\n" + CHANGE, "line 8"),
    "inherited method": (USE + CHANGE + "class Play(GoEnvCfg):\n    n = 3\n", "line 6"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_a_method_does_to_gains_is_refused_with_the_line(tmp_path, case):
    text, words = REFUSED[case]
    for name in (None, "GoEnvCfg", *(["Play"] if "Play" in text else [])):
        with pytest.raises(UserError, match=words) as caught:
            gains(tmp_path, PLAIN + START + text, name)
        assert "\n" not in str(caught.value)
    assert gains(tmp_path, PLAIN + START + text, "A_CFG")["hip"] == (25.0, 0.5)


MAY_CHANGE = {
    "as it is": (PLAIN + START + ALIAS + CHANGE, "line 6"),
    "local": (PLAIN + START + "        robot = A_CFG\n        robot.actuators = {}\n", "line 6"),
    "function": (HELPER + PLAIN + START + "        stiffen(A_CFG)\n", "line 2"),
    "elsewhere": (PLAIN + START + "        soften(A_CFG)\n", "line 5"),
    "directly": (PLAIN + START + "        A_CFG.actuators['legs'].stiffness = 1.0\n", "line 5"),
    "a plain class's field": (PLAIN + "class E:\n    robot = A_CFG\n    def __init__(self):\n"
                              "        self.robot.actuators['legs'].stiffness = 1.0\n", "line 5"),
}  # fmt: skip


@pytest.mark.parametrize("case", MAY_CHANGE)
def test_a_configuration_that_a_method_may_change_itself_is_refused(tmp_path, case):
    text, words = MAY_CHANGE[case]
    for name in (None, "A_CFG"):
        with pytest.raises(UserError, match=words):
            gains(tmp_path, text, name)


@pytest.mark.parametrize("text", (
    f"@dataclass\nclass E:\n    robot: RobotCfg = field(default_factory=lambda: RobotCfg("
    f"actuators={LEGS}))\n",
    f"if FAST:\n    B_CFG = RobotCfg(actuators={LEGS})\n",
    f"class E:\n    if FAST:\n        robot = RobotCfg(actuators={LEGS})\n",
    "@configclass\nclass E(EnvCfg):\n    def __post_init__(self):\n"
    "        self.scene.robot = A_CFG.replace(**FIELDS)\n",
    "@configclass\nclass E(EnvCfg):\n    def __post_init__(self):\n"
    "        self.scene.robot.actuators['legs'].__setattr__('stiffness', 3.0)\n",
))  # fmt: skip
def test_no_configuration_is_left_out_without_a_word(tmp_path, text):
    with pytest.raises(UserError, match="A_CFG.* cannot be read: line [3-6]: "):
        gains(tmp_path, PLAIN + text)
    assert gains(tmp_path, PLAIN + text, "A_CFG")["hip"] == (25.0, 0.5)


def test_all_that_is_refused_for_the_same_reason_is_said_once(tmp_path):
    text = START + CHANGE + "class Play(GoEnvCfg):\n    n = 3\n"
    with pytest.raises(UserError, match="robots.py line 4: sets gains in `GoEnvCfg.__post_init__`"):
        gains(tmp_path, text)


def test_a_helper_that_changes_a_copy_leaves_the_configuration(tmp_path):
    text = HELPER + PLAIN + START + USE + "        stiffen(self.scene.robot)\n"
    assert gains(tmp_path, text, "A_CFG") == ran(text, "A_CFG")
    with pytest.raises(UserError, match="line 2"):
        gains(tmp_path, text)


def test_an_object_whose_class_changes_other_things_is_refused(tmp_path):
    """Here a table that gains come from, and a field that is another configuration later."""
    table = "K = {'hip': 1.0}\nclass P:\n    def __init__(self):\n        k = K\n"
    for text, words in (
        (table + "        k['hip'] = 4.0\nP()\n" + A % "K", "line [56]"),
        (table + "        K['hip'] = 4.0\nP()\n" + A % "K", "line [56]"),
        (PLAIN + STIFF + "    def __post_init__(self):\n        self.robot = A_CFG\n"
         "ENV = StiffEnvCfg()\n", "line 6"),
    ):  # fmt: skip
        with pytest.raises(UserError, match=words):
            gains(tmp_path, text, "ENV" if "ENV" in text else "A_CFG")


def test_a_field_that_a_method_changes_is_refused(tmp_path):
    text = FOLLOWED["field that a method changes"][0]
    for name in ("StiffEnvCfg", "StiffEnvCfg.robot", None):
        with pytest.raises(UserError, match="line 6: sets gains in `StiffEnvCfg.__post_init__`"):
            gains(tmp_path, text, name)


GYM_METHODS = {
    "outer": "    def __init__(self):\n        self.control.stiffness = {'hip': 9.0}\n",
    "outer entry": "    def __init__(self):\n        self.control.damping['hip'] = 9.0\n",
    "other control": "    def __init__(self):\n        self.control = Other()\n",
    "post": "    def __post_init__(self):\n        self.control.stiffness['hip'] = 9.0\n",
    "inner": "        def __init__(self):\n            self.stiffness = {'hip': 9.0}\n",
    "inner entry": "        def __init__(self):\n            self.stiffness['hip'] = 9.0\n",
    "inner setattr": "        def __init__(self):\n            setattr(self, NAME, 9.0)\n",
    "inner dict": "        def __init__(self):\n            self.__dict__.update(MORE)\n",
    "inner entries": "        def __init__(self):\n            vars(self)[NAME] = 9.0\n",
    "property": "    @property\n    def x(self):\n        self.control.stiffness['hip'] = 9.0\n",
    "inheriting": "    def __init__(self):\n        self.control.stiffness = {'hip': 9.0}\n"
    "class FlatCfg(A1Cfg):\n    n = 3\n",
}


@pytest.mark.parametrize("case", GYM_METHODS)
def test_gains_that_a_method_of_legged_gyms_class_sets_are_refused(tmp_path, case):
    text = GYM + GYM_METHODS[case]
    for name in (None, "FlatCfg" if case == "inheriting" else "A1Cfg"):
        with pytest.raises(UserError, match="line [789]: sets gains in `") as caught:
            gains(tmp_path, text, name)
        assert "\n" not in str(caught.value)
    harmless = GYM + "    def __init__(self):\n        self.env.n = 3\n        self.name = 'a'\n"
    assert gains(tmp_path, harmless)["hip"] == (20.0, 0.5)


def test_a_name_that_is_no_configuration_is_said_what_it_is(tmp_path):
    for text, name, words in (
        ("A_CFG = make(30.0)\n", "A_CFG", "line 1: `A_CFG` is worked out when the file runs"),
        (PLAIN + "B_CFG = make(30.0)\n", "B_CFG", "line 2: `B_CFG` is worked out"),
        ("from other import A_CFG\n", "A_CFG", "takes `A_CFG` from another file"),
        ("A_CFG = 3\n", "A_CFG", "`A_CFG` is 3"),
        ("class A:\n    n = 3\n", "A", "line 1: `A` is a class"),
        ("x = 3\n", "A_CFG", "has no configuration 'A_CFG', nor any other"),
        (PLAIN, "B_CFG", "allowed: A_CFG"),
        (A % "(lambda x: x * 2)(3)", "A_CFG", "line 1: calls `lambda x: x * 2`"),
    ):
        with pytest.raises(UserError, match=re.escape(words)) as caught:
            read(tmp_path, text, name)
        assert "\n" not in str(caught.value)


def test_what_classes_have_beside_the_gains_is_listed(tmp_path):
    text = PLAIN + STIFF + "    decimation = 4\n    action_scale = 0.5\n"
    text = text.replace("damping=6", "joint_parameter_lookup=[[1.0, 2.0]], damping=6")
    text = text.replace('prim_path="x"', "init_state=RobotCfg.InitialStateCfg(joint_pos={})")
    (notes,) = read(tmp_path, text, "StiffEnvCfg").notes
    assert set(notes.split(": ")[1].split(", ")) == {
        "joint_parameter_lookup", "init_state.joint_pos", "action_scale", "decimation",
    }  # fmt: skip


def test_fields_of_an_environment_are_none_of_the_configuration_that_it_reads(tmp_path):
    text = """ROBOT_CFG = ArticulationCfg(actuators={"legs": DCMotorCfg(
    joint_names_expr=[".*"], stiffness=25.0, damping=0.5)})
class GoEnv(DirectRLEnv):
    def __init__(self, cfg):
        super().__init__(cfg)
        self.damping = float(ROBOT_CFG.actuators["legs"].damping)
        self.robot = Articulation(ROBOT_CFG)
"""
    file = tmp_path / "env.py"
    file.write_text(text)
    for name in (str(file), f"{file}:ROBOT_CFG"):
        found = matched(reading.read(name), [("hip", "hip")])
        assert (found.parameters["kp"]["hip"], found.parameters["kd"]["hip"]) == (25.0, 0.5)
