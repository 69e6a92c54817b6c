"""For tests that compile much and compute little: the compiler optimises little."""

from contextlib import contextmanager
from importlib.metadata import version

import jax
import pytest

# JAX 0.10 can still write kernels as it once did, in half the time. For a whole process or not.
XLA_FLAGS = "--xla_cpu_use_fusion_emitters=false" if version("jax").startswith("0.10.") else ""

# The same for a program of its own.
ENVIRONMENT = {"JAX_DISABLE_MOST_OPTIMIZATIONS": "1", "XLA_FLAGS": XLA_FLAGS}


@contextmanager
def optimised_little():
    """What is compiled meanwhile is compiled quickly, and runs slowly."""
    with _optimisations(disabled=True):
        yield


@contextmanager
def optimised_fully():
    """What is compiled meanwhile is compiled as users have it, in a module that does not else."""
    with _optimisations(disabled=False):
        yield


@contextmanager
def _optimisations(*, disabled):
    name = "jax_disable_most_optimizations"
    before = jax.config.values[name]
    jax.config.update(name, disabled)
    try:
        yield
    finally:
        jax.config.update(name, before)


@pytest.fixture(scope="module", autouse=True)
def compiled_quickly():
    """The same while the tests of a module run that imports it."""
    with optimised_little():
        yield
