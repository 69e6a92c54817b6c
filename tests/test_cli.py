"""The command line as a person meets it: exit codes, one line on standard error, files."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import xarray as xr

from jaxact.cli import _xla
from jaxact.cli.main import VERBS

ROOT = Path(__file__).resolve().parent.parent
SMALL = """
engine = "mass"
duration = 0.5
[axes]
actuator = ["ideal", "starleth"]
kp = [100.0, 1000.0, 1e6]
kd = [20.0]
"""


def _environment():
    # the user's shell, not the strict settings of the tests
    strict = ("JAX_NUM_CPU_DEVICES", "JAX_NUMPY_RANK_PROMOTION", "XLA_FLAGS")
    kept = {name: value for name, value in os.environ.items() if name not in strict}
    return kept | {"PYTHONPATH": str(ROOT)}


def jaxact(*arguments, cwd=None, **environment):
    return subprocess.run(
        [sys.executable, "-m", "jaxact.cli.main", *map(str, arguments)],
        capture_output=True, text=True, cwd=cwd, env=_environment() | environment, timeout=300,
        stdin=subprocess.DEVNULL,
    )  # fmt: skip


@pytest.fixture
def small(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


def _refused(ran):
    assert ran.returncode == 2, ran.stderr
    assert ran.stdout == ""
    assert ran.stderr.startswith("jaxact: ") and ran.stderr.count("\n") == 1
    return ran.stderr


def test_help_names_every_verb():
    ran = jaxact("--help")
    assert ran.returncode == 0 and ran.stderr == ""
    for verb in VERBS:
        assert f"\n  {verb} " in ran.stdout
    assert jaxact().stdout == ran.stdout == jaxact("help").stdout


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help_with_examples_and_loads_no_jax(verb):
    code = (
        "import sys; from jaxact.cli.main import main\n"
        f"try: main(['{verb}', '--help'])\n"
        "finally: print('JAX' if 'jax' in sys.modules else 'light')"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=_environment()
    )
    assert ran.returncode == 0, ran.stderr
    assert f"usage: jaxact {verb}" in ran.stdout and f"  jaxact {verb}" in ran.stdout
    assert ran.stdout.splitlines()[-1] == "light"


def test_version():
    assert jaxact("--version").stdout.startswith("jaxact 0.")


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["swep"], "did you mean 'sweep'"),
        (["sweep"], "SPECIFICATION"),
        (["sweep", "a.toml", "--sett", "kp=1"], "--set"),
        (["sweep", "a.toml", "b.toml"], "b.toml"),
        (["sweep", "absent.toml"], "absent.toml: no such file"),
        (["sweep", ""], "no file"),
        (["sweep", "."], "no file"),
        (["sweep", "small.toml", "--set"], "--set"),
        (["sweep", "small.toml", "--set", "mas=1"], "did you mean 'mass'"),
        (["sweep", "small.toml", "--set", "mass=-1"], "parameters.mass = -1"),
        (["sweep", "small.toml", "--set", "engine=mjx", "--set", "control_rate=3000"], "multiple"),
        (["sweep", "small.toml", "--set", "delay=[60]"], "out of range"),
        (["sweep", "small.toml", "--set", "delay=[6]"], "history"),
        (["sweep", "small.toml", "--out", "small.toml"], "cannot be written"),
        (["sweep", "small.toml", "--out", "/proc/nowhere"], "cannot be written"),
        (["plot", "absent"], "absent"),
        (["export", "absent", "x.nc"], "absent"),
        (["export", "."], "FILE"),
        (["info", "--jsn"], "--jsn"),
    ],
)
def test_a_mistake_is_one_line_exit_code_2_and_nothing_written(arguments, part, small):
    before = sorted(small.parent.rglob("*"))
    message = _refused(jaxact(*arguments, cwd=small.parent))
    assert part in message
    assert sorted(small.parent.rglob("*")) == before


def test_sweep_plot_export(small, tmp_path):
    ran = jaxact("sweep", small, cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert ran.stderr == "", "no progress bar where standard error is no terminal"
    store = tmp_path / "results" / "small" / "sweep.zarr"
    assert "results/small/sweep.zarr" in ran.stdout and "6 loops" in ran.stdout
    assert "actuator = starleth" in ran.stdout

    results = xr.open_zarr(store).load()
    assert results.sizes == {"actuator": 2, "kp": 3, "kd": 1}
    assert results["verdict"].sel(actuator="ideal", kp=100.0, kd=20.0) == 0
    assert results["verdict"].sel(actuator="ideal", kp=1e6, kd=20.0) == 2
    assert json.loads(results.attrs["specification"])["duration"] == 0.5
    assert results.attrs["command"].endswith(f"sweep {small}")

    message = _refused(jaxact("sweep", small, cwd=tmp_path))
    assert "results/small/sweep.zarr: exists" in message and "--overwrite" in message
    xr.testing.assert_identical(xr.open_zarr(store).load(), results)

    again = jaxact("sweep", small, "--overwrite", "--quiet", "--set", "kd=10", cwd=tmp_path)
    assert (again.returncode, again.stdout, again.stderr) == (0, "", "")
    assert "kd" not in xr.open_zarr(store).sizes
    assert [item.name for item in store.parent.iterdir()] == ["sweep.zarr"]

    exported = jaxact("export", "results/small", "small.nc", cwd=tmp_path)
    assert exported.returncode == 0 and (tmp_path / "small.nc").stat().st_size > 0
    assert "--overwrite" in _refused(jaxact("export", "results/small", "small.nc", cwd=tmp_path))


def test_results_do_not_depend_on_where_or_how_they_were_computed(small, tmp_path):
    two = jaxact("sweep", small, "--out", tmp_path / "two", JAX_NUM_CPU_DEVICES="2")
    one = jaxact("sweep", small, "--out", tmp_path / "one", JAX_NUM_CPU_DEVICES="1")
    assert one.returncode == two.returncode == 0, one.stderr + two.stderr
    first, second = (xr.open_zarr(tmp_path / name / "sweep.zarr").load() for name in ("one", "two"))
    xr.testing.assert_equal(first, second)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupted_sweep_leaves_nothing(number, code, small, tmp_path):
    running = subprocess.Popen(
        [sys.executable, "-m", "jaxact.cli.main", "sweep", small, "--set", "duration=2000"],
        cwd=tmp_path, stderr=subprocess.PIPE, text=True, env=_environment(),
    )  # fmt: skip
    while not (tmp_path / "results" / "small").is_dir() and running.poll() is None:
        time.sleep(0.05)
    time.sleep(1.0)
    running.send_signal(number)
    _, said = running.communicate(timeout=120)
    assert running.returncode == code, said
    assert "Traceback" not in said and said.count("\n") <= 1
    assert sorted(item.name for item in tmp_path.iterdir()) == ["small.toml"]


def test_info_is_what_a_bug_report_needs():
    ran = jaxact("info", "--json")
    facts = json.loads(ran.stdout)
    assert ran.returncode == 0 and ran.stderr == ""
    assert {"jaxact", "python", "jax", "mujoco", "platform", "cpu cores"} <= set(facts)
    assert facts["jax devices"] and facts["float64 by default"] is False
    table = jaxact("info")
    for name in facts:
        assert f"\n{name} " in f"\n{table.stdout}"


def test_parameters_lists_units_and_defaults():
    lines = jaxact("parameters").stdout.splitlines()
    assert next(line for line in lines if line.startswith("mass ")).split()[:3] == (
        ["mass", "kg", "0.7"]
    )


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("", "--xla_cpu_prefer_vector_width=512"),
        ("--xla_x=1", "--xla_x=1 --xla_cpu_prefer_vector_width=512"),
        ("--xla_cpu_prefer_vector_width=256", "--xla_cpu_prefer_vector_width=256"),
    ],
)
def test_the_users_own_xla_flags_are_respected(given, expected, monkeypatch):
    monkeypatch.setattr(_xla, "_has_wide_vectors", lambda: True)
    monkeypatch.setenv("XLA_FLAGS", given)
    monkeypatch.setenv(_xla.DEVICE_COUNT, "7")
    _xla.prepare(all_cores=True)
    assert os.environ["XLA_FLAGS"] == expected and os.environ[_xla.DEVICE_COUNT] == "7"


def test_a_sweep_gets_a_device_for_every_core(monkeypatch):
    monkeypatch.setattr(_xla, "_has_wide_vectors", lambda: False)
    monkeypatch.setenv("XLA_FLAGS", "")
    monkeypatch.delenv(_xla.DEVICE_COUNT, raising=False)
    monkeypatch.setenv("JAX_NUM_CPU_DEVICES", "")
    monkeypatch.delenv("JAX_NUM_CPU_DEVICES")
    _xla.prepare(all_cores=True)
    assert os.environ[_xla.DEVICE_COUNT] == str(_xla.cores())
    assert os.environ["XLA_FLAGS"] == ""
