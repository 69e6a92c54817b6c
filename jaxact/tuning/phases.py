"""What a search is doing, told to whoever wants to know: one short text for each phase."""

from __future__ import annotations

from collections.abc import Callable

Phase = Callable[[str], None]
"""Told what begins now."""


def silent(text: str) -> None:
    """Tell nobody."""
