"""What a robot's page gives to copy, a command and a specification, computes the same margins."""

import json
import shlex
import shutil
import subprocess

import pytest
from command_line import jaxact
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact import files
from jaxact.verbs import report_robot

EXACT = 1e-9
WORDS = """
import { read } from "PAGE/main.js";
import { command, toml } from "PAGE/robot_words.js";
import { readFileSync } from "node:fs";
const { data, number, moved } = read(readFileSync(0, "utf8"));
const { drives, rate } = data.loops[number];
const state = { loop: number, rate };
const now = { ...drives, ...moved };
console.log(JSON.stringify([command(data, state, now), toml(data, state, now)]));
"""
ROBOT = """<mujoco><option timestep="0.001"/><worldbody>
<body name="a"><joint name="j1" axis="0 1 0" damping="0.1"/>
<geom size="0.05" mass="2" pos="0 0 -0.3"/>
<body name="b" pos="0 0 -0.4"><joint name="j2" axis="0 1 0" damping="0.1"/>
<geom size="0.05" mass="1" pos="0 0 -0.2"/></body></body>
</worldbody><actuator>ACTUATORS</actuator></mujoco>"""
MOTORS = '<motor joint="j1"/><motor joint="j2"/>'
LATE = '<motor joint="j1" delay="0.004" nsample="8"/><motor joint="j2" delay="0.004" nsample="8"/>'
GAINS = {"kp": 80.0, "kd": 2.0, "control_rate": 500}
DRIVE = {"actuator": "hyq", "delay": 2e-3}
IDEAL = {"delay": [0.0, 0.0], "wn": ["inf", "inf"]}

pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="needs node")


def said(loop, number, moved, folder):
    """The page's command and TOML of one of its loops, with some drives moved."""
    page = report_robot.__file__.replace("verbs/report_robot.py", "reports/page")
    data = files.plain(report_robot.content(loop).parts["robot"])
    data["plants"] = []
    script = folder / "words.mjs"
    script.write_text(WORDS.replace("PAGE", page))
    ran = subprocess.run(
        ["node", str(script)], capture_output=True, text=True,
        input=json.dumps({"data": data, "number": number, "moved": moved}),
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout)


@pytest.mark.parametrize(
    ("actuators", "given", "moved"),
    [
        (MOTORS, {**DRIVE, "payload": 3.0, "joint_armature": 0.05, "joint_damping": 0.5}, {}),
        (MOTORS, {**DRIVE, "joint_damping": 0.5, "joint_damping@j1": 0.0}, {}),
        (MOTORS, {**DRIVE, "payload": [0.0, 3.0]}, {}),
        (MOTORS, {**DRIVE, "physics_step": 5e-4, "integrator_correction": True}, {}),
        (LATE, {}, {}),
        (LATE, {}, IDEAL),
        (LATE, {"delay@j1": 0.0, "wn@j1": 300.0}, {}),
    ],
    ids=["model", "joints", "loops", "step", "as it is", "slider at zero", "of one joint"],
)
def test_what_is_said_computes_the_same_margins(actuators, given, moved, tmp_path):
    model = tmp_path / "robot.xml"
    model.write_text(ROBOT.replace("ACTUATORS", actuators))
    loops = jx.robot(model, **GAINS | given)
    loop = loops[-1] if loops.shape else loops
    command, specification = said(loops, len(loops) - 1 if loops.shape else 0, moved, tmp_path)
    if moved:
        loop = loop.replace(delay=0.0, wn=float("inf"))
    (own,) = jx.margins(loop).details
    (tmp_path / "robot.toml").write_text(specification)
    for arguments in (shlex.split(command)[2:], ["--spec", str(tmp_path / "robot.toml")]):
        ran = jaxact("margins", *arguments, "--json")
        assert ran.returncode == 0, ran.stderr
        theirs = json.loads(ran.stdout)
        assert theirs["growth_rate"] == pytest.approx(own.margins.growth_rate, rel=EXACT)
        assert theirs["all"]["gain_margin"] == pytest.approx(
            own.margins.whole.gain_margin, rel=EXACT
        )
