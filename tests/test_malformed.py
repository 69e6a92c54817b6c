"""A thousand specifications that are wrong in random ways, through the command line."""

import contextlib
import copy
import functools
import io
import math
from pathlib import Path

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from jaxact.cli import _options
from jaxact.cli.main import main
from jaxact.cli.sweep import Run
from jaxact.errors import UserError
from jaxact.loops import reading, toml

GOOD = {
    "description": "a test",
    "engine": "mass",
    "duration": 2.0,
    "precision": "float32",
    "seed": 0,
    "parameters": {"mass": 0.7, "kp": 400.0, "actuator": "hyq"},
    "axes": {
        "delay": [0.0, 0.001],
        "kp": {"min": 10, "max": 1e5, "num": 5, "spacing": "log"},
        "kd": {"min": 0.5, "max": 2.0, "num": 4},
    },
}
_ABSURD = st.sampled_from(
    [math.nan, math.inf, -math.inf, 1e300, -1e300, 1e-300, 10**30, -1, 0, 2**63, 10**9, 1e12]
)
_WRONG = st.one_of(
    _ABSURD,
    st.text(max_size=30),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.just(""),
    st.just([]),
    st.just({}),
    st.lists(st.one_of(st.text(max_size=5), _ABSURD, st.floats()), max_size=5),
    st.dictionaries(st.text(max_size=8), st.one_of(_ABSURD, st.text(max_size=5)), max_size=3),
    st.fixed_dictionaries(
        {"min": _ABSURD, "max": _ABSURD, "num": st.one_of(_ABSURD, st.integers(2, 10**9))}
    ),
)
_KEYS = st.one_of(
    st.sampled_from(
        ["engine", "model", "duration", "seed", "axes", "parameters", "sampling", "plant", "tile",
         "kp", "kd", "wn", "zeta", "delay", "mass", "actuator", "min", "max", "num", "spacing",
         "physics_step", "control_rate", "devices", "precision", "method", "samples", "motion"]
    ),
    st.text(max_size=12),
)  # fmt: skip


@st.composite
def _specifications(draw):
    """A good document in which one to four things are changed."""
    document = copy.deepcopy(GOOD)
    for _ in range(draw(st.integers(1, 4))):
        table = document
        while draw(st.booleans()):
            inner = [key for key, value in table.items() if isinstance(value, dict)]
            if not inner:
                break
            table = table[draw(st.sampled_from(sorted(inner)))]
        known = st.sampled_from(sorted(table)) if table else _KEYS
        table[draw(st.one_of(known, _KEYS))] = copy.deepcopy(draw(_WRONG))
    return toml.dumps(document)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the same options are given a thousand times, and are not read anew each time."""

    def read(verb, _, arguments):
        specification, out, folder = arguments
        assert out == "--out"
        return functools.partial(verb, Path(specification), Run(), out=folder)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(_options, "read", read)
        yield tmp_path_factory.mktemp("malformed")


def _told(folder, content):
    (folder / "sweep.toml").write_bytes(content)
    said, shown = io.StringIO(), io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(shown):
        code = main(["sweep", str(folder / "sweep.toml"), "--out", str(folder / "out")])
    assert code == 2, "a traceback, or it was taken for a good one"
    assert shown.getvalue() == ""
    message = said.getvalue()
    assert message.startswith("jaxact: ") and message.count("\n") == 1
    assert message.rstrip("\n").isprintable()
    assert [item.name for item in folder.iterdir()] == ["sweep.toml"]


@pytest.mark.exhaustive
@settings(max_examples=1000)
@given(text=_specifications())
def test_a_malformed_specification_is_one_line_and_exit_code_2(text, folder):
    try:
        reading.parse(text, folder)
    except UserError:
        pass
    else:
        assume(False)
    _told(folder, text.encode())


@settings(max_examples=200)
@given(content=st.binary(max_size=200))
def test_so_is_a_file_of_random_bytes(content, folder):
    with contextlib.suppress(UnicodeDecodeError):
        try:
            reading.parse(content.decode())
        except UserError:
            pass
        else:
            assume(False)
    _told(folder, content)
