"""Sensitivities of loops that differ in their gains only, from one frequency response.

The loop with some reference gains K0 = (kp0, kd0), of which C measures positions and velocities:

    x' = M0 x + N d,     H(z) = C (z I - M0)^-1 N

With other gains K the commands are u = d - K C x, so that

    S(z) = I - K H (I + (K - K0) H)^-1

H is evaluated once on a grid for all gains; what is left is a small system at each frequency.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from jaxact.analysis.robot import multiloop as _multiloop
from jaxact.analysis.robot.multiloop import Matrices, Multiloop

# Differences of matrices that are the same but for rounding, as a share of their largest entry.
_ROUNDING = 1e-9
Delayed = Callable[[float], tuple[np.ndarray, np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class SharedResponse:
    """What loops with different gains share; m joints, n states.

    Attributes:
        loop: with the reference gains; its 2 m outputs are the measured positions and velocities.
        kp, kd: the reference gains, shape (m,) each.
        opened: the matrix without controllers, M0 - N C0, shape (n, n).
        inputs: N, shape (n, m).
        measured: positions and velocities as the controllers measure them, shape (2, m, n).
        roots: of `opened` without states that nothing moves or that move nothing.
        angle: grid of w T that all of them use [rad], rising, shape (k,).
        response: H there, shape (k, 2, m, m).
        delayed: extra delay of all commands [s] -> `opened` and `inputs` with it, and the places of
            the states in them; those that nothing moves, or that move nothing, are left out.
    """

    loop: Multiloop
    kp: np.ndarray
    kd: np.ndarray
    opened: np.ndarray
    inputs: np.ndarray
    measured: np.ndarray
    roots: np.ndarray
    angle: np.ndarray
    response: np.ndarray
    delayed: Delayed

    def later_by(self, C: np.ndarray) -> Callable[[float], Matrices]:
        """Extra delay of all commands [s] -> M, N, C of the loop whose controllers are C.

        States that nothing moves, or that move nothing, are left out.
        """

        def matrices(extra: float) -> Matrices:
            opened, inputs, kept = self.delayed(extra)
            own = C[:, kept]
            return opened + inputs @ own, inputs, own

        return matrices

    def holds(self, matrices: Matrices, kp: np.ndarray, kd: np.ndarray) -> bool:
        """Whether a loop differs from these in its gains only, but for rounding."""
        M, N, C = matrices
        own = -(kp[:, None] * self.measured[0] + kd[:, None] * self.measured[1])
        pairs = ((N, self.inputs), (C, own), (M - N @ C, self.opened))
        return all(
            a.shape == b.shape and np.abs(a - b).max() <= _ROUNDING * np.abs(b).max(initial=1e-300)
            for a, b in pairs
        )

    def respond(self, angle: np.ndarray) -> np.ndarray:
        """H at w T [rad], shape (k, 2, m, m)."""
        joints = len(self.kp)
        return _multiloop.response(self.loop, angle).reshape(-1, 2, joints, joints)

    def sensitivity(
        self, kp: np.ndarray, kd: np.ndarray, angle: np.ndarray, response: np.ndarray | None = None
    ) -> np.ndarray:
        """S at w T [rad], shape (k, m, m).

        Args:
            kp, kd: gains, shape (m,), or of each frequency, shape (k, m).
            angle: shape (k,).
            response: H there, where it is known.
        """
        H = self.respond(angle) if response is None else response
        kp, kd = np.asarray(kp), np.asarray(kd)
        returned = kp[..., None] * H[:, 0] + kd[..., None] * H[:, 1]
        changed = (kp - self.kp)[..., None] * H[:, 0] + (kd - self.kd)[..., None] * H[:, 1]
        unit = np.eye(len(self.kp))
        return unit - returned @ np.linalg.inv(unit + changed)

    def grid(self, roots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angles w T [rad] dense around all roots of a loop and of the open one, and H there.

        Args:
            roots: of the loop.
        """
        lowest = _multiloop.lowest(np.concatenate([roots, self.roots]))
        points = [_multiloop.around(roots)]
        if lowest < self.angle[1]:
            decades = math.log10(self.angle[1] / lowest)
            count = max(2, round(_multiloop.PER_DECADE * decades))
            points.append(np.geomspace(lowest, self.angle[1], count))
        own = np.concatenate(points)
        own = own[(own >= lowest) & (own < math.pi)]
        angle = np.concatenate([self.angle, own])
        response = np.concatenate([self.response, self.respond(own)])
        order = np.argsort(angle, kind="stable")
        apart = _multiloop.apart(angle[order])
        order = order[apart]
        return angle[order], response[order]


def shared_response(
    first: Matrices,
    second: Matrices,
    gains: np.ndarray,
    reference: np.ndarray,
    period: float,
    delayed: Callable[[float], tuple[np.ndarray, np.ndarray]],
) -> SharedResponse:
    """What all loops of a robot share that differ in their gains only.

    Args:
        first, second: M, N, C of the robot with two settings of its gains.
        gains: kp and kd of both, shape (2 settings, 2, m), linearly independent of each joint.
        reference: kp and kd of the loop that H is of, shape (2, m).
        period: T [s].
        delayed: extra delay of all commands [s] -> M - N C and N with it, of all states.
    """
    (M, N, C), (_, _, other) = first, second
    opened = M - N @ C
    # Each joint's row of -C is kp times its position and kd times its velocity, twice.
    rows = -np.stack([C, other], axis=1)
    measured = np.linalg.solve(gains.transpose(2, 0, 1), rows).transpose(1, 0, 2)
    kp, kd = reference
    M0 = opened - N @ (kp[:, None] * measured[0] + kd[:, None] * measured[1])
    joints = len(kp)
    outputs = np.concatenate(list(measured))
    loop = _multiloop.decomposed(M0, N, outputs, period)
    kept = np.ix_(loop.kept, loop.kept)
    roots = scipy.linalg.eigvals(opened[kept])
    own = np.concatenate([loop.roots, roots])
    empty = np.zeros((0, 2, joints, joints), complex)

    # Of all parts of a period that every loop tries, and of a Newton's method that is under way.
    @functools.lru_cache(maxsize=64)
    def reduced(extra: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        A, B = delayed(extra)
        # Of any gains.
        closed = np.abs(A) + np.abs(B) @ np.abs(measured).sum(axis=0)
        places = _multiloop.joined((closed, B, outputs))
        return A[np.ix_(places, places)], B[places], places

    shared = SharedResponse(loop, kp, kd, opened, N, measured, roots, np.zeros(0), empty, reduced)
    angle = _multiloop.grid_of(roots, _multiloop.lowest(own))
    return replace(shared, angle=angle, response=shared.respond(angle))
