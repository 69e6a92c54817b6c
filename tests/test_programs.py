"""Compiled programs that are kept: found by what they follow from, in a folder of one's own."""

import functools
import math
import os
import shutil
import subprocess
import sys
from contextlib import nullcontext
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

import jaxact
from jaxact.compilation import keys, programs
from jaxact.compilation.programs import Program, building

# A computation with a call of LAPACK and a loop on two devices, as a module of a package.
MODULE = """
import functools
import jax, jax.numpy as jnp, numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxact.compilation.programs import Program, building

def make(*, devices, offset):
    print("traced")
    mesh = Mesh(np.array(jax.local_devices()[:devices]), ("device",))
    one = jax.vmap(lambda x: jnp.linalg.cholesky(x @ x.T + offset * jnp.eye(3)) + jnp.sin(x))
    spec = PartitionSpec("device")
    return jax.shard_map(one, mesh=mesh, in_specs=spec, out_specs=spec)

program = building(make)
"""
# The same in a process of its own, whose jaxact is a copy with this module.
COMPUTE = """
import sys
import numpy as np
from jaxact.own import program

x = np.linspace(0.0, 1.0, 36, dtype=np.float32).reshape(4, 3, 3)
np.save(sys.argv[1], program(x, devices=2, offset=float(sys.argv[2])))
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(programs.FOLDER, str(tmp_path / "programs"))
    # the functions below count as jaxact's
    monkeypatch.setattr(keys, "PACKAGE", __name__)
    programs._say.cache_clear()
    # what XLA loads from JAX's own cache is not kept once more
    jax.config.update("jax_enable_compilation_cache", False)
    yield tmp_path / "programs"
    jax.config.update("jax_enable_compilation_cache", True)


class Kind(Enum):
    ONE = 1
    TWO = 2


@dataclass(frozen=True)
class Sizes:
    numbers: tuple[float, ...] = (1.0, 2.0)
    kind: Kind = Kind.ONE
    name: str = field(default="a", repr=False, compare=False)


MADE: list[str] = []


def square(*, factor=2.0, **static):
    MADE.append("square")
    return lambda x: factor * x["a"] ** 2


def cube(*, factor=2.0, **static):
    MADE.append("cube")
    return lambda x: factor * x["a"] ** 3


def sine(x):
    return jnp.sin(x)


def doubled(x):
    return jax.pure_callback(lambda x: 2.0 * x, jax.ShapeDtypeStruct((3,), jnp.float32), x)


def _made(x, function=square, **static):
    """What a new program of a function gives, and whether the function was made anew."""
    before = len(MADE)
    found = building(function)(x, **static)
    return np.asarray(found), len(MADE) > before


X = {"a": np.arange(3.0, dtype=np.float32)}


def test_a_kept_program_is_not_made_again(folder):
    first, made = _made(X)
    np.testing.assert_array_equal(first, 2.0 * X["a"] ** 2)
    again, made_again = _made(X)
    np.testing.assert_array_equal(again, first)
    assert made and not made_again
    (file,) = folder.iterdir()
    assert folder.stat().st_mode & 0o777 == 0o700 and file.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize(
    "change",
    ["function", "static", "shape", "dtype", "structure", "weak", "double", "settings", "flags",
     "context"],
)  # fmt: skip
def test_whatever_a_trace_depends_on_makes_another_program(change, folder, monkeypatch):
    _made(X)
    x, static, context = X, {}, nullcontext()
    function = cube if change == "function" else square
    if change == "static":
        static = {"factor": 3.0}
    elif change == "shape":
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
        context = jax.enable_x64(True)
    elif change == "context":
        context = jax.default_matmul_precision("highest")
    precision = jax.config.jax_default_matmul_precision
    if change == "settings":
        jax.config.update("jax_default_matmul_precision", "highest")
    with context:
        _, made = _made(x, function, **static)
    jax.config.update("jax_default_matmul_precision", precision)
    assert made and len(list(folder.iterdir())) == 2


ALIKE = (
    1, 1.0, True, "1", (1,), None, math.nan, -0.0, 0.0, (1.0, 2.0), ((1.0,), 2.0), Kind.ONE,
    Kind.TWO, Sizes(), Sizes((1.0, 3.0)), Sizes(kind=Kind.TWO), Sizes(name="b"), {"a": 1},
    {"a": 1.0}, np.float32(1.0), np.float64(1.0), np.zeros(2000), np.eye(1, 2000, 1000)[0],
    np.zeros((2000, 1)), square, cube, functools.partial(square, factor=1.0),
    functools.partial(square, factor=2.0), jax.tree.structure({"a": 1}),
    jax.tree.structure({"b": 1}), jax.tree.structure((1, None)), Sizes,
)  # fmt: skip


def test_static_arguments_are_told_apart_whatever_their_repr(folder):
    told = [keys.written(value) for value in ALIKE]
    assert len(set(told)) == len(ALIKE)


def test_a_files_content_is_part_of_its_path(folder, tmp_path):
    path = tmp_path / "model.xml"
    told = [keys.written(path)]
    for content in ("a", "b"):
        path.write_text(content)
        told.append(keys.written(path))
    assert len(set(told)) == 3


class Odd:
    """Its `repr` tells nothing."""

    def __repr__(self):
        return "Odd"


@pytest.mark.parametrize("value", [Odd(), lambda x: x, np.array([Odd()]), (1, Odd()), open])
def test_what_cannot_be_written_out_has_no_key_and_is_not_kept(value, folder):
    if value is open:  # of another package, without a version
        value = os.path.join
    with pytest.raises(keys.UnknownError):
        keys.written(value)
    if not isinstance(value, np.ndarray):  # which is no static argument at all
        assert _made(X, other=value)[1] and _made(X, other=value)[1]
    assert not folder.exists()


def test_functions_that_are_not_the_packages_own_are_not_kept(folder, monkeypatch):
    Program(lambda x: jnp.sin(x))(X["a"])
    assert not folder.exists()
    Program(sine)(X["a"])
    assert len(list(folder.iterdir())) == 1
    monkeypatch.setattr(keys, "PACKAGE", "jaxact")
    Program(sine)(X["a"])
    assert len(list(folder.iterdir())) == 1


def test_nothing_is_kept_of_source_that_changed_while_it_ran(folder, monkeypatch):
    monkeypatch.setattr(keys, "unchanged", lambda: False)
    Program(sine)(X["a"])
    assert not folder.exists()


@pytest.fixture
def compute(tmp_path):
    """Runs it in a process of its own: what it has said, and its result."""

    package = tmp_path / "packages" / "jaxact"
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(Path(jaxact.__file__).parent, package, ignore=ignored)
    (package / "own.py").write_text(MODULE)

    def compute(offset=1.0, **environment):
        out = tmp_path / "out.npy"
        own = {"JAX_NUM_CPU_DEVICES": "2", programs.FOLDER: str(tmp_path / "programs")}
        own["PYTHONPATH"] = str(package.parent)
        ran = subprocess.run(
            [sys.executable, "-c", COMPUTE, str(out), str(offset)],
            capture_output=True, text=True, cwd=tmp_path, env=os.environ | own | environment,
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


@pytest.mark.exhaustive
def test_changed_source_and_static_arguments_make_another_program(compute, tmp_path):
    """Source of any module: a function may call all of it."""
    compute()
    assert compute(offset=2.0)[0] == "traced\n"
    module = tmp_path / "packages" / "jaxact" / "drive" / "delay.py"
    module.write_text(module.read_text() + "# changed\n")
    assert compute()[0] == "traced\n"
    assert compute()[0] == ""
    assert len(list((tmp_path / "programs").iterdir())) == 3


@pytest.mark.exhaustive
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
    _made(X)
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
    for want in (True, False):
        found, made = _made(X)
        np.testing.assert_array_equal(found, 2.0 * X["a"] ** 2)
        assert made is want


def test_what_calls_back_into_the_process_is_not_kept(folder):
    np.testing.assert_array_equal(Program(doubled)(X["a"]), 2.0 * X["a"])
    assert not folder.exists()


def test_without_a_folder_nothing_is_kept(folder, monkeypatch):
    monkeypatch.delenv(programs.FOLDER)
    Program(sine)(X["a"])
    assert not folder.exists()


def _shared(folder, how):
    """Let somebody else write to the folder, or to what is in it."""
    (file,) = folder.iterdir()
    if how == "another's folder":
        return {folder: os.geteuid() + 1}
    if how == "another's file":
        return {file: os.geteuid() + 1}
    if how == "link to a folder":
        folder.rename(folder.with_name("elsewhere"))
        folder.symlink_to(folder.with_name("elsewhere"))
    elif how == "link to a file":
        file.rename(folder.with_name("elsewhere"))
        file.symlink_to(folder.with_name("elsewhere"))
    else:
        where = folder if how.endswith("folder") else file
        where.chmod(where.stat().st_mode | (0o020 if how.startswith("group") else 0o002))
    return {}


@pytest.mark.parametrize(
    "how",
    ["group's folder", "everybody's folder", "another's folder", "link to a folder",
     "group's file", "everybody's file", "another's file", "link to a file"],
)  # fmt: skip
def test_what_others_can_write_to_is_never_opened(how, folder, monkeypatch, recwarn):
    """The file in it is sound, so that only the check keeps it from being run."""
    _made(X)
    owners = _shared(folder, how)
    numbers = {path.stat().st_ino: owner for path, owner in owners.items()}
    status = os.fstat

    def fstat(handle):
        facts = status(handle)
        owner = numbers.get(facts.st_ino, facts.st_uid)
        return os.stat_result((*facts[:4], owner, *facts[5:]))

    monkeypatch.setattr(programs.os, "fstat", fstat)
    loads = []
    monkeypatch.setattr(programs.pickle, "loads", lambda content: loads.append(content))
    np.testing.assert_array_equal(_made(X)[0], 2.0 * X["a"] ** 2)
    assert not loads
    assert _made(X)[1]
    said = [str(one.message) for one in recwarn if "compiling anew" in str(one.message)]
    if "folder" in how:
        assert len(said) == 1 and str(folder) in said[0] and "\n" not in said[0] and not loads
    else:  # it was replaced by one of the user's own, which was opened then
        assert not said and len(loads) == 1


def test_a_folder_that_cannot_be_written_is_no_error(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(programs.FOLDER, str(tmp_path / "file"))
    np.testing.assert_array_equal(_made(X)[0], 2.0 * X["a"] ** 2)


def test_programs_that_were_not_used_for_longest_make_room(folder, monkeypatch):
    for number, name in enumerate("abc"):
        _made(X, name=name)
        newest = max(folder.iterdir(), key=lambda file: file.stat().st_mtime)
        os.utime(newest, (number, number))
    (folder / "somebody's").write_bytes(bytes(10**6))
    os.utime(folder / "somebody's", (0, 0))
    monkeypatch.setattr(
        programs, "MOST", sum(f.stat().st_size for f in folder.glob("*.program")) + 10
    )
    _made(X, name="a")  # is the newest now
    _made(X, name="d")
    assert (folder / "somebody's").exists()
    assert len(list(folder.iterdir())) == 1 + 3
    for name, anew in {"a": False, "c": False, "d": False, "b": True}.items():
        assert _made(X, name=name)[1] == anew, name


@pytest.mark.exhaustive
def test_a_process_lets_go_of_the_programs_that_it_has_not_used_for_longest():
    """Whichever functions they are of; else it runs out of mappings of memory."""
    traced = []

    def counted(factor):
        def function(x):
            traced.append((factor, x.size))
            return factor * x

        return Program(function)

    double, triple = counted(2.0), counted(3.0)
    first = jnp.ones(1)
    for size in range(1, programs.KEPT):
        assert np.all(np.asarray(double(jnp.ones(size))) == 2.0)
        double(first)  # is in use throughout
    for size in (1, 2, 3):
        assert np.all(np.asarray(triple(jnp.ones(size))) == 3.0)
    assert len(set(traced)) == len(traced) == programs.KEPT + 2
    double(first)
    double(jnp.ones(programs.KEPT - 1))
    assert len(traced) == programs.KEPT + 2
    double(jnp.ones(2))
    assert traced[-1] == (2.0, 2)
    programs.let_go()
    double(first)
    assert traced[-1] == (2.0, 1)
