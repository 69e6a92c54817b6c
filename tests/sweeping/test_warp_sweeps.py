"""Sweeps of robots in MJX-Warp, held against C MuJoCo under the same drive; and who may choose it.

What needs MJX-Warp is skipped where it is not installed; what is said of its absence is not.
"""

import dataclasses
import os
import subprocess
import sys

import jax
import numpy as np
import pytest
from quickly import ENVIRONMENT, optimised_little
from robots import HOPPER, PENDULUM

from jaxact.errors import UserError
from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.plants import warp
from jaxact.simulation import engines, execute, plans, single
from jaxact.status import Verdict
from jaxact.sweeping import execution, location, store, validation
from jaxact.tuning.rollouts.validation import validate

LACKING = warp.lacking()
needs_warp = pytest.mark.skipif(bool(LACKING), reason=LACKING or "MJX-Warp is there")
DRIVE = "wn = 300\nzeta = 0.7\ndelay = 0.0013\nmeasurement_delay = 0.0006\noutput_delay = 0.0005\n"
HOME = 'model = "pendulum.xml"\nkeyframe = "home"'
PUSH = '[push]\nbody = "box"\nimpulse = [0, 0, 30.0]\ntime = 0.01\nduration = 0.0125\n'
CASES = {
    "pendulum": (HOME, "setpoint = 0.2"),
    "hopper": ('model = "hopper.xml"\n' + PUSH, "kp = 60\nkd = 2\nsetpoint = 0.1"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robots")
    (folder / "pendulum.xml").write_text(PENDULUM)
    (folder / "hopper.xml").write_text(HOPPER)
    return folder


def _parsed(folder, plant, parameters="", axes="feedforward = [0.0]", **options):
    lines = [f"{name} = {value!r}" for name, value in options.items()]
    text = "\n".join([*lines, "[plant]", plant, "[parameters]", parameters, "[axes]", axes])
    return reading.parse(text, folder)


def _rows(asked):
    with optimised_little():
        return execute.run(asked, expand(asked))


@needs_warp
@pytest.mark.parametrize("case", CASES)
def test_the_same_loop_as_in_c(case, folder):
    """Joint positions within 1e-4 rad over the first 100 ms, everything in single precision."""
    plant, parameters = CASES[case]
    found = {}
    for engine in ("mujoco", "warp"):
        asked = _parsed(folder, plant, DRIVE + parameters, engine=engine, duration=0.1)
        with optimised_little():
            found[engine] = single.simulate(asked)
    one, other = (found[engine].trajectory for engine in ("mujoco", "warp"))
    assert np.ptp(one.position, axis=0).max() > 0.02
    np.testing.assert_allclose(other.position, one.position, rtol=0, atol=1e-4)
    np.testing.assert_allclose(other.force, one.force, rtol=0, atol=1e-2 * np.abs(one.force).max())


@needs_warp
def test_the_same_map_with_contacts(folder):
    """As of MJX: 95 % of the verdicts agree, the others lie within 5 % of the boundary."""
    axes = (
        'kp = { min = 40, max = 160, num = 32, spacing = "log" }\n'
        'kd = { min = 0.5, max = 2, num = 8, spacing = "log" }'
    )
    parameters = "wn = 300\nzeta = 0.8\ndelay = 0.002\ninitial_velocity = 0.5"
    stable = []
    for engine in ("mujoco", "warp"):
        plant = 'model = "hopper.xml"'
        asked = _parsed(folder, plant, parameters, axes, engine=engine, duration=0.4)
        stable.append(_rows(asked)["verdict"].reshape(32, 8) == Verdict.STABLE)
    one, other = stable
    assert 0.1 < one.mean() < 0.9
    assert (one == other).mean() >= 0.95
    # A cell is 4.6 % of the gain: a differing one must touch a cell of the other verdict.
    for row, column in np.argwhere(one != other):
        around = one[max(row - 1, 0) : row + 2, column]
        assert around.any() and not around.all()


CHANGES = {
    "payload": 0.8,
    "inertia_scale": 1.5,
    "joint_damping": 0.7,
    "joint_armature": 0.02,
    "joint_friction": 0.4,
}


@needs_warp
def test_changes_of_the_model_differ_between_samples(folder):
    rows = {}
    axes = "\n".join(f"{name} = [0.0, {value}]" for name, value in CHANGES.items())
    axes = axes.replace("inertia_scale = [0.0", "inertia_scale = [1.0")
    for engine in ("mujoco", "warp"):
        asked = _parsed(folder, HOME, DRIVE + "setpoint = 0.2", axes, engine=engine, duration=0.1)
        rows[engine] = _rows(asked)
    for name in ("peak_force", "integrated_squared_error"):
        one, other = rows["mujoco"][name], rows["warp"][name]
        assert np.unique(one).size > 20
        np.testing.assert_allclose(other, one, rtol=2e-3, err_msg=name)


@needs_warp
def test_friction_of_contacts_differs_between_samples(folder):
    """A push along the ground: the box slides as far as its friction lets it."""
    push = PUSH.replace("[0, 0, 30.0]", "[30.0, 0, 0]")
    plant = 'model = "hopper.xml"\n' + push
    excursion = []
    for engine in ("mujoco", "warp"):
        asked = _parsed(
            folder, plant, DRIVE + "kp = 60\nkd = 2", "contact_friction = [0.2, 1.0]",
            engine=engine, duration=0.1,
        )  # fmt: skip
        samples = expand(asked)
        with optimised_little():
            runs = single.simulate_all(asked, samples)
        excursion.append([run.trajectory.configuration[-1, 0] for run in runs])
    assert excursion[0][0] > 1.1 * excursion[0][1]
    np.testing.assert_allclose(excursion[1], excursion[0], rtol=0, atol=1e-4)


@needs_warp
def test_the_same_bits_again_and_in_other_company(folder, tmp_path):
    """On a CPU, where it uses one device: repeated, some only, and again for a store."""
    noise = DRIVE + "position_noise = 1e-3\nsetpoint = 0.1\nkp = 60\nkd = 2"
    axes = "gain_scale = { min = 0.5, max = 2, num = 6 }"
    asked = _parsed(
        folder, 'model = "hopper.xml"', noise, axes, engine="warp", duration=0.1, tile=3
    )
    samples = expand(asked)
    with optimised_little():
        groups = plans.groups(asked, samples)
        assert groups[0].devices == 1
        whole = execute.compute(groups, asked, samples, np.arange(6))
        again = execute.compute(groups, asked, samples, np.array([1, 4]))
        for name, values in again.items():
            np.testing.assert_array_equal(values, whole[name][[1, 4]], err_msg=name)
        with pytest.raises(UserError, match="devices = 2: on CPUs, the engine warp uses one"):
            plans.groups(dataclasses.replace(asked, devices=2), samples)
        target = location.at(tmp_path / "out")
        execution.sweep(asked, target, execution.SweepOptions())
        checked = validation.recompute(target.inside(store.STORE), 4, seed=0)
    assert checked.wrong == 0 and checked.words == "bit for bit the same"


@needs_warp
def test_gains_of_a_tuning_are_validated_in_it(folder):
    asked = _parsed(folder, HOME, DRIVE, duration=0.2)
    gains = np.array([80.0, 30.0]), np.array([4.0, 1.0])
    found = [
        validate({"home": asked}, *gains, {"delay": np.array([0.001, 0.02])}, engine=engine)
        for engine in ("mujoco", "warp")
    ]
    assert found[1].engines == ("warp",)
    np.testing.assert_array_equal(found[1].verdict, found[0].verdict)


def test_auto_may_choose_it_on_an_nvidia_gpu_only(folder, monkeypatch):
    asked = _parsed(folder, HOME, DRIVE, engine="auto")
    monkeypatch.setattr(warp, "lacking", lambda: "")
    monkeypatch.setattr(warp, "refusal", lambda model: "")
    assert engines.able(asked) == ("mjx", "mujoco"), "on a CPU it is slow"
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert engines.able(asked) == ("mjx", "mujoco", "warp")
    assert engines.resolved(asked).engine == "mujoco", "of a single loop, as ever"
    double = _parsed(folder, HOME, DRIVE, engine="auto", precision="float64")
    assert engines.able(double) == ("mjx", "mujoco")
    monkeypatch.setattr(warp, "refusal", lambda model: "what it does not know")
    assert engines.able(asked) == ("mjx", "mujoco")
    monkeypatch.setattr(warp, "lacking", lambda: "not installed")
    assert engines.able(asked) == ("mjx", "mujoco")


def test_on_a_gpu_its_loops_are_compared_to_rounding_only(monkeypatch, tmp_path):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(store, "numeric_versions", lambda engine: {})
    for engine, words in (("mjx", ""), ("warp", "MJX-Warp on a GPU adds up in any order")):
        there = {"engine": engine, "platform": "gpu", "versions": {}}
        monkeypatch.setattr(store, "identity_of", lambda target, there=there: there)
        assert validation._rounds_otherwise(location.at(tmp_path)) == words


REFUSED = {
    "precision": ("", ["precision=float64"], "precision = 'float64': MJX-Warp computes in float32"),
    "no robot": (None, [], "engine = 'warp': is for robots, of jaxact.robot or [plant] model"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_it_does_not_do_is_said_in_one_line(case, folder):
    plant, changes, said = REFUSED[case]
    table = "" if plant is None else f"[plant]\n{HOME}\n"
    text = f'engine = "warp"\n{table}[parameters]\nkp = 50\nkd = 3\n[axes]\nfeedforward = [0.0]\n'
    asked = reading.parse(text, folder, changes) if changes else reading.parse(text, folder)
    with pytest.raises(UserError) as caught:
        engines.resolved(asked)
    assert str(caught.value).startswith(said) and "\n" not in str(caught.value)


@pytest.mark.parametrize("verb", ["sweep", "simulate"])
def test_without_warp_lang_the_program_says_how_to_get_it(verb, folder, tmp_path):
    """A program of its own, in which a package that cannot be imported hides the one there is."""
    hidden = tmp_path / "hidden"
    hidden.mkdir()
    (hidden / "warp.py").write_text("raise ImportError('No module named warp')\n")
    (folder / "one.toml").write_text(
        f'engine = "warp"\nduration = 0.1\n[plant]\n{HOME}\n[axes]\nfeedforward = [0.0]\n'
    )
    given = {
        "sweep": ["sweep", "one.toml", "--out", str(tmp_path / "out")],
        "simulate": ["simulate", "--model", "pendulum.xml", "--engine", "warp"],
    }[verb]
    path = os.pathsep.join([str(hidden), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, "-m", "jaxact", *given],
        cwd=folder, env={**os.environ, **ENVIRONMENT, "PYTHONPATH": path},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert "warp-lang, which is not installed: pip install 'jaxact[warp]'" in done.stderr
    assert not (tmp_path / "out").exists()


@needs_warp
def test_nothing_of_warp_reaches_the_screen(folder):
    done = subprocess.run(
        [sys.executable, "-m", "jaxact", "simulate", "--model", "pendulum.xml",
         "--engine", "warp", "--duration", "0.05"],
        cwd=folder, env={**os.environ, **ENVIRONMENT}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0 and done.stderr == ""
    assert "Warp" not in done.stdout and "Module" not in done.stdout
