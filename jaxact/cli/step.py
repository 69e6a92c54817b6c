"""`jaxact step`: step responses of loops."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from jaxact.cli import _arguments, _loops
from jaxact.cli._arguments import LoopsFile, Picture, Title, Velocity, option
from jaxact.errors import UserError
from jaxact.parameters import PARAMETERS

MOST_LOOPS = 12
ENGINES = "mass|mjx"
Parameters = _arguments.parameters(PARAMETERS, several=True)


def main(
    parameters: Parameters,  # type: ignore[valid-type]
    *,
    loops: LoopsFile = None,
    engine: Annotated[
        str, option(ENGINES, "Plant: an exact mass, or MuJoCo in JAX.")
    ] = ENGINES.split("|")[0],
    velocity: Velocity = None,
    duration: Annotated[float, option("SECONDS", "Simulated time [s].")] = 0.5,
    seed: Annotated[int, arg(metavar="NUMBER", help="Of the noise.")] = 0,
    title: Title = "",
    out: Picture = Path("step.png"),
) -> None:
    """Simulate the step responses of one or several loops and draw them over each other.

    Every option of a loop takes several values; all combinations are drawn: position with its
    setpoint and the 2 % band, one for each step that differs, and force. Units are SI, delays in
    seconds.

    examples:
      jaxact step --actuator ideal hyq starleth --delay 0.005
      jaxact step --actuator starleth --kp 200 400 800 --duration 1 --out step.svg
    """
    from jaxact.plotting import theme

    theme.check_output(out)
    _arguments.one_of("engine", engine, ENGINES.split("|"))
    loop = _loops.joints(parameters, loops, velocity)

    from jaxact.plotting.step import step
    from jaxact.verbs import naming, run_pictures, simulate

    names = naming.of_pictures(loop).labels
    if len(names) > MOST_LOOPS:
        raise UserError(
            f"{len(names)} loops are too many for one picture (at most {MOST_LOOPS}); "
            "give fewer values"
        )
    runs = simulate.runs(loop, duration=duration, engine=engine, seed=seed)
    drawn = [run_pictures.step_response(run, name) for run, name in zip(runs, names, strict=True)]
    units = ("rad", "N m") if loop.kind.unit == "rad" else ("m", "N")
    common = naming.in_common(loop, simulated=True)
    figure = step(drawn, title=title, footer=common, units=units, until=duration)
    theme.write(figure, out, title=title or "jaxact step")
    for response in drawn:
        print(response.label)
    print(f"wrote {out}")
