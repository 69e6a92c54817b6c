"""`jaxact bode`: Bode plot of loops, with gain, phase and delay margins drawn in."""

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
    out: Picture = Path("bode.png"),
) -> None:
    """Draw the Bode plot of one or several loops, with the gain and phase margins drawn in.

    Bars reach from the curve to 0 dB at the phase crossover (gain margin) and to -180 deg at the
    gain crossover (phase margin). The delay is exact, no Pade approximation.

    Every option of a loop takes several values; all combinations are drawn. With --control-rate
    the sampled loop is drawn as well. Units are SI, delays in seconds.

    examples:
      jaxact bode --actuator hyq starleth --delay 0.001 0.005
      jaxact bode --actuator starleth --delay 0.005 --control-rate 1000 --out bode.svg
      jaxact bode --wn 400 --zeta 0.1 --kp 2000 --kd 40
    """
    from jaxact.plotting.bode import bode

    _pictures.draw(bode, parameters, loops, velocity, title, out)
