"""For tests that compile much and compute little: the compiler optimises little."""

import sys
from contextlib import contextmanager
from importlib.metadata import version

import jax
import pytest
from jax._src import compiler

from jaxact.compilation import programs

# JAX 0.10 can still write kernels as it once did, which takes half the time.
_OLD_KERNELS = {"xla_cpu_use_fusion_emitters": False} if version("jax").startswith("0.10.") else {}

_AS_USERS_HAVE_THEM = compiler.get_compile_options

# Little optimised: the same for a program of its own.
ENVIRONMENT = {
    "JAX_DISABLE_MOST_OPTIMIZATIONS": "1",
    "XLA_FLAGS": " ".join(f"--{name}={value}".lower() for name, value in _OLD_KERNELS.items()),
}


@contextmanager
def optimised_little():
    """What is compiled meanwhile is compiled quickly, and runs slowly."""
    with _optimisations(disabled=True):
        yield


@contextmanager
def optimised_fully():
    """What is compiled meanwhile is compiled as users have it, in a module that does not else."""
    # What tests before compiled quickly is not what users have, nor what it found.
    programs.let_go()
    jax.clear_caches()
    _forget()
    with _optimisations(disabled=False):
        yield


def _forget():
    """Clear what jaxact's functions remember: numbers of kernels, in their last bits, among it."""
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] == "jaxact":
            for thing in vars(module).values():
                if hasattr(thing, "cache_clear"):
                    thing.cache_clear()


@contextmanager
def _optimisations(*, disabled):
    name = "jax_disable_most_optimizations"
    before = jax.config.values[name]
    jax.config.update(name, disabled)
    try:
        with pytest.MonkeyPatch.context() as patched:
            if _OLD_KERNELS:  # which no setting of JAX asks for
                options = _with_old_kernels if disabled else _AS_USERS_HAVE_THEM
                patched.setattr(compiler, "get_compile_options", options)
            yield
    finally:
        jax.config.update(name, before)


def _with_old_kernels(*arguments, env_options_overrides=None, **named):
    overrides = _OLD_KERNELS | (env_options_overrides or {})
    return _AS_USERS_HAVE_THEM(*arguments, env_options_overrides=overrides, **named)


@pytest.fixture(scope="module", autouse=True)
def compiled_quickly():
    """The same while the tests of a module run that imports it."""
    with optimised_little():
        yield


@pytest.fixture
def compiled_fully():
    """In a module that imports both, for a test of what rounding of the user's kernels decides."""
    with optimised_fully():
        yield
