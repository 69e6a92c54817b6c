"""Gains in the metadata of an ONNX policy, as mjlab writes them: lists in the order of the joints.

    joint_names = "left_hip,right_hip"    joint_stiffness = "40.179,99.098"    joint_damping = "..."

Of the file, a Protocol Buffers message `ModelProto`, only `metadata_props` (field 14: messages with
key, field 1, and value, field 2) are looked at; everything else is skipped unread.

Source: Protocol Buffers, "Encoding"; onnx.proto.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from jaxact.errors import UserError, shown
from jaxact.gains.deployment import named_file, number, unused
from jaxact.gains.table import GainFile

_METADATA, _KEY, _VALUE = 14, 1, 2
_VARINT, _EIGHT, _BYTES, _FOUR = 0, 1, 2, 5
_FIXED = {_EIGHT: 8, _FOUR: 4}
_LONGEST_VARINT = 10
_WANTED = ("joint_names", "joint_stiffness", "joint_damping")


class _DamagedError(Exception):
    """The bytes are not a message."""


def read(path: Path, raw: bytes) -> GainFile:
    """The gains of a policy.

    Raises:
        UserError: it is not such a file, or has no gains.
    """
    try:
        found = dict(_properties(raw))
    except (_DamagedError, UnicodeDecodeError):
        raise UserError(f"{path}: is not an ONNX file, or is damaged") from None
    for key in _WANTED:
        if key not in found:
            raise UserError(
                f"{path}: its metadata have no {key}, which policies of mjlab have; give the YAML"
                " or Python file beside it that has the gains"
            )
    lists = {key: [part.strip() for part in found[key].split(",")] for key in _WANTED}
    kp, kd = (_numbers(path, key, lists[key]) for key in _WANTED[1:])
    notes = unused(found, ("default_joint_pos", "action_scale"))
    return named_file(path, "onnx", lists["joint_names"], {"joint_stiffness": kp,
                      "joint_damping": kd}, notes)  # fmt: skip


def _numbers(path: Path, key: str, parts: Sequence[str]) -> list[float]:
    try:
        return [number(path, key, float(part)) for part in parts]
    except ValueError:
        raise UserError(f"{path}: {key} = {shown(','.join(parts))}; give numbers") from None


def _properties(raw: bytes) -> Iterator[tuple[str, str]]:
    """Key and value of every entry of the metadata."""
    for field, value in _fields(raw):
        if field == _METADATA and value is not None:
            entry = {name: text for name, text in _fields(value) if text is not None}
            yield entry.get(_KEY, b"").decode(), entry.get(_VALUE, b"").decode()


def _fields(raw: bytes) -> Iterator[tuple[int, bytes | None]]:
    """Number of each field of a message, and its bytes; None of one that is a number."""
    at = 0
    while at < len(raw):
        tag, at = _varint(raw, at)
        field, kind = tag >> 3, tag & 7
        if kind == _VARINT:
            _, at = _varint(raw, at)
            yield field, None
            continue
        if kind == _BYTES:
            length, at = _varint(raw, at)
        elif kind in _FIXED:
            length = _FIXED[kind]
        else:
            raise _DamagedError
        if not field or length > len(raw) - at:
            raise _DamagedError
        yield field, raw[at : at + length] if kind == _BYTES else None
        at += length


def _varint(raw: bytes, at: int) -> tuple[int, int]:
    """A number in base 128, its lowest digit first; and where it ends."""
    value = 0
    for place in range(_LONGEST_VARINT):
        if at + place >= len(raw):
            raise _DamagedError
        digit = raw[at + place]
        value |= (digit & 0x7F) << (7 * place)
        if digit < 0x80:
            return value, at + place + 1
    raise _DamagedError
