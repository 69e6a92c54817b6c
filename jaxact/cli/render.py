"""`jaxact render`: a film of a robot, bare and with the drive."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from jaxact.cli import _arguments, _warnings, simulate
from jaxact.cli._arguments import UNSET_NUMBER, option
from jaxact.errors import UserError
from jaxact.parameters import PARAMETERS

Parameters = _arguments.parameters(PARAMETERS, several=False, drive=False)


@dataclass(frozen=True)
class Robot(_arguments.Robot):
    """Which robot is filmed, how it is mounted, how it is damped and how it rubs."""

    push: Annotated[
        tuple[str, float, float, float] | None,
        option(
            "BODY X Y Z",
            "Impulse on a body [N s], 0.1 s after the start.",
            "the specification's, or none",
        ),
    ] = None
    engine: Annotated[
        str | None,
        option("mjx|mujoco|warp|auto", "MuJoCo in JAX, in C, in Warp, or the fastest one.", "auto"),
    ] = None
    seed: Annotated[int, option("NUMBER", "Of the noise.", "0")] = UNSET_NUMBER


@dataclass(frozen=True)
class Film:
    """What is shown of the two motions, and from where."""

    bare: Annotated[
        Path | None,
        option(
            "FILE",
            "Nothing is simulated; motion on the left: NPZ file with `time` [s] and `qpos`, as"
            " `jaxact simulate --npz` writes it.",
            "simulated",
        ),
    ] = None
    drive: Annotated[
        Path | None, option("FILE", "Motion on the right: as for --bare.", "simulated")
    ] = None
    labels: Annotated[tuple[str, str], option("TEXT TEXT", "Above the two motions.")] = (
        "bare: ideal actuators",
        "with the drive model",
    )
    speed: Annotated[float, option("FACTOR", "1 for real time, 0.25 for four times slower.")] = 1.0
    start: Annotated[float, option("SECONDS", "Where the film starts [s].")] = 0.0
    duration: Annotated[
        float | None,
        option(
            "SECONDS",
            "How much of the motion is simulated and shown [s].",
            "all of a file, 2 s otherwise",
        ),
    ] = None
    fps: Annotated[float, option("RATE", "Frames per second of the film.")] = 25.0
    size: Annotated[
        tuple[int, int], option("WIDTH HEIGHT", "Of each of the two pictures [pixels].")
    ] = (480, 360)
    azimuth: Annotated[float, option("DEGREES", "Direction the camera looks along.")] = 130.0
    elevation: Annotated[
        float, option("DEGREES", "Of that direction; negative looks down.")
    ] = -15.0
    distance: Annotated[
        float | None,
        option(
            "METRES", "Of the camera from the robot, which it follows.", "the whole robot is seen"
        ),
    ] = None


def main(
    parameters: Parameters,  # type: ignore[valid-type]
    robot: Robot,
    film: Film,
    *,
    out: Annotated[
        Path,
        option("FILE", "Film to write: .gif, or .mp4 where ffmpeg is; replaced if there."),
    ] = Path("robots.gif"),
) -> None:
    """Film a robot twice, side by side: bare on the left, with the drive model on the right.

    Both are simulated with the same gains, setpoint and push. The bare one has ideal actuators, no
    delays, no noise, quantisation or bias; the other one what the options or a specification say.
    Or motions simulated earlier are shown. Below each runs the speed of its joints (root mean
    square), on one scale for both. Links without a shape, as where mesh files are missing, are
    drawn as the boxes that have their inertia. Needs OpenGL, but no screen: EGL is tried, then
    OSMesa; MUJOCO_GL chooses. Angles in degrees, the rest SI.

    examples:
      jaxact render --model robot.xml --keyframe home --actuator hyq --delay 0.005 --gain-scale 3
      jaxact render --spec robot.toml --set gain_scale=3 --speed 0.2 --out robots.mp4
      jaxact render --model robot.xml --bare bare.npz --drive drive.npz
    """
    given = _arguments.given(parameters)
    from jaxact.loops.building import loop_of
    from jaxact.loops.building import robot as robot_of
    from jaxact.verbs import render

    options: dict[str, Any] = {}
    if render.files_of(film.bare, film.drive) is not None:
        if robot.model is None:
            raise UserError("--bare and --drive need the robot that moves: give its --model")
        _refuse(robot, given)
        # of a base that is fixed or held, the keyframe says where
        loop = robot_of(robot.model, keyframe=robot.keyframe, **_arguments.mounted(base=robot.base))
    else:
        until = film.start + (film.duration or render.SIMULATED)
        static = {"engine": robot.engine, "seed": robot.seed, "duration": until}
        pushed = robot.push and {"body": robot.push[0], "impulse": list(robot.push[1:])}
        asked = simulate.specified(robot, given, static, push=pushed)
        if asked.plant is None:
            raise UserError(
                "there is no robot to film; give its --model, or a --spec with a [plant]"
            )
        loop = loop_of(asked)
        options = {"engine": asked.engine, "precision": asked.precision, "seed": asked.seed}
    _warnings.gains(loop.kind.plant)
    made = render.render(loop, out, **vars(film), **options)
    for line in made.outcomes:
        print(line)
    if made.caption:
        _warnings.warn(made.caption)
    print(f"wrote {out}")


def _refuse(robot: Robot, given: dict[str, Any]) -> None:
    """Raise UserError for options of a simulation where none is made."""
    placed = robot.keyframe if robot.base is None else None
    others = (robot.spec, robot.push, robot.engine, robot.damping, robot.friction,
              robot.gains, placed)  # fmt: skip
    if given or robot.set or any(one is not None for one in others):
        first = _arguments.typed(next(iter(given))) if given else "the others"
        raise UserError(
            f"--bare and --drive are motions simulated earlier, which {first} cannot change; "
            "leave out one or the other"
        )
