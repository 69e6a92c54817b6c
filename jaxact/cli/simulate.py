"""`jaxact simulate`: one loop over time."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import arg

from jaxact.cli import _arguments, _files, _loops, _replay, _warnings, _xla
from jaxact.cli._arguments import UNSET, UNSET_NUMBER, Robot, option
from jaxact.engines import best_precision
from jaxact.errors import UserError
from jaxact.parameters import PARAMETERS, POSITION_RESOLUTION

if TYPE_CHECKING:
    from jaxact.loops.specification import Specification
    from jaxact.simulation.single import Single

_FIRST = "0"
Parameters = _arguments.parameters(PARAMETERS, several=False)


@dataclass(frozen=True)
class Rollout:
    """How the loop is simulated."""

    engine: Annotated[
        str | None,
        option(
            "mass|mjx|mujoco|warp|auto",
            "Plant: an exact mass; MuJoCo in JAX, in C, or in Warp; or the fastest of these.",
            "mass; auto for a model",
        ),
    ] = None
    velocity: Annotated[
        str | None,
        option(
            "sampled|differenced",
            "Velocity that the controller sees: sensed, or positions differenced.",
            "sampled, or that of --drive or of a file",
        ),
    ] = None
    duration: Annotated[float, option("SECONDS", "Simulated time [s].", "1")] = UNSET
    physics_step: Annotated[
        float,
        option(
            "SECONDS",
            "Step of the plant [s].",
            "the control period for mass, 0.00025 for mjx; finer with limits",
        ),
    ] = UNSET
    precision: Annotated[
        str | None,
        option("float32|float64", "Of the simulation.", "float64; with warp float32"),
    ] = None
    seed: Annotated[int, option("NUMBER", "Of the noise.", "0")] = UNSET_NUMBER


def main(
    parameters: Parameters,  # type: ignore[valid-type]
    robot: Robot,
    rollout: Rollout,
    recorded: _replay.Recorded,
    *,
    joint: Annotated[
        str,
        option(
            "NAME", "Which driven joint of a model is drawn, name or number; or which of a log."
        ),
    ] = _FIRST,
    out: _arguments.Picture = Path("simulation.png"),
    csv: _arguments.Csv = None,
    npz: Annotated[
        Path | None, option("FILE", "Write the trajectory as NumPy arrays.", "no")
    ] = None,
    overwrite: Annotated[bool, arg(help="Replace CSV and NPZ files that are there.")] = False,
    json: Annotated[bool, arg(help="Print the metrics as JSON instead of a table.")] = False,
) -> None:
    """Simulate one loop and keep its trajectory, as a picture and as numbers.

    The loop is that of the study where nothing is given: 0.7 kg, kp 400 N/m, kd 20 N s/m, ideal
    actuator, no delay, control at 1 kHz. All units are SI, delays in seconds; for a rotary joint
    read rad and N m. Where quantisation, friction, or a robot that nothing disturbs ask for it, the
    verdict is the worst of several starts, which are listed. JSON of a robot says what dry friction
    holds (stiction), which joints give all they can in the last quarter (saturated), and what
    `jaxact margins` says of a changed model (payload_body, sag, leaves_posture).

    With --replay: an identified drive on the time stamps of a log, for the setpoint under the gains
    that the map states, or for the command; measured and simulated over each other, and the errors.
    wn, zeta, delay, force_limit, mass, joint_damping, kp and kd can be others than the drive's.
    JSON: drive, log, rows, duration, driven_by, signal, unit, rms, max, nrmse (rms over the
    standard deviation of what was measured).

    examples:
      jaxact simulate --actuator starleth --delay 0.005
      jaxact simulate --actuator hyq --kp 4000 --kd 200 --force-limit 100 --csv run.csv
      jaxact simulate --drive drive.toml --replay log.csv --map columns.toml --csv replay.csv
      jaxact simulate --drive d.toml --replay air.csv --map map.toml --model go2.xml --joint FL_hip
      jaxact simulate --spec experiments/paper_gain_map.toml --set engine=mjx --duration 2
      jaxact simulate --model robot.xml --keyframe home --actuator hyq --delay 0.001 --npz run.npz
    """
    from jaxact.plotting import theme

    theme.check_output(out)
    for path, ending in ((csv, ".csv"), (npz, ".npz")):
        _files.check_output(path, ending, overwrite=overwrite)
    given = _arguments.given(parameters)
    mounted = {name: value for name, value in vars(robot).items() if name != "model"}
    _replay.check(recorded, given, mounted | vars(rollout) | {"npz": npz})
    if recorded.replay is not None:
        one = "" if joint == _FIRST else joint
        _replay.run(recorded, given, one, robot.model, out, csv, as_json=json)
        return
    specification = specified(robot, given, vars(rollout))

    _xla.call_at_once(specification)
    from jaxact.loops.building import loop_of
    from jaxact.simulation import engines, single
    from jaxact.verbs import run_tables
    from jaxact.verbs.simulate import runs

    specification = engines.resolved(specification)
    place = _place(single.names(specification), joint)
    run = runs(
        loop_of(specification), duration=specification.duration, engine=specification.engine,
        precision=specification.precision, seed=specification.seed,
    )[0]  # fmt: skip
    _warnings.posture(specification)
    _write(run, specification, place, out, csv, npz)
    held = None
    if specification.plant is not None and run.results["growth_rate"] > 0.0:
        from jaxact.robot_margins import whole_robot

        held = whole_robot.nominal(specification).stiction
    if json:
        print(run_tables.as_json(run, held, _changes_as_object(specification)))
        return
    print("\n".join([*_changes(specification), run_tables.text(run)]))
    if held is not None:
        print(f"The robot {held.sentence}.")
    print("wrote " + ", ".join(str(path) for path in (out, csv, npz) if path is not None))


def _changes(specification: Specification) -> list[str]:
    """What is said of a robot whose model is changed; nothing of others."""
    if specification.plant is None:
        return []
    from jaxact.verbs import changed_robot

    return changed_robot.of_nominal(specification)


def _changes_as_object(specification: Specification) -> dict[str, Any]:
    """The same for JSON."""
    if specification.plant is None:
        return {}
    from jaxact.verbs import changed_robot

    return changed_robot.of_nominal_as_object(specification)


def specified(
    robot: Robot,
    given: dict[str, Any],
    static: dict[str, Any],
    *,
    duration: float = 1.0,
    push: dict[str, Any] | None = None,
) -> Specification:
    """The loop to simulate: the file, then the options, then --set.

    Args:
        robot: which one, or the file.
        given: parameters that were given.
        static: options of the whole specification.
        duration: where nothing gives one [s].
        push: keys of the push, None where none was given.

    Raises:
        UserError: options of a robot without one, and as `_loops.specified`.
    """
    if not robot.set:
        _arguments.demand_robot(robot, given=robot.model is not None or robot.spec is not None)
    asked = {name: value for name, value in static.items() if _arguments.is_given(value)}
    words = [str(asked.get("engine")), *(word.removeprefix("engine=") for word in robot.set)]
    defaults = {"precision": min(map(best_precision, words)), "duration": duration}
    return _loops.specified(robot, given, asked, defaults=defaults, push=push)


def _place(names: Sequence[str], joint: str) -> int:
    """Number of the joint that is asked for by name or number."""
    if joint in names:
        return list(names).index(joint)
    if joint.isdigit() and int(joint) < len(names):
        return int(joint)
    raise UserError(f"--joint {joint}: the driven joints are {', '.join(names)}, or their numbers")


def _write(
    run: Single,
    specification: Specification,
    joint: int,
    out: Path,
    csv: Path | None,
    npz: Path | None,
) -> None:
    import numpy as np

    from jaxact.plotting import caption, theme, trajectory
    from jaxact.verbs import naming, run_pictures, run_tables

    if csv is not None:
        columns = run_tables.columns(run)
        table, header = np.column_stack(list(columns.values())), ",".join(columns)
        text = {"fmt": "%.9g", "delimiter": ",", "header": header, "comments": ""}
        _files.write(csv, lambda file: np.savetxt(file, table, **text))
    if npz is not None:
        _files.write(npz, lambda file: np.savez_compressed(file, **run_tables.arrays(run)))
    name = f"{run.joints[joint].name}: " if len(run.joints) > 1 else ""
    units = ("rad", "N m") if run.rotary[joint] else ("m", "N")
    figure = trajectory.trajectory(
        run_pictures.signals(run, joint),
        title=name + naming.loop_name(specification, run.values),
        footer=caption.loop(
            run.values,
            run.results,
            dataclasses.asdict(specification),
            units[0],
            joints=len(run.joints),
        ),
        units=units,
        resolution=run.values[POSITION_RESOLUTION],
    )
    theme.write(figure, out, title="jaxact: one loop over time")
