"""What is known of a robot's free base that stands on the ground."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Base:
    """A free base that stands.

    Attributes:
        place: of its position among those of a configuration, three numbers, and of its
            orientation w, x, y, z after them.
        height: of the centre of mass over the lowest contact [m]; infinite if it is not above it.
        up: against gravity, of length 1.
    """

    place: int
    height: float
    up: tuple[float, ...]
