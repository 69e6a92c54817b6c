"""`jaxact parameters`: every parameter of a loop with its unit, default, bounds and meaning."""

from __future__ import annotations


def main() -> None:
    """List every parameter of a loop: its unit, default, bounds and meaning.

    Any of them can be an axis of a sweep, a fixed value, or an override (`--set kp=400`). The names
    in words, with underscores (natural_frequency), are understood as well as the short ones (wn).

    examples:
      jaxact parameters
    """
    from jaxact.parameters import PARAMETERS, PRESETS

    rows = [("name", "unit", "default", "allowed", "meaning")]
    rows += [
        (p.name, p.unit, f"{p.default:g}", p.bounds, p.description) for p in PARAMETERS.values()
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    for row in rows:
        cells = [f"{cell:{width}}" for cell, width in zip(row, widths, strict=False)]
        print("  ".join([*cells, row[4]]))
    presets = ", ".join(f"{name} ({wn:g}, {zeta:g})" for name, (wn, zeta) in PRESETS.items())
    print(f"\nactuator, instead of wn and zeta, is one of (wn, zeta): {presets}")
