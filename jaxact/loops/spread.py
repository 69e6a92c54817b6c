"""What is known of several numbers together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

_MOST_TRIES = 50


@dataclass(frozen=True)
class Spread:
    """What is known of some numbers together: a normal distribution within bounds.

    Attributes:
        names: of the numbers.
        logarithms: whether each is distributed as its logarithm.
        low, high: bounds of each.
        rows: covariance of the numbers or their logarithms, shape (numbers, numbers).
    """

    names: tuple[str, ...]
    logarithms: tuple[bool, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    rows: tuple[tuple[float, ...], ...]

    def draw(self, centre: Mapping[str, float], number: int, seed: int) -> dict[str, np.ndarray]:
        """Draws around a centre, those out of bounds drawn anew, shape (number,) each."""
        import numpy as np  # which options of the command line do without

        def inner(values: Any) -> np.ndarray:
            values = np.asarray(values, float)
            logs = np.log(np.where(self.logarithms, np.maximum(values, 1e-300), 1.0))
            return np.where(self.logarithms, logs, values)

        middle = inner([centre[name] for name in self.names])
        low, high = inner(self.low), inner(self.high)
        covariance = np.array(self.rows).reshape((len(self.names),) * 2)
        values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
        spread = vectors * np.sqrt(np.maximum(values, 0.0))
        generator = np.random.default_rng(seed)
        kept = np.empty((0, len(middle)))
        for _ in range(_MOST_TRIES):
            points = middle + generator.standard_normal((number, len(middle))) @ spread.T
            inside = np.all((points >= low) & (points <= high), axis=1)
            kept = np.concatenate([kept, points[inside]])
            if len(kept) >= number:
                break
        else:
            # So wide that most draws leave the range: kept within it instead.
            kept = np.concatenate([kept, np.clip(points, low, high)])
        drawn = kept[:number]
        each = np.where(self.logarithms, np.exp(np.where(self.logarithms, drawn, 0.0)), drawn)
        return dict(zip(self.names, each.T, strict=True))
