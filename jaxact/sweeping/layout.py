"""How a sweep is cut into chunks: the unit in which results are computed, written and resumed.

A chunk is a block of the grid that is a run of consecutive samples in C order, so that it is one
file of every variable in the store, and one range of sample numbers.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import google_crc32c
import numpy as np

# Zarr's codecs of every result: little-endian numbers, then four bytes of checksum.
_CHECKSUM = struct.Struct("<I")


class DamagedError(Exception):
    """A chunk whose bytes are not those that were written."""


@dataclass(frozen=True)
class Layout:
    """A grid cut into chunks.

    Attributes:
        shape: of the grid.
        chunk: size of a chunk along each dimension.
    """

    shape: tuple[int, ...]
    chunk: tuple[int, ...]

    @property
    def grid(self) -> tuple[int, ...]:
        """Number of chunks along each dimension."""
        return tuple(-(-n // c) for n, c in zip(self.shape, self.chunk, strict=True))

    @property
    def loops(self) -> int:
        """Samples in a whole chunk."""
        return math.prod(self.chunk)

    def __len__(self) -> int:
        """Number of chunks."""
        return math.prod(self.grid)

    def span(self, number: int) -> tuple[int, int]:
        """The number of a chunk's first sample, and how many samples it has."""
        index = np.unravel_index(number, self.grid) if self.grid else ()
        starts = [int(i) * c for i, c in zip(index, self.chunk, strict=True)]
        inside = zip(self.shape, self.chunk, starts, strict=True)
        count = math.prod(min(c, n - start) for n, c, start in inside)
        first = int(np.ravel_multi_index(starts, self.shape)) if starts else 0
        return first, count

    def numbers(self, number: int) -> np.ndarray:
        """Numbers of the samples of a chunk, rising."""
        first, count = self.span(number)
        return np.arange(first, first + count)

    def key(self, number: int) -> str:
        """Name of a chunk's file in the folder of an array."""
        index = np.unravel_index(number, self.grid) if self.grid else ()
        return ".".join(["c", *map(str, index)])


def cut(shape: tuple[int, ...], most: int) -> Layout:
    """The layout with the largest chunks of nearly equal size of at most so many samples.

    Args:
        shape: of the grid.
        most: samples in a chunk, at least 1.
    """
    chunk = [1] * len(shape)
    for axis in reversed(range(len(shape))):
        if shape[axis] > most:
            pieces = -(-shape[axis] // max(1, most))
            chunk[axis] = -(-shape[axis] // pieces)
            break
        chunk[axis] = shape[axis]
        most //= shape[axis]
    return Layout(tuple(shape), tuple(chunk))


def encode(values: np.ndarray, loops: int) -> tuple[bytes, int]:
    """A chunk's file and its checksum.

    Args:
        values: of its samples, shape (n,).
        loops: samples in a whole chunk; what is beyond n is the rim of the grid.
    """
    whole = np.zeros(loops, values.dtype.newbyteorder("<"))
    whole[: values.size] = values
    content = whole.tobytes()
    checksum = int(google_crc32c.value(content))
    return content + _CHECKSUM.pack(checksum), checksum


def decode(content: bytes, dtype: np.dtype, loops: int, count: int) -> tuple[np.ndarray, int]:
    """The values of a chunk's samples, shape (count,), and its checksum.

    Raises:
        DamagedError: its length or its checksum is not what was written.
    """
    size = loops * dtype.itemsize
    if len(content) != size + _CHECKSUM.size:
        raise DamagedError(f"{len(content)} bytes instead of {size + _CHECKSUM.size}")
    (checksum,) = _CHECKSUM.unpack(content[size:])
    if google_crc32c.value(content[:size]) != checksum:
        raise DamagedError("its checksum is wrong")
    return np.frombuffer(content, dtype.newbyteorder("<"), count), checksum
