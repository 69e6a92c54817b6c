"""`jaxact nyquist`: Nyquist plot of loops, with the disk margin drawn in."""

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
    out: Picture = Path("nyquist.png"),
) -> None:
    """Draw the Nyquist plot of one or several loops near the critical point -1.

    Shown with it: the unit circle, the phase crossover (circle) and gain crossover (square), and
    the disk of the balanced disk margin, which a stable loop stays out of.

    Every option of a loop takes several values; all combinations are drawn. With --control-rate
    the sampled loop is drawn as well. Units are SI, delays in seconds.

    examples:
      jaxact nyquist --actuator hyq starleth --delay 0.001 0.005
      jaxact nyquist --actuator starleth --delay 0.005 --control-rate 1000 --out nyquist.svg
      jaxact nyquist --wn 400 --zeta 0.1 --kp 2000 --kd 40
    """
    from jaxact.plotting.nyquist import nyquist

    _pictures.draw(nyquist, parameters, loops, velocity, title, out)
