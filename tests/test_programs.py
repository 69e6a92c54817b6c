"""Compiled programs that are kept: found again by what they compute, and by nothing else."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

from jaxact.compilation import programs
from jaxact.compilation.programs import Program

# A computation with a call of LAPACK and a loop on two devices, in a process of its own.
COMPUTE = """
import sys
import jax, jax.numpy as jnp, numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxact.compilation.programs import Program

def make():
    print("traced")
    mesh = Mesh(np.array(jax.local_devices()), ("device",))
    one = jax.vmap(lambda x: jnp.linalg.cholesky(x @ x.T + jnp.eye(3)) + jnp.sin(x))
    spec = PartitionSpec("device")
    return jax.shard_map(one, mesh=mesh, in_specs=spec, out_specs=spec)

x = np.linspace(0.0, 1.0, 36, dtype=np.float32).reshape(4, 3, 3)
np.save(sys.argv[1], Program(make, "cholesky", devices=2)(x))
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(programs.FOLDER, str(tmp_path / "programs"))
    # what XLA loads from JAX's own cache is not kept once more
    jax.config.update("jax_enable_compilation_cache", False)
    yield tmp_path / "programs"
    jax.config.update("jax_enable_compilation_cache", True)


def _counted(name="square", factor=2.0):
    """A program, and how often it was made."""
    made = []

    def make():
        made.append(1)
        return lambda x: factor * x["a"] ** 2

    return Program(make, name), made


X = {"a": np.arange(3.0, dtype=np.float32)}


def test_a_kept_program_is_not_made_again(folder):
    first, made = _counted()
    want = np.asarray(first(X))
    np.testing.assert_array_equal(want, 2.0 * X["a"] ** 2)
    again, made_again = _counted()
    np.testing.assert_array_equal(again(X), want)
    assert len(made) == 1 and not made_again
    assert len(list(folder.iterdir())) == 1


@pytest.mark.parametrize(
    "change", ["name", "shape", "dtype", "structure", "weak", "double", "settings", "flags"]
)
def test_whatever_a_trace_depends_on_makes_another_program(change, folder, monkeypatch):
    _counted()[0](X)
    x, double, precision = X, False, None
    other, made = _counted("cube" if change == "name" else "square")
    if change == "shape":
        x = {"a": np.zeros(4, np.float32)}
    elif change == "dtype":
        x = {"a": np.arange(3)}
    elif change == "structure":
        x = X | {"b": X["a"]}
    elif change == "weak":
        x = {"a": 1.0}
    elif change == "flags":
        monkeypatch.setenv("XLA_FLAGS", os.environ.get("XLA_FLAGS", "") + " ")
    elif change == "double":
        double = True
    elif change == "settings":
        precision = jax.config.jax_default_matmul_precision
        jax.config.update("jax_default_matmul_precision", "highest")
    with jax.enable_x64(double):
        other(x)
    if change == "settings":
        jax.config.update("jax_default_matmul_precision", precision)
    assert made and len(list(folder.iterdir())) == 2


@pytest.fixture
def compute(tmp_path):
    """Runs it in a process of its own: what it has said, and its result."""

    def compute(**environment):
        out = tmp_path / "out.npy"
        own = {"JAX_NUM_CPU_DEVICES": "2", programs.FOLDER: str(tmp_path / "programs")}
        ran = subprocess.run(
            [sys.executable, "-c", COMPUTE, str(out)],
            capture_output=True, text=True, env=os.environ | own | environment,
        )  # fmt: skip
        assert ran.returncode == 0, ran.stderr
        return ran.stdout, np.load(out)

    return compute


def test_another_process_finds_it_and_gets_the_same_bits(compute):
    (said, first), (later, second) = compute(), compute()
    assert (said, later) == ("traced\n", "")
    np.testing.assert_array_equal(first, second)
    x = np.linspace(0.0, 1.0, 36).reshape(4, 3, 3)
    want = np.linalg.cholesky(x @ x.transpose(0, 2, 1) + np.eye(3)) + np.sin(x)
    np.testing.assert_allclose(first, want, rtol=1e-5, atol=1e-6)


def test_what_comes_from_jaxs_own_cache_is_not_kept(compute, tmp_path):
    """XLA could load it once more, but not run it."""
    own = {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "kernels"), "TF_CPP_MIN_LOG_LEVEL": "3"}
    own["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    said, first = compute(**own)
    (file,) = (tmp_path / "programs").iterdir()
    file.unlink()
    for _ in range(2):
        said, found = compute(**own)
        assert said == "traced\n"
        np.testing.assert_array_equal(found, first)


@pytest.mark.parametrize("damage", ["truncated", "flipped", "nonsense", "empty"])
def test_a_damaged_file_is_compiled_anew_and_mended(damage, folder):
    _counted()[0](X)
    (file,) = folder.iterdir()
    content = file.read_bytes()
    middle = len(content) // 2
    file.write_bytes(
        {
            "truncated": content[:middle],
            "flipped": content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :],
            "nonsense": b"nonsense",
            "empty": b"",
        }[damage]
    )
    program, made = _counted()
    np.testing.assert_array_equal(program(X), 2.0 * X["a"] ** 2)
    assert made
    third, made = _counted()
    np.testing.assert_array_equal(third(X), 2.0 * X["a"] ** 2)
    assert not made


def test_what_calls_back_into_the_process_is_not_kept(folder):
    def doubled(x):
        return jax.pure_callback(lambda x: 2.0 * x, jax.ShapeDtypeStruct((3,), jnp.float32), x)

    np.testing.assert_array_equal(Program(lambda: doubled, "callback")(X["a"]), 2.0 * X["a"])
    assert not folder.exists()


def test_a_name_with_arrays_is_no_name(folder):
    program = Program(lambda: jnp.sin, ("sine", np.zeros(3)))
    program(X["a"])
    assert not folder.exists()


def test_without_a_name_or_a_folder_nothing_is_kept(folder, monkeypatch):
    Program(lambda: jnp.sin, None)(X["a"])
    monkeypatch.delenv(programs.FOLDER)
    Program(lambda: jnp.sin, "sine")(X["a"])
    assert not folder.exists()


def test_a_folder_that_cannot_be_written_is_no_error(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(programs.FOLDER, str(tmp_path / "file"))
    np.testing.assert_array_equal(_counted()[0](X), 2.0 * X["a"] ** 2)


def test_programs_that_were_not_used_for_longest_make_room(folder, monkeypatch):
    for number, name in enumerate("abc"):
        _counted(name)[0](X)
        newest = max(folder.iterdir(), key=lambda file: file.stat().st_mtime)
        os.utime(newest, (number, number))
    (folder / "somebody's").write_bytes(bytes(10**6))
    os.utime(folder / "somebody's", (0, 0))
    monkeypatch.setattr(
        programs, "MOST", sum(f.stat().st_size for f in folder.glob("*.program")) + 10
    )
    _counted("a")[0](X)  # is the newest now
    _counted("d")[0](X)
    assert (folder / "somebody's").exists()
    assert len(list(folder.iterdir())) == 1 + 3
    for name, expected in {"a": 0, "c": 0, "d": 0, "b": 1}.items():
        program, made = _counted(name)
        program(X)
        assert len(made) == expected, name


def test_a_program_lets_go_of_what_it_compiled_first():
    """Of arrays of ever other shapes; else a process runs out of mappings of memory."""
    double = Program(lambda: lambda x: 2.0 * x, None)
    for size in range(1, programs.KEPT + 4):
        assert np.all(np.asarray(double(jnp.ones(size))) == 2.0)
    assert len(double._compiled) == programs.KEPT
    assert np.all(np.asarray(double(jnp.ones(1))) == 2.0)
