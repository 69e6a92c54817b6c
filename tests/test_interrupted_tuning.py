"""Ctrl-C while gains are looked for: real signals, in processes of their own."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import mujoco
import numpy as np
import pytest
import robots
from quickly import ENVIRONMENT

import jaxact
from jaxact.tuning.robot.rows import Found
from jaxact.tuning.robot.so_far import so_far

ROOT = Path(__file__).resolve().parent.parent
QUICK = ("--starts", "1", "--steps", "20", "--ensemble", "2")
ARM = ("--model", "arm.xml", "--keyframe", "home", "--actuator", "hyq", "--delay", "0.002",
       "--max-peak", "1.8", "--uncertainty", "delay=0.001..0.003", *QUICK)  # fmt: skip
JOINT = ("--mass", "0.7", "--actuator", "starleth", "--delay", "1e-3", "--max-peak", "1.6",
         "--uncertainty", "wn=0.8..1.2", *QUICK)  # fmt: skip

# A function, named by its module, that sends the process signals: before its own work, or, in a
# thread, some time after it has begun.
SENDS = """
import importlib, os, signal, sys, threading, time
# A job in the background of a shell is started with this signal ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
module, name, turn, times, later = {at!r}
found = importlib.import_module(module)
work, calls = getattr(found, name), []

def send():
    for number in range(times):
        time.sleep(later if number == 0 else 0.0)
        os.kill(os.getpid(), signal.SIGINT)
        # Two that nobody has seen are one; after the first the rest takes less on a fast machine.
        seen = getattr(sys.modules.get("jaxact.cli._signals"), "_received", ())
        latest = time.monotonic() + 0.5
        while len(seen) <= number and time.monotonic() < latest:
            time.sleep(0.002)

def interrupted(*given, **named):
    calls.append(1)
    if len(calls) == turn:
        threading.Thread(target=send, daemon=True).start() if later else send()
    return work(*given, **named)

setattr(found, name, interrupted)
"""
COMMAND = "from jaxact.cli import main\nsys.argv[1:] = {words!r}\nmain.entry()\n"


def _python(folder, code):
    """Run Python in a process of its own."""
    (folder / "arm.xml").write_text(robots.PENDULUM)
    environment = os.environ | ENVIRONMENT | {"PYTHONPATH": str(ROOT)}
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True,
                          cwd=folder, env=environment, timeout=300)  # fmt: skip


def _tune(folder, words, module, name, turn=1, times=1, later=0.0):
    sends = SENDS.format(at=(module, name, turn, times, later))
    return _python(folder, sends + COMMAND.format(words=["tune", *words]))


def _arm_peaks(gains, delay):
    """Ms of the arm at its posture with gains, by C MuJoCo's own linearisation, delays as powers.

    The actuator's lag is sampled exactly (held input), as its closed form is.
    """
    model = mujoco.MjModel.from_xml_string(robots.PENDULUM)
    model.actuator_gainprm[:] = 0.0
    model.actuator_biasprm[:] = 0.0
    model.actuator_gainprm[:, 0] = 1.0
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_inverse(model, data)
    data.ctrl[:] = data.qfrc_inverse
    A, B = np.zeros((4, 4)), np.zeros((4, 2))
    mujoco.mjd_transitionFD(model, data, 1e-7, True, A, B, None, None)
    period, wn, zeta = model.opt.timestep, 800.0, 0.45
    z = np.exp(1j * np.pi * np.geomspace(1e-4, 1.0, 4000))
    # Force of a held command over each period, its mean, by Van Loan's exponential.
    import scipy.linalg

    continuous = np.zeros((4, 4))
    continuous[0, 1], continuous[1, :2] = 1.0, (-wn * wn, -2.0 * zeta * wn)
    continuous[1, 3], continuous[2, 0] = wn * wn, 1.0
    step = scipy.linalg.expm(period * continuous)
    own, held = step[:2, :2], step[:2, 3]
    mean, straight = step[2, :2] / period, step[2, 3] / period
    lag = np.array([
        mean @ np.linalg.solve(one * np.eye(2) - own, held) + straight for one in z
    ]) * z ** (-round(delay / period))  # fmt: skip
    K = np.concatenate([np.diag(gains["kp"]), np.diag(gains["kd"])], axis=1)
    peak = 0.0
    for one, factor in zip(z, lag, strict=True):
        L = factor * K @ np.linalg.solve(one * np.eye(4) - A, B)
        peak = max(peak, np.linalg.norm(np.linalg.inv(np.eye(2) + L), 2))
    return peak


@pytest.mark.parametrize(
    ("module", "name", "turn", "later", "during"),
    [
        ("jaxact.tuning.optimise", "_descended", 1, 0.3, "descending"),
        *(
            pytest.param(*case, marks=pytest.mark.exhaustive)
            for case in (
                ("jaxact.tuning.robot.descent", "polished", 2, 0.0, "polishing"),
                ("jaxact.tuning.robot.exchange", "inside_worse", 1, 0.0, "worst point of the box"),
                ("jaxact.tuning.rollouts.validation", "validate", 1, 0.0, "simulating"),
            )
        ),
    ],
)
def test_a_robots_tuning_ends_with_what_is_certified(tmp_path, module, name, turn, later, during):
    words = [*ARM, "--out", "tuned", "--json"]
    ran = _tune(tmp_path, words, module, name, turn, later=later)
    assert ran.returncode == 130, ran.stderr
    assert ran.stderr.startswith("jaxact: interrupted while") and ran.stderr.count("\n") == 1
    assert during in ran.stderr and "rollouts are left out" in ran.stderr
    found = json.loads(ran.stdout)
    assert found["certified"] and found["interrupted"] == ran.stderr.removeprefix("jaxact: ")[:-1]
    unseen = found["worst_interior_excess"] is None
    assert unseen == ("the worst interior point was not looked for" in ran.stderr)
    assert unseen != ("the worst interior point included" in found["verdict"])
    assert found["corners"] == 2 and found["rollouts"] is None
    kept = tomllib.loads((tmp_path / "tuned/gains.toml").read_text())
    assert kept["guaranteed"]["interrupted"] == found["interrupted"]
    gains = {k: [row[k] for row in found["joints"]] for k in ("kp", "kd")}
    assert min(gains["kp"]) > 0.0
    for delay in (0.001, 0.003):
        assert _arm_peaks(gains, delay) <= 1.8 * (1 + 1e-3)


def test_a_point_that_exceeds_its_bounds_is_led_inside(tmp_path):
    (tmp_path / "arm.xml").write_text(robots.PENDULUM)
    loop = jaxact.robot(tmp_path / "arm.xml", keyframe="home", actuator="hyq", delay=0.002)
    best = jaxact.tune(loop, max_peak=1.8, uncertainty="delay=0.001..0.003", samples=2, starts=1,
                       steps=20)  # fmt: skip
    case = best.robot.case
    x = case.groups.log_gains(best.kp, best.kd) + 0.1
    kp, kd = case.groups.gains(x)
    assert _arm_peaks({"kp": kp, "kd": kd}, 0.003) > 1.8 * 1.01
    found = so_far(case, [Found(x, 0.0, 0.1, 0, 0)])
    kp, kd = case.groups.gains(found.found.x)
    for delay in (0.001, 0.003):
        assert _arm_peaks({"kp": kp, "kd": kd}, delay) <= 1.8 * (1 + 1e-3)
    assert so_far(case, [Found(x + 9.0, 0.0, 0.1, 0, 0)]) is None


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("module", "name", "turn", "later"),
    [
        ("jaxact.tuning.optimise", "_descended", 1, 0.3),
        ("jaxact.tuning.joint.exchange", "worst_inside", 1, 0.0),
    ],
)
def test_a_joints_tuning_ends_with_what_is_certified(tmp_path, module, name, turn, later):
    import control

    ran = _tune(tmp_path, [*JOINT, "--out", "tuned", "--json"], module, name, turn, later=later)
    assert ran.returncode == 130, ran.stderr
    assert ran.stderr.startswith("jaxact: interrupted while") and ran.stderr.count("\n") == 1
    found = json.loads(ran.stdout)
    assert found["certified"] and "interior point was not looked for" in found["interrupted"]
    assert "rollouts" not in found["interrupted"]
    w = np.geomspace(1.0, 5e3, 20_000)
    for factor in (0.8, 1.2):
        wn, zeta, s = 110.0 * factor, 0.9, 1j * w
        loop = control.tf([wn * wn], [0.7, 2 * 0.7 * zeta * wn, 0.7 * wn * wn, 0.0, 0.0])(s)
        loop = loop * (found["kp"] + found["kd"] * s) * np.exp(-1e-3 * s)
        assert np.abs(1.0 / (1.0 + loop)).max() <= 1.6 * (1 + 1e-6)
    assert {"gains.toml", "gains.xml"} <= {path.name for path in (tmp_path / "tuned").iterdir()}


@pytest.mark.parametrize(
    ("name", "times", "module"),
    [
        ("situation", 1, "jaxact.tuning.robot.loops"),  # nothing is known yet
        ("_descended", 2, "jaxact.tuning.optimise"),  # the second one ends it at once
    ],
)
def test_where_nothing_is_certified_or_at_the_second_signal_nothing_is_half_written(
    tmp_path, name, times, module
):
    ran = _tune(tmp_path, [*ARM, "--out", "tuned"], module, name, times=times)
    assert (ran.returncode, ran.stdout) == (130, "")
    said = ["jaxact: interrupted; no gains were certified yet, nothing is kept\n"]
    if times == 2:  # it may come when they are certified, and being written, or written
        said.append("jaxact: interrupted; nothing is kept\n")
        said.append("jaxact: interrupted; tuned is written\n")
    assert ran.stderr in said
    written = ["tuned"] if ran.stderr == said[-1] and times == 2 else []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.xml", *written]
    assert all((tmp_path / name / "gains.toml").exists() for name in written)


# Replaces a folder over and over, each time in a child that gets two SIGINTs while it does: at the
# line of the standard library or of ours with that number, and so many lines later.
AT_EVERY_LINE = """
import contextlib, os, shutil, signal, sys
from pathlib import Path
from jaxact import files
from jaxact.cli import _folders, _signals

watched = (shutil.__file__, _folders.__file__, files.__file__, contextlib.__file__)

def write():
    with _folders.whole_folder(Path("tuned")) as folder:
        (folder / "gains.toml").write_text("new")
    return 0

def child(line, apart):
    count = 0
    def trace(frame, event, argument):
        nonlocal count
        if event == "line" and frame.f_code.co_filename in watched:
            count += 1
            if count in (line, line + apart):
                os.kill(os.getpid(), signal.SIGINT)
        return trace
    _signals.listen()
    sys.stderr = open(os.devnull, "w")
    os.dup2(sys.stderr.fileno(), 2)
    sys.settrace(trace)
    code = _signals.taken(lambda: _signals.to_the_end(write))
    sys.settrace(None)
    os._exit(code if count >= line else 77)

for apart in (1, 2, 5, 13, 34):
    line, code = 0, 0
    while code != 77:
        line += 1
        shutil.rmtree("tuned", ignore_errors=True)
        os.mkdir("tuned")
        Path("tuned/gains.toml").write_text("old")
        pid = os.fork() or child(line, apart)
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        assert code in (0, 77, 130), (line, apart, code)
        assert os.listdir() == ["tuned"], (line, apart, os.listdir())
        text = Path("tuned/gains.toml").read_text()
        assert text == "new" or (text, code) == ("old", 130), (line, apart, text, code)
    print(line)
"""


@pytest.mark.exhaustive
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_two_signals_at_any_line_leave_the_old_folder_or_the_new_one(tmp_path):
    ran = subprocess.run(
        [sys.executable, "-c", AT_EVERY_LINE],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        timeout=300,
    )
    assert ran.returncode == 0, ran.stderr
    assert min(map(int, ran.stdout.split())) > 40  # lines at which the first one came


@pytest.mark.exhaustive
def test_interrupted_while_it_writes_a_command_writes_all_the_same(tmp_path):
    ran = _tune(tmp_path, [*JOINT, "--out", "tuned"], "jaxact.plotting.theme", "write", 2)
    assert ran.returncode == 130 and "everything is there" in ran.stderr
    assert "certified: every constraint holds" in ran.stdout
    names = {path.name for path in (tmp_path / "tuned").iterdir()}
    assert {"gains.toml", "gains.xml", "sensitivity.png", "convergence.png"} <= names
    assert {path.name for path in tmp_path.iterdir()} == {"arm.xml", "tuned"}


@pytest.mark.exhaustive
def test_python_gets_the_best_so_far_or_the_interrupt(tmp_path):
    # An interrupt during a garbage collection is lost in JAX's part of it, which nobody can mend.
    code = """
import gc, jaxact
gc.disable()
loop = jaxact.joint(mass=0.7, actuator="starleth", delay=1e-3)
best = jaxact.tune(loop, max_peak=1.6, uncertainty={"wn": (0.8, 1.2)}, samples=2, front=2)
print(best.interrupted)
print(best.certified, best.front, best._repr_html_().count(best.interrupted))
print(jaxact.tune(loop, max_peak=1.6, progress=False).interrupted == "")
"""
    sends = SENDS.format(at=("jaxact.tuning.joint.search", "front", 1, 1, 0.0))
    ran = _python(tmp_path, sends + code)
    assert ran.returncode == 0, ran.stderr
    front = "interrupted while walking along the front, which is left out"
    assert ran.stdout.splitlines() == [front, "True () 1", "True"]
    sends = SENDS.format(at=("jaxact.tuning.joint.search", "_searched", 1, 1, 0.0))
    ran = _python(tmp_path, sends + code)
    assert ran.returncode != 0 and ran.stderr.endswith(
        "KeyboardInterrupt: interrupted; no gains were certified yet, nothing is kept\n"
    )
