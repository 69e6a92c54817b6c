"""What the report of a simulation has: every joint over time, and what became of each loop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.errors import UserError
from jaxact.parameters import SETPOINT
from jaxact.plotting.trajectory import DIVERGED
from jaxact.plotting.wording import quantity
from jaxact.reports.page import Content
from jaxact.simulation.thinning import thinned
from jaxact.status import Verdict

if TYPE_CHECKING:
    import xarray as xr

DRAWN = (SETPOINT, "position", "velocity", "force")
# Of all joints of all loops together, some 45 bytes each; extremes are kept.
MOST_POINTS = 30_000
_LEAST_POINTS, _DIGITS = 40, 5
# A step that is none, and what serves instead [rad or m].
_STEP = 0.05


def content(run: xr.Dataset) -> Content:
    """The page of a simulation.

    Args:
        run: from `jaxact.simulate`.

    Raises:
        UserError: too many loops and joints for one page, or a dataset of something else.
    """
    missing = [name for name in (*DRAWN, "verdict") if name not in run]
    if missing:
        raise UserError(f"this dataset is not of jaxact.simulate: it has no {missing[0]}")
    whole = run if "joint" in run.dims else run.expand_dims(joint=["joint"])
    dims = [str(dim) for dim in whole["verdict"].dims if dim != "joint"]
    flat = whole.stack(number=dims, create_index=False) if dims else whole.expand_dims("number")
    share = MOST_POINTS // (flat.sizes["number"] * flat.sizes["joint"])
    if share < _LEAST_POINTS:
        raise UserError(
            f"{flat.sizes['number']} loops of {flat.sizes['joint']} joints are too many for one"
            " report; select some, e.g. run.isel(delay=0)"
        )
    rows = [flat.isel(number=number) for number in range(flat.sizes["number"])]
    data = {
        "units": {name: str(run[name].attrs.get("units", "")) for name in DRAWN},
        "loops": [_loop(row, dims, share) for row in rows],
        "joints": [str(name) for name in flat["joint"].values],
    }
    text = str(run.attrs.get("report", ""))
    return Content(
        title="Simulated: " + ", ".join(dict.fromkeys(one["verdict"] for one in data["loops"])),
        description=f"{counted(flat.sizes['number'], 'loop')},"
        f" {counted(flat.sizes['joint'], 'joint')}, {float(run['time'][-1]):.4g} s",
        parts={"run": data},
        made={"Metrics": text} if text else {},
    )


def _loop(row: xr.Dataset, dims: list[str], share: int) -> dict[str, Any]:
    named = [(dim.replace("_", " "), row[dim]) for dim in dims if dim in row.coords]
    words = [f"{dim} {_value(at)}" for dim, at in named if at.ndim == 0]
    verdict = np.ravel(row["verdict"].values)[0]
    return {
        "name": ", ".join(words) or "the loop",
        "verdict": Verdict(int(verdict)).label,
        "joints": [_joint(row.isel(joint=at), share) for at in range(row.sizes["joint"])],
    }


def counted(number: int, word: str) -> str:
    """So many of something: 1 joint, 12 joints."""
    return f"{number} {word}{'' if number == 1 else 's'}"


def _value(at: Any) -> str:
    value = at.values[()]
    return value if isinstance(value, str) else quantity(value, str(at.attrs.get("units", "")))


def _joint(one: xr.Dataset, share: int) -> dict[str, list[float]]:
    """A joint over time, thinned out."""
    signals = {"time": one["time"].values, **{name: one[name].values for name in DRAWN}}
    return drawn(signals, share)


def drawn(signals: Mapping[str, np.ndarray], share: int = MOST_POINTS) -> dict[str, list[float]]:
    """A joint over time, as the page needs it: a motion that diverges until it is far away.

    Args:
        signals: by name, position, setpoint and force among them, shape (rows,) each.
        share: at most so many rows.
    """
    position, goal = signals["position"], signals[SETPOINT]
    far = DIVERGED * max(float(np.ptp(goal)), abs(float(goal[0] - position[0])), _STEP)
    gone = ~np.isfinite(position) | (np.abs(position - position[0]) > far)
    end = int(np.argmax(gone)) if gone.any() else len(position)
    kept = thinned(position[: max(end, 2)], signals["force"][: max(end, 2)], share)
    return {
        name: [float(f"{x:.{_DIGITS}g}") for x in values[kept]] for name, values in signals.items()
    }
