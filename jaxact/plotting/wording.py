"""How values, categories and axes are written, in pictures and in tables."""

from __future__ import annotations

import math

_NAMES = {"hyq": "HyQ", "starleth": "StarLETH"}
_SCALES = {
    "s": ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs")),
    "Hz": ((1e6, "MHz"), (1e3, "kHz"), (1.0, "Hz")),
}


def display_name(value: object) -> str:
    """A category as its makers write it: `hyq` is HyQ."""
    return _NAMES.get(str(value), str(value).replace("_", " "))


def quantity(value: object, units: str = "") -> str:
    """A value with its unit, in the prefix a reader would choose: 0.00183 s is `1.83 ms`.

    Args:
        value: a number, or a category (then the unit is ignored).
        units: SI unit of the value, "" or "1" for none.
    """
    if isinstance(value, str):
        return display_name(value)
    number = float(value)  # type: ignore[arg-type]
    if math.isinf(number):
        return "∞" if number > 0 else "-∞"
    scales = _SCALES.get(units)
    if scales is None:
        return f"{number:.4g} {units}".rstrip() if units != "1" else f"{number:.4g}"
    if number == 0.0:
        return "0 ms" if units == "s" else f"0 {units}"
    factor, unit = next((s for s in scales if abs(number) >= s[0] * 0.9995), scales[-1])
    return f"{number / factor:.4g} {unit}"


def physics_step(used: float, own: float, control_period: float, *, asked: bool) -> str:
    """`physics step 1 ms (the model's 5 ms exceeds the control period)`.

    Args:
        used: step [s].
        own: that of the model [s].
        control_period: [s].
        asked: whether the step was asked for, and is not to be explained.
    """
    said = f"physics step {used * 1e3:g} ms"
    if asked or math.isclose(own, used, rel_tol=1e-6):
        return said
    longer = own > control_period * (1.0 + 1e-6)
    why = "exceeds" if longer else "does not divide"
    return f"{said} (the model's {own * 1e3:g} ms {why} the control period)"


def axis_label(name: str, units: str = "", long_name: str = "") -> str:
    """`stiffness kp [N/m]`: what the axis shows, its symbol, its unit."""
    words = name.replace("_", " ")
    if long_name and long_name.casefold() != words.casefold():
        words = f"{long_name} {name}" if len(name) <= 4 else long_name
    return f"{words} [{units}]" if units and units != "1" else words
