"""Gains in Python sources: what is read is what running the file gives, or it is refused."""

import copy
import math
import re

import pytest

from jaxact.errors import UserError
from jaxact.gains import reading
from jaxact.gains.table import matched

JOINTS = [("hip", "hip"), ("knee", "knee")]
A = 'A_CFG = RobotCfg(actuators={"legs": LegCfg(joint_names_expr=[".*"], '
A += "stiffness=%s, damping=0.5)})\n"
B = A.replace("A_CFG", "B_CFG")
PLAIN = A % "20.0"
LEGS = 'LEGS = LegCfg(joint_names_expr=[".*"], stiffness=20.0, damping=0.5)\n'
HIP = 'HIP = LegCfg(target_names_expr=("hip",), stiffness=40.0, damping=2.0)\n'
KNEE = 'KNEE = LegCfg(target_names_expr=("knee",), stiffness=60.0, damping=3.0)\n'
GYM = """
class A1Cfg(LeggedRobotCfg):
    class init_state(LeggedRobotCfg.init_state):
        default_joint_angles = {"hip": 0.1}
    class control(LeggedRobotCfg.control):
        control_type = "P"
        stiffness = {"hip": 20.0, "knee": 20.0}
        damping = {"hip": 0.5, "knee": 0.5}
        action_scale = 0.25
        decimation = 4
"""
FLAT = """
class FlatCfg(A1Cfg):
    class control(A1Cfg.control):
        stiffness = {"hip": 40.0, "knee": 50.0}
"""


def gains(tmp_path, text, name=None):
    """kp and kd of the two joints, and the notes."""
    file = tmp_path / "robots.py"
    file.write_text(text)
    found = matched(reading.read(file if name is None else f"{file}:{name}"), JOINTS)
    pairs = {
        joint: (found.parameters["kp"][joint], found.parameters["kd"][joint])
        for joint in found.parameters["kp"]
    }
    return pairs, " ".join(found.notes)


class Cfg:
    """Keeps what it is given, as the configurations' classes do."""

    def __init__(self, **fields):
        self.__dict__.update(fields)

    def copy(self):
        return copy.deepcopy(self)

    def replace(self, **fields):
        return Cfg(**{**copy.deepcopy(self.__dict__), **fields})


def ran(text, name):
    """kp and kd of both joints after the source has run, with stand-ins for the classes."""
    names = {"RobotCfg": Cfg, "LegCfg": Cfg, "DelayedCfg": Cfg, "math": math}
    names |= {"LeggedRobotCfg": type("G", (), {"control": object, "init_state": object})}
    exec(text, names)
    of = names[name]
    if isinstance(of, type):
        return {
            joint: (of.control.stiffness[joint], of.control.damping[joint]) for joint, _ in JOINTS
        }
    groups = of.actuators.values() if isinstance(of.actuators, dict) else of.actuators
    found = {}
    for group in groups:
        group = getattr(group, "base_cfg", group)
        patterns = getattr(group, "joint_names_expr", None) or group.target_names_expr
        for joint, _ in JOINTS:
            if any(re.fullmatch(one, joint) for one in patterns):
                found[joint] = (group.stiffness, group.damping)
    return found


FOLLOWED = {
    "augmented": ("KP = 20.0\nKP *= 2\n" + A % "KP", "A_CFG"),
    "last before": ("KP = 20.0\n" + A % "KP" + "KP = 60.0\n" + B % "KP", "A_CFG"),
    "second": ("KP = 20.0\n" + A % "KP" + "KP = 60.0\n" + B % "KP", "B_CFG"),
    "changed field": (PLAIN + 'A_CFG.actuators["legs"].stiffness = 400.0\n', "A_CFG"),
    "multiplied field": (PLAIN + 'A_CFG.actuators["legs"].stiffness *= 3\n', "A_CFG"),
    "alias": (PLAIN + 'legs = A_CFG.actuators["legs"]\nlegs.damping = 9.0\n', "A_CFG"),
    "second name": (PLAIN + "C = A_CFG\n" + 'C.actuators["legs"].damping = 9.0\n', "A_CFG"),
    "copy": (PLAIN + 'C = A_CFG.copy()\nC.actuators["legs"].stiffness = 400.0\n', "C"),
    "copied from": (PLAIN + 'C = A_CFG.copy()\nC.actuators["legs"].stiffness = 4.0\n', "A_CFG"),
    "deepcopy": ("import copy\n" + PLAIN + "C = copy.deepcopy(A_CFG)\n"
                 'C.actuators["legs"].stiffness = 4.0\n', "C"),
    "replace": (LEGS + "A_CFG = RobotCfg(actuators={'legs': LEGS.replace(stiffness=9.0)})\n",
                "A_CFG"),
    "other actuators": (PLAIN + 'A_CFG.actuators = {"all": LegCfg(joint_names_expr=[".*"],'
                        " stiffness=1.0, damping=2.0)}\n", "A_CFG"),
    "update": ("K = {'a': 2.0}\nK.update(a=7.0)\n" + A % "K['a']", "A_CFG"),
    "local": ("KP = 20.0\n" + A % "KP" + "def other():\n    KP = 777.0\n    return KP\n", "A_CFG"),
    "local before": ("KP = 20.0\ndef other():\n    KP = 7.0\n    return KP\nx = other()\n"
                     + A % "KP", "A_CFG"),
    "class name": ("KP = 20.0\nclass Other:\n    KP = 777.0\n" + A % "KP", "A_CFG"),
    "pair": ("KP, KD = 21.0, 3.0\n" + A % "KP", "A_CFG"),
    "main": ("KP = 20.0\nif __name__ == '__main__':\n    KP = 1.0\n" + A % "KP", "A_CFG"),
    "named groups": (HIP + KNEE + "OLD = LegCfg(target_names_expr=('knee',), stiffness=9.0,"
                     " damping=1.0)\nART = RobotCfg(actuators=(HIP, KNEE))\n", "ART"),
    "wrapped": (HIP + "KNEE = DelayedCfg(base_cfg=LegCfg(target_names_expr=('knee',),"
                " stiffness=6.0, damping=1.0), delay_min_lag=2, delay_max_lag=5)\n"
                "ART = RobotCfg(actuators=(HIP, KNEE))\n", "ART"),
    "reading loop": (PLAIN + "SCALE = {}\nfor a in A_CFG.actuators.values():\n"
                     "    n, s = a.joint_names_expr, a.stiffness\n"
                     "    for one in n:\n        SCALE[one] = 0.25 / s\n", "A_CFG"),
    "function that reads": (PLAIN + "def get():\n    c = A_CFG.copy()\n    c.actuators = {}\n"
                            "    return c\n", "A_CFG"),
    "own class": ("class Motor:\n    def __init__(self, cfg):\n        self.cfg = cfg\n"
                  "class MotorCfg(LegCfg):\n    class_type = Motor\n"
                  + PLAIN.replace("LegCfg", "MotorCfg"), "A_CFG"),
    "gym": (GYM, "A1Cfg"),
    "gym inherits": (GYM + FLAT, "FlatCfg"),
    "gym base": (GYM + FLAT, "A1Cfg"),
    "gym entry": (GYM + "        stiffness['knee'] = 41.0\n", "A1Cfg"),
    "gym outside": (GYM + FLAT + "A1Cfg.control.damping['knee'] = 4.0\n", "FlatCfg"),
    "gym others": (GYM + "    class arm(LeggedRobotCfg.control):\n        damping = {'hip': 1.0}\n"
                   "        stiffness = {'hip': 1.0}\n", "A1Cfg"),
    "gym own names": ("KP = 5.0\nclass A1Cfg:\n    KP = 6.0\n    class control:\n"
                      "        stiffness = {'hip': KP, 'knee': 1.0}\n        KP = 7.0\n"
                      "        damping = {'hip': KP, 'knee': 1.0}\n", "A1Cfg"),
}  # fmt: skip


@pytest.mark.parametrize("case", FOLLOWED)
def test_what_is_read_is_what_running_the_file_gives(tmp_path, case):
    text, name = FOLLOWED[case]
    assert gains(tmp_path, text, name)[0] == ran(text, name)


REFUSED = {
    "condition": ("KP = 20.0\nif FAST:\n    KP = 60.0\n" + A % "KP", "line 3: sets `KP`"),
    "loop": ("KP = 20.0\nfor i in range(3):\n    KP += 1\n" + A % "KP", "line 3"),
    "try": ("KP = 20.0\ntry:\n    KP = 3.0\nexcept E:\n    pass\n" + A % "KP", "line 3"),
    "with": ("KP = 20.0\nwith f() as KP:\n    pass\n" + A % "KP", "line 2"),
    "global": ("KP = 20.0\ndef f():\n    global KP\n    KP = 6.0\nf()\n" + A % "KP", "line 4"),
    "del": ("KP = 20.0\ndel KP\n" + A % "KP", "line 3"),
    "import": ("KP = 20.0\nfrom other import KP\n" + A % "KP", "takes `KP` from another file"),
    "import all": ("KP = 20.0\nfrom other import *\n" + A % "KP", "line 2: imports all names"),
    "globals": ("KP = 20.0\nglobals()['KP'] = 3.0\n" + A % "KP", "line 2"),
    "walrus": ("KP = 20.0\nprint([KP := x for x in (1, 2)])\n" + A % "KP", "line 2"),
    "passed": (PLAIN + "stiffen(A_CFG)\n", "line 2: calls `stiffen`"),
    "method": (PLAIN + 'A_CFG.actuators["legs"].stiffen()\n', "line 2"),
    "own function": (PLAIN + "def f():\n    A_CFG.actuators = {}\nf()\n", "line 3"),
    "uncalled function": (PLAIN + "def f():\n    A_CFG.actuators['legs'].damping = 1\n", "line 3"),
    "changing loop": (PLAIN + "for a in A_CFG.actuators.values():\n    a.stiffness *= 2\n",
                      "line 3"),
    "setattr": (PLAIN + 'setattr(A_CFG.actuators["legs"], "stiffness", 3.0)\n', "line 2"),
    "unknown key": (PLAIN + 'A_CFG.actuators[NAME].stiffness = 4.0\n', "line 2: changes `A_CFG"),
    "list of values": (PLAIN + "list(A_CFG.actuators.values())[0].stiffness = 4.0\n", "line 2"),
    "shared": (LEGS + "A_CFG = RobotCfg(actuators={'l': LEGS})\nLEGS.stiffness = 4.0\n", "line 3"),
    "choice": (PLAIN + B % "1.0" + "(A_CFG if X else B_CFG).actuators['legs'].damping = 4.0\n",
               "line 3"),
    "its __dict__": (PLAIN + "A_CFG.actuators['legs'].__dict__['damping'] = 4.0\n", "line 2"),
    "returned": (PLAIN + "def f():\n    return A_CFG\nf().actuators['legs'].damping = 4.0\n",
                 "line 4"),
    "lambda": (PLAIN + "f = lambda: A_CFG.actuators.clear()\nf()\n", "line 2"),
    "property": ("K = {'hip': 1.0}\nclass P:\n    @property\n    def k(self):\n        return K\n"
                 "P().k['hip'] = 4.0\n" + A % "K", "line 6"),
    "subclass hook": ("class B:\n    def __init_subclass__(cls):\n        cls.k = 1.0\n"
                      "class C(B):\n    k = 2.0\n" + A % "C.k", "line 4"),
    "global in a class": ("K = 1.0\nclass B:\n    global K\n    K = 2.0\n" + A % "K", "line 3"),
    "pop": (PLAIN + 'A_CFG.actuators.pop("legs")\n', "line 2"),
    "conditional change": (PLAIN + "if X:\n    A_CFG.actuators['legs'].damping = 4.0\n", "line 3"),
    "replaced under a condition": (PLAIN + "if X:\n    A_CFG = OTHER_CFG\n", "line 3"),
    "partly elsewhere": ("A_CFG = RobotCfg(actuators={'a': LegCfg(joint_names_expr=['hip'],"
                         " stiffness=1, damping=1), 'b': other.KNEE})\n", "line 1"),
    "function's group": ("def leg(stiffness, **more):\n    return LegCfg(stiffness=2 * stiffness,"
                         " **more)\n" + PLAIN.replace("LegCfg", "leg"), "calls `leg`"),
    "wrapper's gain": ("A_CFG = RobotCfg(actuators=(WrapCfg(base=LegCfg(joint_names_expr=['.*'],"
                       " stiffness=1, damping=1), stiffness=5),))\n", "wraps actuators"),
    "gym entry of one": (GYM + "        stiffness['ankle'] = 4.0\n",
                         "'ankle' is in stiffness and not in damping"),
    "gym base elsewhere": (FLAT, "line 3: takes `damping` from a class that is not in this file"),
    "gym no damping": ("class A1Cfg:\n    class control:\n        stiffness = {'hip': 1.0}\n",
                            "has no damping"),
    "gym loop": (GYM + "        for k in stiffness:\n            stiffness[k] = 3.0\n", "line 12"),
    "gym two": (GYM.replace("class control", "class arm") + GYM.split("\n", 4)[4].replace(
        "class control", "class leg"), "none is `control`"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_only_running_the_file_tells_is_refused_in_a_line(tmp_path, case):
    text, words = REFUSED[case]
    name = next(one for one in ("A_CFG", "A1Cfg", "FlatCfg") if f"{one}" in text)
    name = "FlatCfg" if "FlatCfg" in text else name
    with pytest.raises(UserError, match=re.escape(words)) as caught:
        gains(tmp_path, text, name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", (
    PLAIN + 'C_CFG = A_CFG.copy()\nC_CFG.actuators["legs"].stiffness = 4.0\n',
    GYM + FLAT,
    PLAIN + B % "KP",
))  # fmt: skip
def test_a_name_is_asked_for_where_several_configurations_differ(tmp_path, text):
    with pytest.raises(UserError, match="has several configurations; name one"):
        gains(tmp_path, text)


@pytest.mark.parametrize("text", (
    PLAIN + "C_CFG = A_CFG.copy()\nC_CFG.spawn.usd_path = 'other.usd'\n",
    PLAIN + "ROBOT = SceneCfg(robot=A_CFG)\n",
    GYM + "class FlatCfg(A1Cfg):\n    class env(A1Cfg.env):\n        n = 3\n",
    GYM + "class A1CfgPPO(LeggedRobotCfgPPO):\n    class runner(LeggedRobotCfgPPO.runner):\n"
    "        n = 3\n",
))  # fmt: skip
def test_no_name_is_asked_for_where_all_have_the_same_gains(tmp_path, text):
    assert gains(tmp_path, text)[0] == {"hip": (20.0, 0.5), "knee": (20.0, 0.5)}


def test_groups_are_those_that_the_configuration_names(tmp_path):
    for case in ("named groups", "wrapped"):
        text, name = FOLLOWED[case]
        found, notes = gains(tmp_path, text)
        assert found == ran(text, name)
    assert "delay_min_lag, delay_max_lag" in notes
    alone = gains(tmp_path, FOLLOWED["named groups"][0], "OLD")[0]
    assert alone == {"knee": (9.0, 1.0)}


def test_what_legged_gym_sets_beside_the_gains_is_listed(tmp_path):
    notes = gains(tmp_path, GYM)[1]
    assert notes == "not taken from it: action_scale, decimation, default_joint_angles"
    assert "control_type" in gains(tmp_path, GYM.replace('"P"', '"T"'))[1]
    file = tmp_path / "gym.yaml"
    file.write_text(
        "control: {stiffness: {hip: 1}, damping: {hip: 1}, action_scale: 0.5, decimation: 4}"
    )
    assert reading.read(file).notes == ("not taken from it: action_scale, decimation",)


def test_a_force_limit_that_is_worked_out_is_said_not_to_be_taken(tmp_path):
    notes = gains(tmp_path, PLAIN.replace("damping", "effort_limit=limit(3), damping"))[1]
    assert "effort_limit (worked out when the file runs)" in notes


def test_a_source_of_endless_growth_is_refused_quickly(tmp_path):
    for line in ("x = [x, x]", "x = x + x", "x = {'a': x, 'b': x}"):
        text = "x = [1.0]\n" + f"{line}\n" * 60 + A % "x"
        with pytest.raises(UserError):
            gains(tmp_path, text)
    with pytest.raises(UserError):
        gains(tmp_path, "x = 3\n" + "x = x * x\n" * 60 + A % "x")


def test_a_shallow_copy_of_a_dataclass_is_not_taken_for_a_deep_one(tmp_path):
    """`dataclasses.replace` shares what it does not replace; Isaac Lab's `replace` copies it."""
    text = PLAIN + "C = A_CFG.replace(x=1)\nC.actuators['legs'].stiffness = 4.0\n"
    for name in ("A_CFG", "C"):
        with pytest.raises(UserError, match="line 3"):
            gains(tmp_path, text, name)
