"""`jaxact margins`: all stability margins of loops."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from jaxact.cli import _arguments, _files, _loops, _options, _progress, _warnings
from jaxact.cli._arguments import LoopsFile, Velocity, option
from jaxact.engines import LINEARISING as ENGINES
from jaxact.errors import UserError
from jaxact.parameters import CONTROL_RATE


@dataclass(frozen=True)
class Robot(_arguments.Robot):
    """Which robot is linearised, how it is mounted, how it is damped and how it rubs."""

    engine: Annotated[
        str | None,
        option(
            "mujoco|mjx",
            "Linearise C MuJoCo by differences, or differentiate MJX, which compiles first.",
            "mujoco",
        ),
    ] = None
    out: Annotated[
        Path | None,
        option(
            "FILE",
            "Robots only: picture to write, .png, .svg or .pdf; one that is there is replaced.",
            "none",
        ),
    ] = None


def main(
    parameters: _loops.Linear,  # type: ignore[valid-type]
    robot: Robot,
    *,
    loops: LoopsFile = None,
    velocity: Velocity = None,
    json: Annotated[bool, arg(help="Print one JSON object a loop, one a line.")] = False,
    csv: _arguments.Csv = None,
    store: Annotated[Path | None, option("DIR", "Write a Zarr v3 store.", "no")] = None,
    overwrite: Annotated[bool, arg(help="Replace a CSV file or a store that is there.")] = False,
) -> None:
    """Compute all stability margins of one loop or thousands, with the exact delay, or of a robot.

    Every option of a loop takes several values; all combinations are computed. With
    --control-rate the margins of the sampled loop are given beside those in continuous time. Units
    are SI: frequencies rad/s, delays s; phase margins are in degrees.

    gain margin: smallest factor above 1 on all gains that destabilises. delay margin: smallest
    added delay that does. Ms, Mt: peaks of |S| and |T|. disk margin: 1/max|S - 1/2|, balanced.
    Margins of an unstable loop mean nothing and are left out; log_gain_to_boundary, the logarithm
    of the factor on all gains to the nearest boundary, is negative there.

    With --model: a robot, linearised at a posture, sampled at its control rate (1 kHz where none is
    given), gains and delays those the model brings where none are given. Of each joint with all
    others closed, the margins above; of all joints at once, peaks of the largest singular values of
    S and T, the multi-loop disk margin, a common factor on all gains (also downwards: at low gain
    gravity topples a robot), a common delay.

    JSON of a robot: model, keyframe, posture, base, damping, friction, loop, engine,
    dry_friction_left_out, stiction (joint, push, strongest, shaking, amplitude, frequency,
    sentence; null where friction holds nothing that shakes), residual, payload_body, sag (by joint,
    under changes of the model), leaves_posture (why it rests nowhere near), neutral_directions,
    control_period, physics_step, stable, unstable_roots, spectral_radius, growth_rate,
    gain_to_boundary, log_gain_to_boundary, verdict (stable, shakes, topples, shakes and topples),
    shaking_rate, toppling_rate; changes (more_gain, less_gain, more_delay, less_delay,
    topple_more_gain, topple_less_gain: value, frequency, participation of the nearest factor or
    delay at which it begins or ceases to shake or topple); all (null if unstable) with gain_margin,
    gain_reduction_margin, delay_margin, sensitivity_peak, complementary_peak, disk_margin and the
    frequency of each, modulus_margin, unscaled_disk_margin; joints with name, kp, kd and the
    margins above; ranking (names, by their share in what shakes first); critical_mode,
    slowest_mode, response_at_peak with growth_rate, frequency, damping_ratio, participation by
    joint.

    examples:
      jaxact margins --mass 0.7 --kp 400 --kd 20 --actuator starleth --delay 5e-3
      jaxact margins --actuator hyq starleth --delay 0 0.001 0.005 --control-rate 1000
      jaxact margins --drive drive.toml --inertia 0.05 --kp 20 --kd 0.6
      jaxact margins --loops loops.toml --json
      jaxact margins --loops sweep.toml --store margins.zarr  # for plot --variable gain_margin
      jaxact margins --model robot.xml --keyframe home --actuator hyq --delay 0.001
      jaxact margins --model robot.xml --kp 300 --kd 15 --set 'kp@.*_knee=500' --out margins.png
    """
    named = robot.model is not None or robot.spec is not None
    if _arguments.demand_robot(robot, given=named):
        for name, unfit in (("loops", loops), ("csv", csv), ("store", store)):
            if unfit is not None:
                raise UserError(f"--{name}: is for single joints; a robot's metrics come as --json")
        _of_robot(robot, _arguments.given(parameters), velocity, json=json)
        return
    _files.check_output(csv, ".csv", overwrite=overwrite)
    loop = _loops.linear(parameters, loops, velocity)

    from jaxact.verbs import margin_tables
    from jaxact.verbs.margins import margins

    if store is not None:
        from jaxact.loops import listed, reading
        from jaxact.sweeping import atomic_store

        atomic_store.refuse_existing(store, overwrite=overwrite)
    found = margins(loop, sampled="both" if CONTROL_RATE in loop.values else False)
    if csv is not None:
        text = margin_tables.csv_text(loop, found.found)
        _files.write(csv, lambda file: file.write(text.encode()))
    if store is not None:
        grid = loops is not None and listed.rows(loops) is None
        # Of what a file of axes says only the velocity can be given otherwise.
        specification = replace(reading.load(loops), velocity=loop.kind.velocity) if grid else None
        with atomic_store.destination(store, overwrite=overwrite) as partial:
            atomic_store.write(margin_tables.store(loop, found.found, specification), partial)
    print(found.to_json() if json else found)
    if not json and (csv or store):
        print("wrote " + ", ".join(str(path) for path in (csv, store) if path is not None))


def _of_robot(robot: Robot, given: dict[str, Any], velocity: str | None, *, json: bool) -> None:
    """Print the margins of a robot with all combinations of the values given, and draw them."""
    if robot.out is not None:
        from jaxact.plotting.theme import check_output

        check_output(robot.out)
    if robot.engine is not None:
        _arguments.one_of("engine", robot.engine, ENGINES)
    specification = _loops.of_robot(robot, given, velocity, engine=robot.engine)

    from jaxact.loops.building import loop_of
    from jaxact.verbs.margins import margins

    loop = loop_of(specification)
    if robot.out is not None and loop.shape:
        raise UserError("--out: draws one loop; give one value for each option")
    engine = specification.engine if specification.engine in ENGINES else ENGINES[0]
    with _progress.phases(quiet=json) as phase:
        phase("settling, linearising and computing margins")
        found = margins(loop, engine=engine)
        phase("looking for what dry friction holds")
        _ = found.stiction  # printed too
    _warnings.gains(loop.kind.plant)
    _warnings.overload(specification)
    print(found.to_json() if json else _options.typed(repr(found), "margins"))
    if robot.out is not None:
        from jaxact.plotting.robot import whole_robot
        from jaxact.plotting.theme import write
        from jaxact.verbs.robot_tables import title

        one = found.details[0]
        words = f"{title(specification)}: all joints at once"
        figure = whole_robot(one.curves, one.margins, title=words)
        write(figure, robot.out, title="jaxact: margins of a robot")
        if not json:
            print(f"wrote {robot.out}")
