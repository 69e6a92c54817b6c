"""For tests that compile much and compute little: the compiler optimises little."""

from contextlib import contextmanager

import jax
import pytest

# The same for a program of its own.
ENVIRONMENT = {"JAX_DISABLE_MOST_OPTIMIZATIONS": "1"}


@contextmanager
def optimised_little():
    """What is compiled meanwhile is compiled quickly, and runs slowly."""
    jax.config.update("jax_disable_most_optimizations", True)
    try:
        yield
    finally:
        jax.config.update("jax_disable_most_optimizations", False)


@pytest.fixture(scope="module", autouse=True)
def compiled_quickly():
    """The same while the tests of a module run that imports it."""
    with optimised_little():
        yield
