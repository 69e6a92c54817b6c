"""The command line as a person meets it: exit codes, one line on standard error, files."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import command_line
import pytest
import xarray as xr
from quickly import ENVIRONMENT

from jaxact.cli import _cache, _xla
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

NOISY = """
engine = "mass"
duration = 0.2
tile = 16
[parameters]
actuator = "starleth"
position_noise = 1e-4
position_resolution = 1e-4
force_limit = 60
[axes]
delay = [0.0, 0.0013]
kp = { min = 10, max = 2e6, num = 9, spacing = "log" }
kd = { min = 1, max = 100, num = 5, spacing = "log" }
"""


def _environment():
    # the user's shell, not the strict settings of the tests
    strict = ("JAX_NUM_CPU_DEVICES", "JAX_NUMPY_RANK_PROMOTION", "XLA_FLAGS")
    kept = {name: value for name, value in os.environ.items() if name not in strict}
    return kept | {"PYTHONPATH": str(ROOT)}


def jaxact(*arguments, cwd=None, **environment):
    return subprocess.run(
        [sys.executable, "-m", "jaxact", *map(str, arguments)],
        capture_output=True, text=True, cwd=cwd, env=_environment() | ENVIRONMENT | environment,
        timeout=300, stdin=subprocess.DEVNULL,
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


def test_a_mistake_ends_the_process_with_exit_code_2(small):
    assert "did you mean 'mass'" in _refused(jaxact("sweep", small, "--set", "mas=1"))


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["swep"], "did you mean 'sweep'"),
        (["sweep"], "SPECIFICATION"),
        (["sweep", "a.toml", "--sett", "kp=1"], "--set"),
        (["sweep", "a.toml", "b.toml"], "b.toml"),
        (["sweep", "absent.toml"], "absent.toml: no such file"),
        (["sweep", ""], "not a file"),
        (["sweep", "."], "not a file"),
        (["sweep", "small.toml", "--set"], "--set"),
        (["sweep", "small.toml", "--set", "mas=1"], "did you mean 'mass'"),
        (["sweep", "small.toml", "--set", "mass=-1"], "parameters.mass = -1"),
        (["sweep", "small.toml", "--set", "engine=mjx", "--set", "control_rate=3000"], "multiple"),
        (["sweep", "small.toml", "--set", "delay=[60]"], "out of range"),
        (["sweep", "small.toml", "--set", "delay=[6]"], "history"),
        (["sweep", "small.toml", "--out", "small.toml"], "cannot be written"),
        (["sweep", "small.toml", "--out", "/proc/nowhere"], "cannot be written"),
        (["sweep", "small.toml", "--resume", "--overwrite"], "give one"),
        (["sweep", "small.toml", "--memory", "lots"], "800M"),
        (["sweep", "small.toml", "--memory", "3M"], "needs at least"),
        (["sweep", "small.toml", "--width", "0.1"], "--adaptive"),
        (["sweep", "small.toml", "--adaptive"], "no axis is a range"),
        (["sweep", "small.toml", "--adaptive", "--width", "0"], "1e-9"),
        (["sweep", "small.toml", "--address", "auto"], "--workers ray"),
        (["sweep", "small.toml", "--workers", "dask"], "ray"),
        (["sweep", "small.toml", "--out", "nonsense://x"], "nonsense"),
        (["status", "absent"], "absent"),
        (["validate", "."], "not a result"),
        (["plot", "absent"], "absent"),
        (["export", "absent", "x.nc"], "absent"),
        (["export", "."], "FILE"),
        (["export", "absent", "x.xls"], "must end in .nc"),
        (["info", "--jsn"], "--jsn"),
    ],
)
def test_a_mistake_is_one_line_exit_code_2_and_nothing_written(arguments, part, small):
    before = sorted(small.parent.rglob("*"))
    message = _refused(command_line.jaxact(*arguments, cwd=small.parent))
    assert part in message
    assert sorted(small.parent.rglob("*")) == before


def test_sweep_plot_export(small, tmp_path):
    ran = jaxact("sweep", small, cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert ran.stderr == "", "no progress bar where standard error is not a terminal"
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


@pytest.mark.exhaustive
def test_results_do_not_depend_on_where_or_how_they_were_computed(tmp_path):
    (tmp_path / "noisy.toml").write_text(NOISY)
    asked = ["sweep", tmp_path / "noisy.toml"]
    # Compiled as users have it: what is optimised little is rounded alike anyway.
    shipped = {"JAX_DISABLE_MOST_OPTIMIZATIONS": "0", "XLA_FLAGS": ""}
    two = jaxact(*asked, "--out", tmp_path / "two", JAX_NUM_CPU_DEVICES="2", **shipped)
    one = jaxact(*asked, "--out", tmp_path / "one", JAX_NUM_CPU_DEVICES="1", **shipped)
    assert one.returncode == two.returncode == 0, one.stderr + two.stderr
    first, second = (xr.open_zarr(tmp_path / name / "sweep.zarr").load() for name in ("one", "two"))
    xr.testing.assert_equal(first, second)


@pytest.mark.exhaustive
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_sweep_interrupted_before_its_first_chunk_leaves_nothing(number, code, small, tmp_path):
    running = subprocess.Popen(
        [sys.executable, "-m", "jaxact", "sweep", small, "--set", "duration=2000"],
        cwd=tmp_path, stderr=subprocess.PIPE, text=True, env=_environment(),
    )  # fmt: skip
    while not (tmp_path / "results" / "small").is_dir() and running.poll() is None:
        time.sleep(0.05)
    time.sleep(1.0)
    running.send_signal(number)
    _, said = running.communicate(timeout=120)
    assert running.returncode == code, said
    assert said == "jaxact: interrupted; nothing was done yet, nothing is kept\n"
    assert sorted(item.name for item in tmp_path.iterdir()) == ["small.toml"]


def test_an_interrupted_sweep_says_how_to_continue_and_does(tmp_path):
    (tmp_path / "long.toml").write_text(
        'engine = "mass"\nduration = 20\n[axes]\nkp = {min = 10, max = 1000, num = 1000}\n'
        "kd = {min = 1, max = 100, num = 1000}\n"
    )
    command = ["sweep", "long.toml", "--set", "duration=20"]
    done = 0
    for number, code, more in ((signal.SIGINT, 130, []), (signal.SIGTERM, 143, ["--resume"])):
        before, (done, chunks) = done, _interrupted(tmp_path, command, more, number, code)
        assert before < done < chunks
    told = jaxact("status", "results/long", cwd=tmp_path).stdout
    assert f"done     {done} of {chunks} chunks" in told and "not running" in told
    assert "--resume" in _refused(jaxact("plot", "results/long", cwd=tmp_path))
    assert "missing" in _refused_checks(jaxact("validate", "results/long", cwd=tmp_path))
    assert sorted(item.name for item in (tmp_path / "results/long").iterdir()) == ["sweep.zarr"]


def _interrupted(folder, command, more, number, code):
    """Chunks that are done, and all of them, after a signal; another process is kept out before."""
    receipts = folder / "results/long/sweep.zarr/progress/receipt"
    before = len(list(receipts.glob("c.*")))
    running = subprocess.Popen(
        [sys.executable, "-m", "jaxact", *command, *more],
        cwd=folder, stderr=subprocess.PIPE, text=True, env=_environment(),
    )  # fmt: skip
    while len(list(receipts.glob("c.*"))) == before and running.poll() is None:
        time.sleep(0.05)
    running.send_signal(signal.SIGSTOP)  # or a fast machine ends the sweep before it is looked at
    second = _refused(jaxact(*command, "--resume", cwd=folder))
    assert f"process {running.pid} on " in second
    running.send_signal(number)
    running.send_signal(signal.SIGCONT)
    _, said = running.communicate(timeout=120)
    assert running.returncode == code, said
    match = re.fullmatch(r"jaxact: interrupted; (\d+) of (\d+) chunks are kept, (.*)\n", said)
    assert match and match[3] == f"continue with: jaxact {' '.join(command)} --resume"
    assert int(match[1]) == len(list(receipts.glob("c.*")))
    return int(match[1]), int(match[2])


def _refused_checks(ran):
    """`validate` has printed what it found before it says that something is wrong."""
    assert ran.returncode == 2 and ran.stderr.count("\n") == 1, ran.stderr
    return ran.stderr


@pytest.mark.exhaustive
def test_status_and_validate_of_a_result(small, tmp_path):
    assert command_line.jaxact("sweep", small, "--out", "out", cwd=tmp_path).returncode == 0
    said = command_line.jaxact("status", "out", cwd=tmp_path).stdout.splitlines()
    assert said[0] == "done     1 of 1 chunks, 6 loops" and said[-1] == "complete"
    assert (
        command_line.jaxact("status", "out", "--quick", cwd=tmp_path).stdout.splitlines()[0]
        == said[0]
    )
    ran = command_line.jaxact("validate", "out", "--samples", "4", cwd=tmp_path)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert ran.stdout.splitlines() == [
        "1 of 1 chunks are whole", "4 loops computed again: bit for bit the same",
    ]  # fmt: skip
    chunk = tmp_path / "out/sweep.zarr/rms_force/c.0.0.0"
    content = bytearray(chunk.read_bytes())
    content[1] ^= 1
    chunk.write_bytes(content)
    assert (
        "rms_force: its checksum is wrong"
        in command_line.jaxact("status", "out", cwd=tmp_path).stdout
    )
    assert "rms_force" in _refused_checks(command_line.jaxact("validate", "out", cwd=tmp_path))
    assert "validate" in _refused(command_line.jaxact("plot", "out", "--quick", cwd=tmp_path))
    again = command_line.jaxact("sweep", small, "--out", "out", "--resume", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert command_line.jaxact("validate", "out", "--samples", "0", cwd=tmp_path).returncode == 0


def test_a_dry_run_of_a_hundred_million_loops_answers_at_once_and_writes_nothing(tmp_path):
    (tmp_path / "big.toml").write_text(
        'engine = "mass"\n[axes]\nkp = {min = 10, max = 1e5, num = 10000, spacing = "log"}\n'
        "kd = {min = 1, max = 100, num = 10000}\n"
    )
    ran = jaxact("sweep", "big.toml", "--dry-run", "--memory", "2G", cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    lines = ran.stdout.splitlines()
    assert lines[0].startswith("100,000,000 loops (kp 10,000 x kd 10,000)")
    assert "chunks of up to" in lines[1] and "tiles of 128" in lines[1]
    assert "of 2 GiB allowed" in lines[2] and lines[3].startswith("time: about")
    assert [item.name for item in tmp_path.iterdir()] == ["big.toml"]


@pytest.mark.exhaustive
def test_a_cache_that_cannot_be_written_is_one_line(small, tmp_path):
    (tmp_path / "file").write_text("")
    for where, more in (("/proc/nowhere", ["--dry-run"]), (str(tmp_path / "file"), [])):
        ran = jaxact("sweep", small, *more, cwd=tmp_path, XDG_CACHE_HOME=where)
        assert ran.returncode == 0, ran.stderr
        assert ran.stderr.count("\n") == 1 and f"{where}/jaxact: cannot be used" in ran.stderr
    assert (tmp_path / "results" / "small").is_dir()
    more = ["--overwrite", "--no-cache", "--dry-run"]
    quiet = jaxact("sweep", small, *more, cwd=tmp_path, XDG_CACHE_HOME=where)
    assert (quiet.returncode, quiet.stderr) == (0, "")


@pytest.mark.exhaustive
def test_compiled_programs_are_kept_and_a_damaged_cache_is_no_error(small, tmp_path):
    cache = tmp_path / "cache"
    first = jaxact("sweep", small, "--out", "one", cwd=tmp_path, XDG_CACHE_HOME=str(cache))
    programs = sorted((cache / "jaxact" / "programs").iterdir())
    assert first.returncode == 0 and programs
    contents = [path.read_bytes() for path in programs]
    jaxact("sweep", small, "--out", "two", cwd=tmp_path, XDG_CACHE_HOME=str(cache))
    assert sorted((cache / "jaxact" / "programs").iterdir()) == programs
    assert [path.read_bytes() for path in programs] == contents
    for path in programs:
        path.write_bytes(b"nonsense")
    third = jaxact("sweep", small, "--out", "three", cwd=tmp_path, XDG_CACHE_HOME=str(cache))
    assert (third.returncode, third.stderr) == (0, "")
    results = [
        xr.open_zarr(tmp_path / out / "sweep.zarr").load() for out in ("one", "two", "three")
    ]
    xr.testing.assert_equal(results[0], results[1])
    xr.testing.assert_equal(results[0], results[2])
    assert all(path.stat().st_size > 1000 for path in programs)


@pytest.mark.exhaustive
def test_other_commands_keep_their_programs_too_and_say_nothing_where_they_cannot(tmp_path):
    words = ["margins", "--kp", "400", "--kd", "20", "--json"]
    said = [
        jaxact(*words, XDG_CACHE_HOME=where, MPLCONFIGDIR=str(tmp_path))
        for where in (str(tmp_path), str(tmp_path), "/proc/nowhere")
    ]
    assert [(ran.returncode, ran.stderr) for ran in said] == [(0, "")] * 3
    assert len({ran.stdout for ran in said}) == 1
    assert any((tmp_path / "jaxact" / "programs").iterdir())


@pytest.mark.parametrize("where", ["jaxact", "jaxact/programs", "own"])
def test_a_cache_that_others_can_write_to_is_not_used(where, tmp_path, monkeypatch, capsys):
    for name in (_cache._KERNELS, _cache._PROGRAMS, _cache._SHORTEST, _cache._LOUDNESS):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(_cache, "_accelerated", lambda: True)
    (tmp_path / where).mkdir(parents=True)
    (tmp_path / where).chmod(0o777)
    if where == "own":
        monkeypatch.setenv(_cache._PROGRAMS, str(tmp_path / where))
    _cache.prepare(quiet=True)
    said = capsys.readouterr().err
    assert said == (
        f"jaxact: {tmp_path / where}: can be written to by others (chmod go-w); compiling anew\n"
    )
    assert _cache._PROGRAMS not in os.environ
    assert (_cache._KERNELS in os.environ) == (where != "jaxact")
    (tmp_path / where).chmod(0o755)
    _cache.prepare(quiet=True)
    assert _cache._PROGRAMS in os.environ and capsys.readouterr().err == ""


def test_info_is_what_a_bug_report_needs():
    ran = jaxact("info", "--json")
    facts = json.loads(ran.stdout)
    assert ran.returncode == 0 and ran.stderr == ""
    assert {"jaxact", "python", "jax", "mujoco", "platform", "cpu cores"} <= set(facts)
    assert facts["jax devices"] and facts["float64 by default"] is False
    table = jaxact("info")
    for name in facts:
        assert f"\n{name} " in f"\n{table.stdout}"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize("words", [["parameters"], ["info", "--json"]])
def test_output_to_a_full_disk_is_one_line(words):
    with open("/dev/full", "w") as full:
        ran = subprocess.run(
            [sys.executable, "-m", "jaxact", *words],
            stdout=full, stderr=subprocess.PIPE, text=True, env=_environment() | ENVIRONMENT,
        )  # fmt: skip
    assert ran.returncode == 2
    assert ran.stderr == "jaxact: the disk is full; make room and run the command again\n"


def test_parameters_lists_units_and_defaults():
    lines = command_line.jaxact("parameters").stdout.splitlines()
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


@pytest.mark.parametrize(
    ("given", "expected"),
    [({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3"), ({"OMP_NUM_THREADS": "4"}, None)],
)
def test_openblas_gets_one_thread_unless_the_user_says_otherwise(given, expected, monkeypatch):
    monkeypatch.setattr(os, "environ", dict(given))
    _xla.prepare()
    assert os.environ.get(_xla.THREADS) == expected


@pytest.mark.parametrize(
    ("command", "given", "expected"),
    [
        (["margins", "--kp", "400"], {}, "cpu"),
        (["tune", "--ms", "1.4"], {}, "cpu"),
        (["simulate", "--model", "robot.xml"], {}, "cpu"),
        (["sweep", "map.toml"], {}, None),
        (["validate", "results/map"], {}, None),
        (["simulate", "--model", "robot.xml", "--engine", "warp"], {}, None),
        (["margins"], {"JAX_PLATFORMS": "cuda,cpu"}, "cuda,cpu"),
        (["margins"], {"JAX_PLATFORMS": ""}, ""),
    ],
)
def test_a_gpu_is_started_for_sweeps_only(command, given, expected, monkeypatch):
    monkeypatch.setattr(os, "environ", dict(given))
    _xla.leave_gpu_alone(command)
    assert os.environ.get("JAX_PLATFORMS") == expected


def test_a_command_computes_where_its_kind_is_fast(monkeypatch):
    words = "import sys; from jaxact.cli import main, _cache; main.main = lambda: 0; "
    words += "import os; sys.argv = ['jaxact', *sys.argv[1:]]\n"
    words += "try: main.entry()\nexcept SystemExit: print(os.environ.get('JAX_PLATFORMS'))"
    here = {name: value for name, value in os.environ.items() if name != "JAX_PLATFORMS"}
    for verb, expected in (("margins", "cpu"), ("sweep", "None"), ("info", "None")):
        done = subprocess.run(
            [sys.executable, "-c", words, verb],
            env=here,
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout.strip() == expected


def test_a_sweep_gets_a_device_for_every_core(monkeypatch):
    monkeypatch.setattr(_xla, "_has_wide_vectors", lambda: False)
    monkeypatch.setenv("XLA_FLAGS", "")
    monkeypatch.delenv(_xla.DEVICE_COUNT, raising=False)
    monkeypatch.setenv("JAX_NUM_CPU_DEVICES", "")
    monkeypatch.delenv("JAX_NUM_CPU_DEVICES")
    _xla.prepare(all_cores=True)
    assert os.environ[_xla.DEVICE_COUNT] == str(_xla.cores())
    assert os.environ["XLA_FLAGS"] == ""
