"""Running sweeps: rates, physics steps, precisions, and no sweep that hangs."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from exact import growth_rate as exact_growth_rate
from noisy_sweep import NOISY, run
from quickly import compiled_quickly as compiled_quickly

from jaxact.errors import UserError
from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.plants.mjx import plant as mjx
from jaxact.simulation import execute, plans, spectra


@pytest.mark.exhaustive
def test_control_rates_may_differ_between_samples():
    text = """
    engine = "mass"
    duration = 0.5
    [parameters]
    actuator = "starleth"
    delay = 0.002
    [axes]
    control_rate = [250, 500, 1000]
    kp = [200, 400, 6000]
    """
    got = run(text)
    rates = np.repeat([250.0, 500.0, 1000.0], 3)
    gains = np.tile([200.0, 400.0, 6000.0], 3)
    for place, (rate, kp) in enumerate(zip(rates, gains, strict=True)):
        want = exact_growth_rate([kp], [20.0], 0.7, 110.0, 0.9, 0.002, period=1 / rate)[0]
        assert got["growth_rate"][place] == pytest.approx(want, rel=0.01, abs=0.02)
        if (rate, kp) != (250.0, 200.0):
            continue
        alone = run(text, f"kp=[{kp}]", f"control_rate=[{rate}]")
        # all end with the duration, whatever the fastest rate of the sweep
        for name in ("integrated_absolute_error", "overshoot", "rise_time", "settling_time",
                     "peak_force", "rms_force"):  # fmt: skip
            np.testing.assert_allclose(got[name][place], alone[name][0], rtol=1e-3, err_msg=name)


@pytest.mark.exhaustive
def test_physics_steps_group_the_samples():
    text = """
    engine = "mass"
    duration = 0.1
    physics_step = 0.0005
    [parameters]
    actuator = "hyq"
    [axes]
    control_rate = [500, 1000]
    kp = [200, 400]
    """
    asked = reading.parse(text)
    samples = expand(asked)
    groups = plans.groups(asked, samples)
    assert [plan.case.drive.substeps for plan in groups] == [2, 4]
    got = execute.run(asked, samples)
    for place, (rate, kp) in enumerate(((500, 200), (500, 400), (1000, 200), (1000, 400))):
        want = exact_growth_rate([kp], [20.0], 0.7, 800.0, 0.45, 0.0, period=1 / rate)[0]
        assert got["growth_rate"][place] == pytest.approx(want, rel=0.01, abs=0.02)


def test_too_many_devices_and_odd_periods_are_refused():
    with pytest.raises(UserError, match="devices = 9"):
        run(NOISY, "devices=9")
    with pytest.raises(UserError, match="multiple"):
        run(NOISY, "physics_step=0.0003")


SWEEPS = """
import sys
from jaxact.cli.main import main

for tile in sys.argv[2:]:
    main([*sys.argv[1].split(), "--out", f"out{tile}", "--set", f"tile={tile}"]) and sys.exit(1)
"""


@pytest.mark.exhaustive
@pytest.mark.parametrize("devices", [1, 2])
def test_no_sweep_hangs(tmp_path, devices):
    """Small and large tiles; in a process of its own, so that one that waits can be ended."""
    sweep = tmp_path / "sweep.toml"
    sweep.write_text(
        'engine = "mjx"\nduration = 0.02\nphysics_step = 0.001\n[axes]\n'
        "kp = {min = 10, max = 1000, num = 64}\nkd = {min = 5, max = 50, num = 32}\n"
    )
    words = f"sweep sweep.toml --quiet --set devices={devices}"
    environment = {key: value for key, value in os.environ.items() if key != "NPROC"}
    environment["PYTHONPATH"] = str(Path(__file__).resolve().parents[2])
    done = subprocess.run(
        [sys.executable, "-c", SWEEPS, words, "32", "1024"],
        capture_output=True, text=True, timeout=300, env=environment, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert {"out32", "out1024"} <= set(os.listdir(tmp_path))


@pytest.mark.exhaustive
def test_a_model_edited_between_two_sweeps_is_another_model(tmp_path):
    model, sweep = tmp_path / "own.xml", tmp_path / "sweep.toml"
    sweep.write_text(
        'engine = "mjx"\nduration = 0.02\nphysics_step = 0.001\n[plant]\nmodel = "own.xml"\n'
        "[parameters]\nkd = 20\n[axes]\nkp = [400]\n"
    )
    rates = []
    for mass in (0.7, 2.8):
        model.write_text(mjx.SLIDE.read_text().replace('mass="0.7"', f'mass="{mass}"'))
        asked = reading.load(sweep)
        samples = expand(asked)
        (plan,) = plans.groups(asked, samples)
        numbers = np.zeros(plan.batch, int)
        rates.append(spectra.rates_batch(plan, asked, samples, numbers).growth[0])
    # -kd / (2 m) for an undelayed, lightly damped loop, up to sampling
    assert rates[1] == pytest.approx(-20.0 / (2 * 2.8), rel=0.1)
    assert rates[0] == pytest.approx(-20.0 / (2 * 0.7), rel=0.1)
