"""What a sweep's cuts and precision change, of kernels as users have them: no bit, and little."""

import jax
import numpy as np
import pytest
from noisy_sweep import NOISY, run
from quickly import optimised_fully

from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.simulation import execute, plans
from jaxact.status import Verdict


@pytest.fixture(scope="module", autouse=True)
def compiled_fully():
    """Once for the module, whose tests run some of the same programs."""
    with optimised_fully():
        yield


def _same(a, b):
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


@pytest.fixture(scope="module")
def noisy():
    return run(NOISY)


@pytest.mark.exhaustive
def test_one_or_two_devices_give_the_same_bits(noisy):
    assert len(jax.local_devices()) == 2
    _same(noisy, run(NOISY, "devices=1"))


@pytest.mark.exhaustive
def test_a_sample_does_not_depend_on_its_neighbours(noisy):
    """Every third sample alone, at other places of other tiles, keyed by number."""
    asked = reading.parse(NOISY)
    samples = expand(asked)
    for first in range(3):
        numbers = np.arange(first, len(samples), 3)
        groups = plans.groups(asked, samples, together=numbers.size)
        for name, row in execute.compute(groups, asked, samples, numbers).items():
            np.testing.assert_array_equal(row, noisy[name][numbers], err_msg=name)


@pytest.mark.exhaustive
def test_other_tiles_give_the_same_figures(noisy):
    other = run(NOISY, "tile=8")
    np.testing.assert_allclose(other["growth_rate"], noisy["growth_rate"], atol=1e-6)
    assert np.mean(other["verdict"] == noisy["verdict"]) > 0.97
    calm = noisy["verdict"] == Verdict.STABLE
    for name in ("rms_force", "integrated_absolute_error"):
        np.testing.assert_allclose(other[name][calm], noisy[name][calm], rtol=1e-2)


@pytest.mark.exhaustive
def test_double_precision_changes_little():
    double = run(NOISY, "precision=float64", "position_noise=0", "position_resolution=0")
    single = run(NOISY, "position_noise=0", "position_resolution=0")
    assert double["rms_force"].dtype == np.float64
    calm = (single["verdict"] == Verdict.STABLE) & (double["verdict"] == Verdict.STABLE)
    assert calm.sum() > 20
    np.testing.assert_allclose(single["rms_force"][calm], double["rms_force"][calm], rtol=1e-3)


@pytest.mark.exhaustive
def test_progress_counts_every_sample_once():
    asked = reading.parse(NOISY)
    calls = []
    samples = expand(asked)
    execute.run(asked, samples, progress=lambda done, total: calls.append((done, total)))
    assert calls[-1] == (90, 90)
    assert [done for done, _ in calls] == sorted({done for done, _ in calls})
