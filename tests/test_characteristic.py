"""Characteristic polynomials and spectral radii of small matrices, against NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from quickly import compiled_quickly as compiled_quickly

from jaxact.simulation.growth import characteristic


def _rows(matrix):
    return [list(row) for row in matrix]


@pytest.mark.parametrize("size", [1, 2, 5, 10])
def test_polynomial(size):
    rng = np.random.default_rng(size)
    matrices = np.stack([scipy.linalg.hessenberg(rng.normal(size=(size,) * 2)) for _ in range(20)])
    with jax.enable_x64(True):
        got = jax.jit(jax.vmap(lambda m: characteristic.polynomial(_rows(m))))(matrices)
    want = np.stack([np.poly(matrix)[1:] for matrix in matrices], axis=-1)
    np.testing.assert_allclose(np.asarray(got), want, rtol=1e-9, atol=1e-9)


# Within log(4) / 2^18; and m roots of one modulus are only as sharp as the m-th root of rounding.
@pytest.mark.parametrize(
    ("double", "tolerance", "thrice"), [(True, 6e-6, 6e-6), (False, 5e-4, 4e-3)]
)
def test_log_spectral_radius_of_awkward_matrices(double, tolerance, thrice):
    rng = np.random.default_rng(0)
    matrices = [scipy.linalg.hessenberg(rng.normal(size=(4, 4))) for _ in range(500)]
    matrices += [1e-9 * matrices[0], 1e9 * matrices[1]]
    matrices.append(np.array([[1.0, 1.0, 0, 0], [0, 1.0, 0, 0], [0, 0, 0.5, 9.0], [0, 0, 0, 0.1]]))
    matrices.append(np.diag([0.9, -0.9, 0.9, 1e-9]))
    want = np.log([np.abs(np.linalg.eigvals(matrix)).max() for matrix in matrices])
    with jax.enable_x64(double):
        radius = jax.jit(jax.vmap(lambda m: characteristic.log_spectral_radius(_rows(m), 18)))
        got = np.asarray(radius(jnp.asarray(np.stack(matrices))))
        np.testing.assert_allclose(got[:-1], want[:-1], rtol=tolerance, atol=tolerance)
        np.testing.assert_allclose(got[-1], want[-1], atol=thrice)
        nothing = radius(jnp.zeros((1, 4, 4)).at[0, 0, 1].set(1.0))
        assert np.isneginf(nothing[0])


def test_clustered_and_vanishing_roots():
    """Many modes close to 1 beside many that are gone: what sampled loops look like."""
    roots = [np.r_[1.0 - 1e-3 * np.arange(1, 4), 1e-3 * np.arange(7)], np.r_[1.0001, np.zeros(9)]]
    with jax.enable_x64(True):
        for each in roots:
            coefficients = [jnp.asarray(c) for c in np.poly(each)[1:]]
            got = characteristic.log_largest_root(coefficients, 24)
            assert abs(got - np.log(np.max(each))) < 1e-7


def test_of_one_or_two_largest_roots_the_size_is_sharp():
    """Far below log(n) / 2^18, which is as much as 4e-3/s of a loop at 1 kHz."""
    rng = np.random.default_rng(1)
    angles, sizes = rng.uniform(0.0, np.pi, 200), rng.uniform(0.9, 1.1, 200)
    pairs = [[r * np.exp(1j * a), r * np.exp(-1j * a)] for r, a in zip(sizes, angles, strict=True)]
    pairs += [[r, -r] for r in sizes[:5]] + [[-r, 0.99 * r] for r in sizes[:5]]
    coefficients = np.stack([np.poly([*two, 0.8, -0.3]).real[1:] for two in pairs])
    with jax.enable_x64(True):
        got = jax.jit(jax.vmap(lambda c: characteristic.log_largest_root([*c], 18)))(coefficients)
    want = np.log([abs(two[0]) for two in pairs])
    # r and -r are a double root once squared, known to the root of rounding.
    np.testing.assert_allclose(got[:200], want[:200], rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(got, want, rtol=0.0, atol=2e-8)
