"""`jaxact sensitivity`: sensitivity functions of loops, with their peaks."""

from __future__ import annotations

from pathlib import Path

from jaxact.cli import _loops, _pictures
from jaxact.cli._arguments import LoopsFile, Picture, Title, Velocity


def main(
    parameters: _loops.Linear,  # type: ignore[valid-type]
    *,
    loops: LoopsFile = None,
    velocity: Velocity = None,
    title: Title = "",
    out: Picture = Path("sensitivity.png"),
) -> None:
    """Draw the sensitivity |S| and the complementary sensitivity |T| of one or several loops.

    The peaks Ms and Mt are marked. An unstable loop is drawn faint: its peaks say nothing.

    Every option of a loop takes several values; all combinations are drawn. With --control-rate
    the sampled loop is drawn as well. Units are SI, delays in seconds.

    examples:
      jaxact sensitivity --actuator hyq starleth --delay 0.001 0.005
      jaxact sensitivity --actuator starleth --delay 0.005 --control-rate 1000 --out sensitivity.svg
      jaxact sensitivity --wn 400 --zeta 0.1 --kp 2000 --kd 40
    """
    from jaxact.plotting.sensitivity import sensitivity

    _pictures.draw(sensitivity, parameters, loops, velocity, title, out)
