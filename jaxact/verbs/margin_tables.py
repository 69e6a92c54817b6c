"""The margins of a joint's loops as a table, as plain values, and as a dataset."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact import files
from jaxact.loops import conversion
from jaxact.parameters import (
    CONTROL_RATE,
    JOINT_DAMPING,
    JOINT_STIFFNESS,
    KD,
    KP,
    LINEAR,
    MASS,
    WN,
    ZETA,
    mass_word,
    of,
)
from jaxact.plotting.wording import quantity
from jaxact.verbs import naming
from jaxact.verbs.rendering import rendered, table

if TYPE_CHECKING:
    import xarray as xr

    from jaxact.loops.control_loop import ControlLoop
    from jaxact.loops.specification import Specification

# Names of the output, in order. Margins mean nothing for an unstable loop, the others always do.
ABSCISSA = "spectral_abscissa"
ALWAYS = ("stable", "unstable_roots", "log_gain_to_boundary", ABSCISSA)
MARGINS = (
    "gain_margin", "gain_reduction_margin", "phase_crossover", "phase_margin", "gain_crossover",
    "delay_margin", "sensitivity_peak", "sensitivity_peak_frequency", "complementary_peak",
    "complementary_peak_frequency", "modulus_margin", "disk_margin",
)  # fmt: skip
UNITS = {
    "stable": "1", "unstable_roots": "1", "log_gain_to_boundary": "1", "spectral_abscissa": "1/s",
    "gain_margin": "1", "gain_reduction_margin": "1", "phase_crossover": "rad/s",
    "phase_margin": "degree", "gain_crossover": "rad/s", "delay_margin": "s",
    "sensitivity_peak": "1", "sensitivity_peak_frequency": "rad/s", "complementary_peak": "1",
    "complementary_peak_frequency": "rad/s", "modulus_margin": "1", "disk_margin": "1",
}  # fmt: skip
NAMES = (*ALWAYS, *MARGINS)
"""All metrics."""
_MOST_COLUMNS = 4
_MOST_LINES, _ENDS = 200, 20
_OF_LOOP = (*LINEAR, CONTROL_RATE)

Metrics = Mapping[str, np.ndarray]
"""Metrics of loops by name, shape (n,) each; phase margins in degrees."""


_DISTANCE = "log_gain_to_boundary"


def text(loop: ControlLoop, found: Mapping[str, Metrics]) -> str:
    """The table of a loop's margins, or of a batch's.

    Args:
        loop: what they are of.
        found: by the prefix of their names, "" or "sampled_".
    """
    loops = naming.named(loop)
    return tables(loops.labels, loops.values[CONTROL_RATE], found)


def of_factors(values: Mapping[str, np.ndarray], metrics: Metrics) -> Metrics:
    """The metrics, with -inf for the distance where no common factor on the gains stabilises.

    It is then that of slowing the loop down, see `jaxact.analysis.joint.margins.Margins`, which a
    reader of a table or a file would take for a factor.

    Args:
        values: every parameter of the loops by its short name, shape (n,) each.
        metrics: of the loops in continuous time.
    """
    servo = 2.0 * values[ZETA] / values[WN]
    beyond = values[KD] <= values[KP] * (conversion.total_delay(values) + servo)
    bare = (values[JOINT_DAMPING] == 0.0) & (values[JOINT_STIFFNESS] == 0.0)
    distance = np.where(beyond & bare & ~metrics["stable"], -np.inf, metrics[_DISTANCE])
    return {**metrics, _DISTANCE: distance}


def dataset(loop: ControlLoop, metrics: Metrics) -> xr.Dataset:
    """The metrics as variables with units over the dimensions of the batch.

    Args:
        loop: what they are of.
        metrics: by name, shape (n,) each.
    """
    import xarray as xr

    from jaxact.loops import conversion  # imports JAX, which tables do without

    samples = conversion.samples(loop)
    shape = samples.shape if loop.shape else ()
    dims = samples.dims if loop.shape else ()
    variables = {
        name: (dims, masked(name, metrics).reshape(shape), {"units": UNITS[name]}) for name in NAMES
    }
    coords = {
        name: (place.dims, place.values, place.attributes) for name, place in samples.coords.items()
    }
    return xr.Dataset(variables, coords if loop.shape else {})


def json_lines(loop: ControlLoop, found: Mapping[str, Metrics]) -> str:
    """An object for each loop, one a line; arguments as for `text`."""
    loops = naming.named(loop)
    names = (*ALWAYS[:2], *MARGINS, *ALWAYS[2:])
    lines = []
    for index, label in enumerate(loops.labels):
        first, *others = found.items()
        row: dict[str, Any] = {name: plain(name, first[1], index) for name in names}
        for _, metrics in others:
            row["sampled"] = {n: plain(n, metrics, index) for n in (*names, "spectral_radius")}
        row["loop"] = {"name": label} | _own(loops, index)
        row["loop"] |= {} if loops.unit is None else {"unit": loops.unit}
        lines.append(json.dumps(row, allow_nan=False))
    return "\n".join(lines)


def csv_text(loop: ControlLoop, found: Mapping[str, Metrics]) -> str:
    """A header, then one line a loop; empty where a metric means nothing. As for `text`."""
    loops = naming.named(loop)
    written = io.StringIO()
    writer = csv.writer(written, lineterminator="\n")
    metrics = [(f"{prefix}{name}", name, own) for prefix, own in found.items() for name in NAMES]
    writer.writerow(["name", *_own(loops, 0), *(head for head, _, _ in metrics)])
    for index, label in enumerate(loops.labels):
        cells = [plain(name, own, index) for _, name, own in metrics]
        writer.writerow(
            [label, *_own(loops, index).values(), *("" if c is None else c for c in cells)]
        )
    return written.getvalue()


def store(
    loop: ControlLoop, found: Mapping[str, Metrics], specification: Specification | None = None
) -> xr.Dataset:
    """The margins as they are kept, one loop after the other, or over a specification's axes.

    Args:
        loop, found: as for `text`.
        specification: whose loops they are, None for none.
    """
    import xarray as xr

    from jaxact import __version__
    from jaxact.loops.samples import expand
    from jaxact.sweeping import margins_store, variables

    arrays = {
        f"{prefix}{name}": (masked(name, own), UNITS[name])
        for prefix, own in found.items()
        for name in NAMES
    }
    if specification is not None:
        last = list(found)[-1]
        return margins_store.dataset(
            specification, expand(specification), arrays,
            kind=variables.SAMPLED if last else margins_store.CONTINUOUS,
            growth_rate=found[last]["spectral_abscissa"], stable=found[last]["stable"],
        )  # fmt: skip
    loops = naming.named(loop)
    coords: dict[str, Any] = {
        name: ("loop", loops.values[name], dict(of(name, loops.unit).attributes))
        for name in _OF_LOOP
    }
    coords["name"] = ("loop", np.array(loops.labels, dtype=object))
    about = {"title": "stability margins of a joint's closed loops", "jaxact_version": __version__}
    rows = {name: ("loop", array, {"units": units}) for name, (array, units) in arrays.items()}
    return xr.Dataset(rows, coords, about)


def _own(loops: naming.Loops, index: int) -> dict[str, float | str]:
    """The parameters that identify a linear loop in files; of a rotary one the inertia."""
    called = {name: mass_word(loops.unit) if name == MASS else name for name in _OF_LOOP}
    return files.plain({words: float(loops.values[name][index]) for name, words in called.items()})


def plain(name: str, metrics: Mapping[str, np.ndarray], index: int) -> Any:
    """One metric of one loop as JSON has it: null where it means nothing, "inf" for infinity."""
    value = metrics[name][index].item()
    if name == "stable":
        return bool(value)
    if name == "unstable_roots":
        return int(value)
    meaningless = name in MARGINS and not metrics["stable"][index]
    return None if meaningless else files.plain(value)


def masked(name: str, metrics: Metrics) -> np.ndarray:
    """A metric, NaN where it means nothing because the loop is unstable."""
    values = np.asarray(metrics[name])
    return np.where(metrics["stable"], values, np.nan) if name in MARGINS else values


def tables(labels: Sequence[str], rates: np.ndarray, found: Mapping[str, Metrics]) -> str:
    """A column for each of a few loops, a line for each of many, the two ends of very many."""
    columns = len(labels) * len(found)
    if columns <= _MOST_COLUMNS:
        return rendered(_tall(labels, rates, found), width=_width(columns))
    number = len(labels)
    if number <= _MOST_LINES:
        return rendered(_wide(labels, found, range(number)), width=_width(columns))
    ends = [*range(_ENDS), *range(number - _ENDS, number)]
    words = (
        f"{number:,} loops, of which the first and the last {_ENDS} are shown; all of them: "
        "as CSV or JSON, or to_pandas()"
    )
    return rendered(_wide(labels, found, ends), words, width=_width(len(ends)))


def _width(columns: int) -> int:
    """Of a table [characters], so that nothing in it is broken into lines."""
    return 30 + 26 * max(columns, 4)


def _tall(labels: Sequence[str], rates: np.ndarray, found: Mapping[str, Metrics]) -> Any:
    heads, cells = [""], []
    for index, label in enumerate(labels):
        for prefix, metrics in found.items():
            kind = f"sampled at {quantity(rates[index], 'Hz')}" if prefix else "continuous"
            heads.append(f"{label}\n{kind}")
            cells.append(_column(metrics, index, float(rates[index]),
                                 periods=len(found) > 1))  # fmt: skip
    made = table(*heads)
    for name in cells[0]:
        if any(cell[name] for cell in cells):
            made.add_row(name, *(cell[name] or "-" for cell in cells))
    return made


def _column(metrics: Metrics, index: int, rate: float, *, periods: bool) -> dict[str, str]:
    """One loop's metrics in words, by what they are called; "" where one means nothing."""

    def value(name: str) -> float:
        meaningless = name in MARGINS and not metrics["stable"][index]
        return math.nan if meaningless else float(metrics[name][index])

    def text(name: str, units: str = "") -> str:
        return "" if math.isnan(value(name)) else quantity(value(name), units)

    def at(name: str) -> str:
        return f" at {text(name, 'rad/s')}" if math.isfinite(value(name)) else ""

    gain, reduction, disk = (
        value("gain_margin"),
        value("gain_reduction_margin"),
        value("disk_margin"),
    )
    decibel = f" ({20.0 * math.log10(gain):.1f} dB)" if math.isfinite(gain) else ""
    phase = value("phase_margin")
    delay = value("delay_margin")
    return {
        "stable": "yes" if metrics["stable"][index] else "NO",
        "unstable roots": f"{int(metrics['unstable_roots'][index])}",
        "gain margin": ""
        if math.isnan(gain)
        else text("gain_margin") + decibel + at("phase_crossover"),
        "gain reduction margin": text("gain_reduction_margin") if reduction > 0 else "",
        "phase margin": "" if math.isnan(phase) else f"{phase:.4g}°{at('gain_crossover')}",
        "delay margin": text("delay_margin", "s"),
        "  in control periods": f"{delay * rate:.4g}" if periods and not math.isnan(delay) else "",
        "Ms (peak of |S|)": text("sensitivity_peak") + at("sensitivity_peak_frequency"),
        "Mt (peak of |T|)": text("complementary_peak") + at("complementary_peak_frequency"),
        "modulus margin": text("modulus_margin"),
        "disk margin": text("disk_margin"),
        "  guarantees gains": _gain_range(disk),
        "  guarantees phase": "" if math.isnan(disk) else f"±{_phase_range(disk):.3g}°",
        "rightmost root": text("spectral_abscissa", "1/s"),
        "log gain to boundary": text("log_gain_to_boundary"),
    }


def _gain_range(disk: float) -> str:
    """Gains that a balanced disk margin guarantees: (2 - a)/(2 + a) to (2 + a)/(2 - a)."""
    if math.isnan(disk):
        return ""
    high = (2.0 + disk) / (2.0 - disk) if disk < 2.0 else math.inf
    return f"×{max((2.0 - disk) / (2.0 + disk), 0.0):.3g} to ×{high:.3g}"


def _phase_range(disk: float) -> float:
    """Phase that it guarantees: 2 arctan(a / 2) [deg]."""
    return 2.0 * math.degrees(math.atan(0.5 * disk))


def _wide(labels: Sequence[str], found: Mapping[str, Metrics], rows: Sequence[int]) -> Any:
    """A line for each of these loops, an empty one where some between them are left out."""
    head = "loop" if "sampled_" in found else "loop, continuous"
    made = table(head, "gain margin", "phase margin [°]", "delay margin [ms]", "Ms", "Mt",
                 "disk margin", "unstable roots", "log gain to boundary")  # fmt: skip
    for before, index in zip((rows[0] - 1, *rows), rows, strict=False):
        if index > before + 1:
            made.add_row("…")
        for prefix, metrics in found.items():
            name = f"{labels[index]}, sampled" if prefix else labels[index]
            scaled = metrics | {"delay_margin": 1e3 * metrics["delay_margin"]}
            names = ("gain_margin", "phase_margin", "delay_margin", "sensitivity_peak",
                     "complementary_peak", "disk_margin", "unstable_roots",
                     "log_gain_to_boundary")  # fmt: skip
            made.add_row(name, *(_short(plain(item, scaled, index)) for item in names))
    return made


def _short(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value).replace("inf", "∞")
