"""Growth rates and verdicts of random linear loops, against SciPy.

    python tools/growth_campaign.py --loops 100000 --seed 1

Loops are drawn from the whole range of the parameters: delays up to 1,000 control periods, split
over the three places where a loop can have them; positive, negative and tiny gains; masses of 1e-9
to 1e9 kg; natural frequencies from a thousandth of the control rate's to far above it, and none;
damping ratios of 1e-4 to 10; control rates of 50 Hz to 10 kHz; sampled and differenced velocity,
float32 and float64. Each is swept by the engine `mass`, and compared with the largest eigenvalue of
the sampled loop's matrix, which is made here from `scipy.linalg.expm` alone.

What is computed is the matrix less the identity: the eigenvalues of a slow actuator at a high
control rate lie so close to 1 that rounding of the matrix itself would spread them.

Counted are wrong verdicts where |growth rate| T > 1e-4, growth rates that are off by more than
1 % + 0.02 1/s, loops that were not resolved (no growth rate, verdict `invalid`), and metrics that
are not numbers beside a stable verdict. The exit code is 1 if there is anything but unresolved
loops. 100,000 loops take about an hour on one core, nearly all of it for the eigenvalues.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np
import scipy.linalg

from jaxact.loops import reading
from jaxact.loops.samples import explicit
from jaxact.simulation import execute

LONGEST = 1000  # control periods
FASTEST = 10_000.0  # [Hz]
PIECE = 1000  # loops computed together
ALWAYS_KNOWN = (
    "integrated_absolute_error",
    "integrated_squared_error",
    "control_effort",
    "peak_force",
    "rms_force",
    "overshoot",
    "limit_cycle_amplitude",
)  # metrics that every loop has which was simulated to its end
# Share of the loops, and shortest and longest delay, in control periods.
_DELAYS = ((0.3, 0.05, 3.0), (0.5, 3.0, 40.0), (0.17, 40.0, 150.0), (0.03, 150.0, LONGEST))

Columns = dict[str, np.ndarray]


def draw(count: int, seed: int) -> Columns:
    """Parameters of random loops by their short names, each of shape (count,)."""
    rng = np.random.default_rng(seed)

    def log(low: float | np.ndarray, high: float | np.ndarray) -> np.ndarray:
        return np.exp(rng.uniform(np.log(low), np.log(high), count))

    def some(share: float, yes: np.ndarray | float, no: np.ndarray | float) -> np.ndarray:
        return np.where(rng.random(count) < share, yes, no)

    period = 1.0 / log(50.0, FASTEST)
    period[0] = 1.0 / FASTEST
    kind = rng.choice(len(_DELAYS), count, p=[share for share, _, _ in _DELAYS])
    _, shortest, longest = np.array(_DELAYS)[kind].T
    periods = log(shortest, longest)
    periods = some(0.3, np.round(periods), periods)
    places = rng.dirichlet([1.0, 1.0, 1.0], count)
    places[rng.random(count) < 0.4] = [1.0, 0.0, 0.0]
    # So that every piece has lines of the same length, and shares compiled programs.
    periods[:2] = LONGEST
    places[0], places[1] = [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]
    wn = some(0.6, log(1e-2, 30.0) / period, log(1e-3, 1e9))
    wn = some(0.2, np.inf, wn)
    zeta = log(1e-4, 10.0)
    mass = log(1e-9, 1e9)
    # Gains that suit the loop's whole lag, or its control period alone.
    lag = np.minimum(periods + 1.0 + 2.0 * zeta / (wn * period), 1e4)
    unit = some(0.7, lag, 1.0) * period
    sign = some(0.15, -1.0, 1.0), some(0.15, -1.0, 1.0)
    return {
        "kp": np.clip(sign[0] * log(1e-6, 10.0) * mass / unit**2, -1e9, 1e9),
        "kd": np.clip(sign[1] * log(1e-4, 10.0) * mass / unit, -1e9, 1e9),
        "mass": mass,
        "wn": wn,
        "zeta": zeta,
        "delay": periods * period * places[:, 0],
        "measurement_delay": periods * period * places[:, 1],
        "output_delay": periods * period * places[:, 2],
        "control_rate": 1.0 / period,
        "velocity_filter": np.clip(some(0.3, np.inf, log(0.03, 30.0) / period), 1e-3, None),
    }


class Referee:
    """The sampled loop of one joint, in units of its control period and mass.

    Physics is x' = A x + B u, with the force servo between command u and the mass; over a period of
    length 1 the command changes from the older to the newer one at the delay's remainder.
    """

    def __init__(self, loop: dict[str, float], differenced: bool) -> None:
        """Hold and delay; `loop` has the parameters by their short names."""
        period = 1.0 / loop["control_rate"]
        total = loop["delay"] + loop["measurement_delay"] + loop["output_delay"]
        self.steps = int(np.floor(total / period + 1e-9))
        self.rest = min(max(total / period - self.steps, 0.0), 1.0)
        self.period, self.differenced = period, differenced
        self.kp = loop["kp"] * period**2 / loop["mass"]
        self.kd = loop["kd"] * period / loop["mass"]
        cutoff = loop["velocity_filter"]
        self.gain = 1.0 if np.isinf(cutoff) else float(-np.expm1(-cutoff * period))
        x, zeta = loop["wn"] * period, loop["zeta"]
        if np.isinf(x):
            self.A, self.B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([0.0, 1.0])
        else:
            self.A = np.zeros((4, 4))
            self.A[0, 1] = self.A[1, 2] = 1.0
            self.A[2, 3], self.A[3, 2], self.A[3, 3] = x, -x, -2.0 * zeta * x
            self.B = np.array([0.0, 0.0, 0.0, x])

    def _hold(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """exp(A t) - I and the response to a command held for t, without cancellation.

        exp(A t) - I = A F with F the integral of exp(A s) from 0 to t, which is a block of the
        exponential of [[A, I], [0, 0]] t.
        """
        size = len(self.B)
        whole = np.zeros((2 * size, 2 * size))
        whole[:size, :size], whole[:size, size:] = self.A, np.eye(size)
        integral = scipy.linalg.expm(whole * time)[:size, size:]
        return self.A @ integral, integral @ self.B

    def change(self) -> np.ndarray:
        """The closed loop over one period, less the identity.

        State: x, the commands on their way, and where the velocity is differenced the position and
        velocity before.
        """
        n, d = len(self.B), self.steps
        (first, older), (second, newer) = self._hold(self.rest), self._hold(1.0 - self.rest)
        older = second @ older + older
        closed = np.zeros((n + d + 1 + 2 * self.differenced,) * 2)
        closed[:n, :n] = second @ first + second + first
        np.fill_diagonal(closed[n:, n:], -1.0)
        command = np.zeros(len(closed))
        command[0] = -self.kp
        if self.differenced:
            velocity = np.zeros(len(closed))
            velocity[[0, -2, -1]] = self.gain, -self.gain, 1.0 - self.gain
            closed[-2, 0] += 1.0
            closed[-1, [0, -2]] += self.gain, -self.gain
            closed[-1, -1] = -self.gain
            command -= self.kd * velocity
        else:
            command[1] = -self.kd
        closed[:n, n + d] += older
        if d:
            closed[:n, n + d - 1] += newer
        else:
            closed[:n] += np.outer(newer, command)
        closed[n] += command
        closed[np.arange(n + 1, n + d + 1), np.arange(n, n + d)] += 1.0
        return closed

    def growth_rate(self) -> float:
        """Logarithm of the largest eigenvalue's size over the period [1/s]."""
        w = np.linalg.eigvals(self.change())
        square = np.maximum(w.real * (2.0 + w.real) + w.imag**2, np.finfo(float).eps - 1.0)
        return float(0.5 * np.log1p(square).max()) / self.period


def swept(columns: Columns, *, differenced: bool, precision: str) -> dict[str, np.ndarray]:
    """What a sweep of these loops finds."""
    specification = reading.parse(
        f'engine = "mass"\nduration = 0.25\nprecision = "{precision}"\n'
        f'velocity = "{"differenced" if differenced else "sampled"}"\n[axes]\nkp = [1.0]\n'
    )
    return execute.run(specification, explicit(specification, columns))


def judge(columns: Columns, found: dict[str, np.ndarray], *, differenced: bool) -> dict[str, float]:
    """Number of each kind of failure, and the largest error of a growth rate."""
    growth, verdict = found["growth_rate"], found["verdict"]
    period = 1.0 / columns["control_rate"]
    exact = np.zeros(growth.size)
    for number in range(growth.size):
        loop = {name: float(column[number]) for name, column in columns.items()}
        exact[number] = Referee(loop, differenced).growth_rate()
    known = ~np.isnan(growth)
    decided = known & (np.abs(exact) * period > 1e-4) & (verdict != 3)
    error = np.abs(growth - exact)[known]
    allowed = 0.01 * np.abs(exact[known]) + 0.02
    stable = verdict == 0
    lost = np.zeros(growth.size, bool)
    for name in ALWAYS_KNOWN:
        lost |= stable & np.isnan(found[name])
    for number in np.flatnonzero(known)[error > allowed][:5]:
        loop = {name: float(column[number]) for name, column in columns.items()}
        print(f"growth rate {growth[number]:g}, exact {exact[number]:g} 1/s: {loop}")
    return {
        "loops": growth.size,
        "stable": int(stable.sum()),
        "wrong verdicts": int((decided & ((verdict == 0) != (exact < 0.0))).sum()),
        "wrong growth rates": int((error > allowed).sum()),
        "worst error / allowed": float(np.max(error / allowed, initial=0.0)),
        "not resolved": int((~known).sum()),
        "resolved, but not simulated": int((known & (verdict == 3)).sum()),
        "NaN beside stable": int(lost.sum()),
    }


def run(loops: int, seed: int) -> dict[str, float]:
    """The campaign in pieces; prints the sums so far, and returns them."""
    total: dict[str, float] = {}
    kinds = [(d, p) for d in (False, True) for p in ("float32", "float64")]
    for piece, first in enumerate(range(0, loops, PIECE)):
        differenced, precision = kinds[piece % len(kinds)]
        columns = draw(min(PIECE, loops - first), seed + piece)
        found = swept(columns, differenced=differenced, precision=precision)
        for name, value in judge(columns, found, differenced=differenced).items():
            both = total.get(name, 0.0), value
            total[name] = max(both) if name.startswith("worst") else sum(both)
        print("; ".join(f"{name} {value:.6g}" for name, value in total.items()), flush=True)
    return total


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code of the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--loops", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    total = run(options.loops, options.seed)
    failures = ("wrong verdicts", "wrong growth rates", "NaN beside stable")
    return int(any(total[name] for name in failures))


if __name__ == "__main__":
    sys.exit(main())
