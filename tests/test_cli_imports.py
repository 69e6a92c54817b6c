"""A command imports what it uses, and not what others use: people wait for it."""

import os
import subprocess
import sys

import pytest
from quickly import ENVIRONMENT

# Packages that take a tenth of a second or more.
SLOW = {
    "jax", "matplotlib", "matplotlib.pyplot", "mujoco", "mujoco.mjx", "optax", "pandas", "scipy",
    "scipy.optimize", "scipy.signal", "scipy.stats", "trimesh", "xarray", "zarr",
}  # fmt: skip
SHOW = """
import sys
from jaxact.cli.main import main
sys.argv[0] = "jaxact"
try:
    sys.exit(main(sys.argv[2:]))
finally:
    print("imported:", *sorted(set(sys.argv[1].split()) & set(sys.modules)))
"""
MODEL = "experiments/quadruped/quadruped.xml"
# Of JAX's linear algebra, and of what refines a curve's peaks.
ALGEBRA = {"scipy", "scipy.optimize"}


def imported(*command, asked=SLOW):
    """Which of these packages a command has imported when it is done."""
    done = subprocess.run(
        [sys.executable, "-c", SHOW, " ".join(asked), *command],
        env=os.environ | ENVIRONMENT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return set(done.stdout.rpartition("imported:")[2].split())


@pytest.mark.parametrize(
    ("command", "used"),
    [
        (("--help",), set()),
        (("parameters",), set()),
        (("sweep", "--help"), set()),
        (("margins", "--actuator", "hyq"), {"jax"}),
        (("check", MODEL, "--help"), set()),
    ],
)  # fmt: skip
def test_a_command_imports_no_slow_package_but_what_it_uses(command, used):
    assert imported(*command) == used


@pytest.mark.parametrize("verb", ["margins", "render", "simulate", "status", "sweep", "tune"])
def test_help_does_without_what_computes(verb):
    assert imported(verb, "--help", asked={"numpy", "pydantic"}) == set()


@pytest.mark.exhaustive
def test_pictures_of_one_joint_import_matplotlib_and_no_simulator(tmp_path):
    out = str(tmp_path / "picture.png")
    assert imported("bode", "--actuator", "hyq", "--out", out) == {"jax", "matplotlib"}


@pytest.mark.exhaustive
def test_tuning_one_joint_imports_neither_pictures_nor_robots():
    used = imported("tune", "--actuator", "hyq", "--delay", "2e-3", "--max-peak", "1.6")
    assert used == {"jax", "optax"} | ALGEBRA


@pytest.mark.exhaustive
def test_the_simulation_of_one_joint_imports_no_simulator_of_robots(tmp_path):
    out = str(tmp_path / "picture.png")
    found = imported("simulate", "--actuator", "hyq", "--duration", "0.02", "--out", out)
    assert found - ALGEBRA == {"jax", "matplotlib"}


def test_margins_of_a_robot_linearised_in_c_import_no_mjx():
    found = imported(
        "margins", "--model", MODEL, "--keyframe", "stand", "--kp", "600", "--kd", "30"
    )
    assert found - ALGEBRA == {"jax", "mujoco"}


def test_the_report_of_a_joint_imports_nothing_of_identification(tmp_path):
    found = imported("report", "--actuator", "hyq", "--out", str(tmp_path / "joint.html"))
    assert found - ALGEBRA == {"jax"}
