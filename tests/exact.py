"""The sampled loop as a matrix, computed with SciPy alone: the tests' independent reference.

State: position, velocity, force, force rate, then the commands still on their way, then what a
differenced velocity remembers. One control period, zero-order hold, exact for any real delay.
"""

import numpy as np
import scipy.linalg


def _held(A, B, time):
    """Zero-order-hold discretisation of x' = A x + B u."""
    size = A.shape[0]
    augmented = np.zeros((size + 1, size + 1))
    augmented[:size, :size] = A
    augmented[:size, size] = B
    result = scipy.linalg.expm(augmented * time)
    return result[:size, :size], result[:size, size]


def _continuous(mass, wn, zeta):
    if np.isinf(wn):
        return np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([0.0, 1.0 / mass])
    A = np.zeros((4, 4))
    A[0, 1], A[1, 2], A[2, 3] = 1.0, 1.0 / mass, 1.0
    A[3, 2], A[3, 3] = -(wn**2), -2.0 * zeta * wn
    return A, np.array([0.0, 0.0, 0.0, wn**2])


def one_period(kp, kd, mass, wn, zeta, delay, period=1e-3, differenced=False, cutoff=np.inf):
    """Matrices of one control period for arrays of gains, shape (gains, n, n)."""
    kp, kd = np.ravel(kp), np.ravel(kd)
    whole = int(np.floor(delay / period + 1e-9))
    rest = max(delay - whole * period, 0.0)
    A, B = _continuous(mass, wn, zeta)
    n = A.shape[0]
    first, older = _held(A, B, rest)
    second, newer = _held(A, B, period - rest)
    older = second @ older
    commands = whole + 1
    size = n + commands + (2 if differenced else 0)
    matrix = np.zeros((kp.size, size, size))
    matrix[:, :n, :n] = second @ first
    command = np.zeros((kp.size, size))
    command[:, 0] = -kp
    if differenced:
        # measured velocity: v + g ((q - q_before) / T - v), of which q_before and v are states
        gain = 1.0 if np.isinf(cutoff) else -np.expm1(-cutoff * period)
        velocity = np.zeros(size)
        velocity[0], velocity[-2], velocity[-1] = gain / period, -gain / period, 1.0 - gain
        command += -kd[:, None] * velocity
        matrix[:, -2, 0] = 1.0
        matrix[:, -1, :] = velocity
    else:
        command[:, 1] = -kd
    for response, age in ((newer, whole), (older, whole + 1)):
        if age == 0:
            matrix[:, :n, :] += response[None, :, None] * command[:, None, :]
        else:
            matrix[:, :n, n + age - 1] += response
    matrix[:, n, :] = command
    for age in range(1, commands):
        matrix[:, n + age, n + age - 1] = 1.0
    return matrix


def growth_rate(*args, period=1e-3, **kwargs):
    """log(spectral radius) / T [1/s] for arrays of gains."""
    matrix = one_period(*args, period=period, **kwargs)
    return np.log(np.abs(np.linalg.eigvals(matrix)).max(axis=-1)) / period
