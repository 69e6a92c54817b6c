"""`jaxact step`: step responses of loops."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import OmitArgPrefixes, arg

from jaxact.cli import _loops
from jaxact.cli._pictures import LoopsFile, Out, Title, check_velocities, footer, named
from jaxact.errors import UserError
from jaxact.parameters import PARAMETERS

if TYPE_CHECKING:
    from jaxact.plotting.step import StepResponse
    from jaxact.simulation.single import Single

MOST_LOOPS = 12
Parameters = _loops.options(PARAMETERS, several=True)


def main(
    parameters: Annotated[Parameters, OmitArgPrefixes] = Parameters(),  # type: ignore[valid-type] # noqa: B008
    *,
    loops: LoopsFile = None,
    engine: Annotated[
        str, arg(metavar="mass|mjx", help="Plant: an exact mass, or MuJoCo in JAX.")
    ] = "mass",
    velocity: Annotated[
        str,
        arg(
            metavar="sampled|differenced",
            help="Velocity that the controller sees: sensed, or positions differenced.",
        ),
    ] = "sampled",
    duration: Annotated[float, arg(metavar="SECONDS", help="Simulated time [s].")] = 0.5,
    seed: Annotated[int, arg(metavar="NUMBER", help="Of the noise.")] = 0,
    title: Title = "",
    out: Out = Path("step.png"),
) -> None:
    """Simulate the step responses of one or several loops and draw them over each other.

    Every option of a loop takes several values; all combinations are drawn: position with its
    setpoint and the 2 % band, and force. Units are SI, delays in seconds.

    examples:
      jaxact step --actuator ideal hyq starleth --delay 0.005
      jaxact step --actuator starleth --kp 200 400 800 --duration 1 --out step.svg
    """
    from jaxact.plotting import theme

    theme.check_output(out)
    static: dict[str, Any] = {
        "engine": engine, "velocity": velocity, "duration": duration, "seed": seed,
        "precision": "float64",
    }  # fmt: skip
    given = _loops.given(parameters)
    if loops is None:
        chosen = _loops.combinations(given, **static)
    else:
        chosen = _loops.from_file(loops, given)
        if chosen.velocity == "differenced":
            static["velocity"] = velocity = "differenced"
        check_velocities(chosen, velocity, loops)
    chosen, specification = named(chosen), _loops.specified(static)
    if len(chosen) > MOST_LOOPS:
        raise UserError(
            f"{len(chosen)} loops are too many for one picture (at most {MOST_LOOPS}); "
            "give fewer values"
        )

    from jaxact.plotting.step import step
    from jaxact.simulation import single

    runs = single.simulate_all(specification, chosen.samples)
    drawn = [_response(run, label) for run, label in zip(runs, chosen.labels, strict=True)]
    theme.write(
        step(drawn, title=title, footer=footer(chosen, velocity), until=duration),
        out,
        title=title or "jaxact step",
    )
    for response in drawn:
        print(response.label)
    print(f"wrote {out}")


def _response(run: Single, label: str) -> StepResponse:
    from jaxact.plotting.step import StepResponse
    from jaxact.plotting.trajectory import Joint
    from jaxact.plotting.wording import quantity
    from jaxact.status import Verdict

    verdict, results = Verdict(int(run.results["verdict"])), run.results
    words = [] if verdict is Verdict.STABLE else [verdict.label]
    if verdict is not Verdict.UNSTABLE and math.isfinite(results["overshoot"]):
        words.append(f"overshoot {100.0 * results['overshoot']:.3g} %")
    for name in ("rise_time", "settling_time"):
        if math.isfinite(results[name]):
            words.append(f"{name.replace('_', ' ')} {quantity(results[name], 's')}")
    signals = ("setpoint", "position", "velocity", "command", "delayed_command", "force")
    rows = {name: getattr(run.trajectory, name)[:, 0] for name in signals}
    return StepResponse(
        label=f"{label}: {', '.join(words)}" if words else label,
        run=Joint(time=run.trajectory.time, **rows),
        stable=verdict in (Verdict.STABLE, Verdict.LIMIT_CYCLE),
    )
