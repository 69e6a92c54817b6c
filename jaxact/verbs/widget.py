"""`jaxact.widget`: the interactive map of a joint in a notebook, whose point Python reads."""

from __future__ import annotations

import functools
import json
import math
from typing import TYPE_CHECKING, Any

from jaxact import files
from jaxact.errors import UserError
from jaxact.loops.building import joint
from jaxact.parameters import CONTROL_RATE, KD, KP, LINEAR
from jaxact.reports import page
from jaxact.verbs import report_joint

if TYPE_CHECKING:
    from jaxact.loops.control_loop import ControlLoop
    from jaxact.reports.page import Content

NAMES = tuple(dict.fromkeys((KP, KD, *LINEAR, CONTROL_RATE)))
"""What follows the page's point and sliders, by short name."""


def widget(subject: Any) -> Any:
    """The report of a joint as a widget: a map of its gains whose point Python reads and moves.

        chosen = jaxact.widget(jaxact.joint(actuator="starleth", delay=5e-3))
        chosen                  # as the last line of a cell: the page
        chosen.kp, chosen.kd    # where the point is; set them, and it moves
        jaxact.margins(chosen.loop)

    Its traits are the parameters by short name (kp, kd, mass, wn, zeta, delay, control_rate, ...),
    which `observe` watches as those of any widget of ipywidgets.

    Args:
        subject: as for `jaxact.report`, of a joint.

    Returns:
        The widget, an `anywidget.AnyWidget`.

    Raises:
        UserError: anywidget is not there, or a report cannot be of this.
    """
    content = _content(subject)
    data = content.parts["joint"]
    first = data["loops"][data["start"]]["parameters"]
    kind = {"unit": data["unit"], "velocity": first["velocity"]}
    return _kind()(
        _data=json.dumps(files.plain(data), allow_nan=False),
        _names=list(NAMES),
        _kind=kind,
        **{name: float(first[name]) for name in NAMES},
    )


def _content(subject: Any) -> Content:
    """The page of a joint's report; of a robot there is none to click in a notebook."""
    try:
        return report_joint.content(subject)
    except UserError as error:
        if str(error) != report_joint.ROBOT:
            raise
        raise UserError(
            "a widget is of a joint, and this is of a robot; write a page of its margins with "
            "jaxact.report(jaxact.margins(loop), 'robot.html')"
        ) from None


@functools.cache
def _kind() -> Any:
    """The class of the widgets, which needs what only notebooks have."""
    try:
        import anywidget
        import traitlets
    except ImportError:
        raise UserError(
            "a widget needs anywidget: pip install 'jaxact[notebook]'; `jaxact.report` does without"
        ) from None

    # JSON has no infinity.
    plain = {
        "to_json": lambda value, _: "inf" if value == math.inf else value,
        "from_json": lambda value, _: float(value),
    }

    def loop(self: Any) -> ControlLoop:
        """The loop at the point."""
        return joint(**{name: getattr(self, name) for name in NAMES}, **self._kind)

    own: dict[str, Any] = {name: traitlets.Float().tag(sync=True, **plain) for name in NAMES}
    own |= {
        "__doc__": "The interactive map of a joint; `loop` is the one at its point.",
        "_esm": page.widget(),
        "_data": traitlets.Unicode().tag(sync=True),
        "_names": traitlets.List().tag(sync=True),
        "_kind": traitlets.Dict(),
        "loop": property(loop),
    }
    return type("Widget", (anywidget.AnyWidget,), own)
