"""`jaxact report`: a loop, a robot or a result as one HTML file that one can click."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from jaxact.cli import _arguments, _loops, _reports
from jaxact.cli._arguments import Title, Velocity, option
from jaxact.errors import UserError

# Files that are of a robot.
_MODELS = (".xml", ".urdf", ".mjcf")


def main(
    parameters: _loops.Linear,  # type: ignore[valid-type]
    result: Annotated[
        Positional[str],
        arg(
            metavar="RESULT",
            help="Results of a sweep or of a tuning, an identified drive, a robot's model, or a"
            " TOML file that describes or lists loops; none: the loop of the options.",
        ),
    ] = "",
    robot: _arguments.Robot = _arguments.Robot(),  # noqa: B008
    *,
    velocity: Velocity = None,
    title: Title = "",
    out: Annotated[
        Path, option("FILE", "HTML file to write; one that is there is replaced.")
    ] = Path("report.html"),
) -> None:
    """Write a loop's report: one HTML file that works without a network, and that one can click.

    Its stability map has the exact boundary, level lines of the margins and the gains as they are.
    A click, a drag or the arrow keys move the point (kp, kd); sliders move the actuator, delays,
    mass and control rate; margins, growth rate, Bode, Nyquist and sensitivity plots and the step
    response follow at once, computed in the page with the exact formulas. Tables stand behind all
    pictures, and the loop can be copied as TOML or as a command.

    Of a robot, linearised as `margins` does: the map is over the delay of the commands and a factor
    on all gains; margins of all joints at once and of each, singular values and the joints that
    shake first follow gains, also of groups of joints, delay, actuators and control rate.

    examples:
      jaxact report --actuator starleth --delay 0.005 --out joint.html
      jaxact report results/paper_gain_map --out map.html
      jaxact report experiments/paper_gain_map.toml
      jaxact report drive.toml
      jaxact report robot.xml --keyframe home --base fixed --actuator hyq --delay 0.002
      jaxact tune --actuator hyq --delay 1e-3 --out tuned && jaxact report tuned
      jaxact report --actuator hyq starleth --delay 0 0.001 0.005 --title "Two actuators"
    """
    given = _arguments.given(parameters)
    if Path(result).suffix.lower() in _MODELS and robot.model is None:
        result, robot = "", dataclasses.replace(robot, model=Path(result))
    named = robot.model is not None or robot.spec is not None
    of_robot = _arguments.demand_robot(robot, given=named)
    if result and (given or of_robot):
        name = next(iter(given), "model" if robot.model is not None else "spec")
        raise UserError(f"{_arguments.typed(name)}: {result} says it; give one of the two")
    _reports.check_output(out)
    if not of_robot:
        _reports.write(result or _loops.linear(parameters, None, velocity), out, title)
        return
    specification = _loops.of_robot(robot, given, velocity)

    from jaxact.loops.building import loop_of

    _reports.write(loop_of(specification), out, title)
