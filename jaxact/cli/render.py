"""`jaxact render`: a film of a robot, bare and with the drive."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro
from tyro.conf import OmitArgPrefixes, UseAppendAction

from jaxact.cli import _loops, _mounting, _single, _warnings
from jaxact.errors import UserError
from jaxact.parameters import PARAMETERS

if TYPE_CHECKING:
    from jaxact.loops.specification import Specification
    from jaxact.plotting.film import Motion
    from jaxact.robots.robot import Robot

Parameters = _loops.options(PARAMETERS, several=False)
MOST_FRAMES = 3000
SIMULATED = 2.0  # seconds, where nothing else is asked for
SIZES = range(64, 1921)  # of one half of the picture [pixels]


def main(
    parameters: Annotated[Parameters, OmitArgPrefixes] = Parameters(),  # type: ignore[valid-type] # noqa: B008
    *,
    model: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE",
            help="MJCF or URDF file of the robot.",
            help_behavior_hint="(default: the specification's)",
        ),
    ] = None,
    keyframe: Annotated[
        str | None,
        tyro.conf.arg(
            metavar="NAME",
            help="Keyframe of the model to start from.",
            help_behavior_hint="(default: the model's default posture)",
        ),
    ] = None,
    base: _mounting.Base = None,
    damping: _mounting.Damping = None,
    friction: _mounting.Friction = None,
    spec: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE",
            help="Specification of a sweep to start from: its fixed values are taken.",
            help_behavior_hint="(default: none)",
        ),
    ] = None,
    set: Annotated[  # noqa: A002 - the option's name
        UseAppendAction[tuple[str, ...]],
        tyro.conf.arg(metavar="KEY=VALUE", help="Change the specification; as for `jaxact sweep`."),
    ] = (),
    push: Annotated[
        tuple[str, float, float, float] | None,
        tyro.conf.arg(
            metavar="BODY X Y Z",
            help="Impulse on a body [N s], 0.1 s after the start.",
            help_behavior_hint="(default: the specification's, or none)",
        ),
    ] = None,
    engine: Annotated[
        str | None,
        tyro.conf.arg(
            metavar="mjx|mujoco|warp|auto",
            help="MuJoCo in JAX, in C, in Warp, or the fastest one.",
            help_behavior_hint="(default: auto)",
        ),
    ] = None,
    seed: Annotated[
        int,
        tyro.conf.arg(metavar="NUMBER", help="Of the noise.", help_behavior_hint="(default: 0)"),
    ] = _loops.UNSET_NUMBER,
    bare: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE",
            help="Nothing is simulated; motion on the left: NPZ file with `time` [s] and `qpos`, "
            "as `jaxact simulate --npz` writes it.",
            help_behavior_hint="(default: simulated)",
        ),
    ] = None,
    drive: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE",
            help="Motion on the right: as for --bare.",
            help_behavior_hint="(default: simulated)",
        ),
    ] = None,
    labels: Annotated[
        tuple[str, str], tyro.conf.arg(metavar="TEXT TEXT", help="Above the two motions.")
    ] = ("bare: ideal actuators", "with the drive model"),
    speed: Annotated[
        float,
        tyro.conf.arg(metavar="FACTOR", help="1 for real time, 0.25 for four times slower."),
    ] = 1.0,
    start: Annotated[
        float, tyro.conf.arg(metavar="SECONDS", help="Where the film starts [s].")
    ] = 0.0,
    duration: Annotated[
        float | None,
        tyro.conf.arg(
            metavar="SECONDS",
            help="How much of the motion is simulated and shown [s].",
            help_behavior_hint=f"(default: all of a file, {SIMULATED:g} s otherwise)",
        ),
    ] = None,
    fps: Annotated[
        float, tyro.conf.arg(metavar="RATE", help="Frames per second of the film.")
    ] = 25.0,
    size: Annotated[
        tuple[int, int],
        tyro.conf.arg(metavar="WIDTH HEIGHT", help="Of each of the two pictures [pixels]."),
    ] = (480, 360),
    azimuth: Annotated[
        float, tyro.conf.arg(metavar="DEGREES", help="Direction the camera looks along.")
    ] = 130.0,
    elevation: Annotated[
        float, tyro.conf.arg(metavar="DEGREES", help="Of that direction; negative looks down.")
    ] = -15.0,
    distance: Annotated[
        float | None,
        tyro.conf.arg(
            metavar="METRES",
            help="Of the camera from the robot, which it follows.",
            help_behavior_hint="(default: the whole robot is seen)",
        ),
    ] = None,
    out: Annotated[
        Path,
        tyro.conf.arg(
            metavar="FILE",
            help="Film to write: .gif, or .mp4 where ffmpeg is; one that is there is replaced.",
        ),
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
    _check(speed, fps, size, distance, duration)

    from jaxact.plotting import scene, video

    video.check_output(out, fps)
    files = _files_of(bare, drive, model)
    asked = _loops.given(parameters)
    if files is None:
        static = {"engine": engine, "seed": seed, "duration": start + (duration or SIMULATED)}
        plant = {"model": model, "keyframe": keyframe}
        plant = {name: str(value) for name, value in plant.items() if value is not None}
        robotic = model is not None or spec is not None
        plant |= _mounting.chosen(base, damping, friction, robot=robotic)
        chosen = _specification(spec, set, static, plant, asked, push)
        model, shown = chosen.model, duration or SIMULATED
    else:
        placed = keyframe if base is None else None
        _refuse(asked, spec, set, push, engine, damping, friction, placed)
        motions = _loaded(files, labels, start, duration)
        shown = min(float(motion.time[-1] - motion.time[0]) for motion in motions)
    _check_length(shown * fps / speed)
    module = scene.backend()

    from jaxact.loops import robots
    from jaxact.plotting.film import film
    from jaxact.robots.model import read

    if files is None:
        robot = robots.scene(chosen.plant).robot
    else:  # of a base that is fixed or held, the keyframe says where
        robot = read(model, keyframe=keyframe, **_mounting.chosen(base, None))
    if files is None:
        motions = _simulated(chosen, labels, start)
    else:
        _demand_fit(motions, files, robot.model.nq, model)
    view = scene.View(size[0], size[1], azimuth, elevation, distance)
    caption = _shapeless(robot)
    images = film(
        robot.model, *motions, module=module, view=view, fps=fps, speed=speed, caption=caption
    )
    video.write(images, out, fps=fps)
    print(f"wrote {out}")


def _shapeless(robot: Robot) -> str:
    """A caption, and a line on standard error, where links are drawn as boxes; "" for none."""
    from jaxact.plotting.stand_ins import stand_ins
    from jaxact.robots.assets import MISSING

    found = stand_ins(robot.model)
    if not len(found.bodies):
        return ""
    count = f"{len(found.bodies)} of {found.links}" if len(found.bodies) < found.links else "all"
    caption = f"{count} links drawn as the boxes that have their inertia"
    lost = [item.value for item in robot.findings if item.field == MISSING]
    why = f"files are missing: {lost[0]}" if lost else "the model has no shapes for them"
    _warnings.warn(f"{caption} ({why})")
    return f"{caption}: {'mesh files are missing' if lost else 'the model has no shapes for them'}"


def _loaded(
    files: list[Path], labels: tuple[str, str], start: float, duration: float | None
) -> list[Motion]:
    """What is shown of the motions in two files."""
    pairs = zip(files, labels, strict=True)
    return [_cut(_motion(path, label), str(path), start, duration) for path, label in pairs]


def _refuse(asked: dict[str, Any], *others: Any) -> None:
    """Raise UserError for options of a simulation where none is made."""
    if asked or any(one is not None and one != () for one in others):
        first = f"--{next(iter(asked)).replace('_', '-')}" if asked else "the others"
        raise UserError(
            f"--bare and --drive are motions simulated earlier, which {first} cannot change; "
            "leave out one or the other"
        )


def _demand_fit(motions: list[Motion], files: list[Path], size: int, model: Path) -> None:
    """Raise UserError for a file that is not of this robot."""
    for motion, path in zip(motions, files, strict=True):
        columns = motion.qpos.shape[1]
        if columns != size:
            raise UserError(f"{path}: qpos has {columns} columns, {model} has {size} positions")


def _files_of(bare: Path | None, drive: Path | None, model: Path | None) -> list[Path] | None:
    """The files of both motions, None where they are to be simulated."""
    if bare is None and drive is None:
        return None
    if bare is None or drive is None:
        given, missing = ("--bare", "--drive") if drive is None else ("--drive", "--bare")
        raise UserError(f"{given} needs {missing}; or give neither, and both are simulated")
    if model is None:
        raise UserError("--bare and --drive need the robot that moves: give its --model")
    return [bare, drive]


def _specification(
    path: Path | None,
    overrides: tuple[str, ...],
    static: dict[str, Any],
    plant: dict[str, str],
    given: dict[str, Any],
    push: tuple[str, float, float, float] | None,
) -> Specification:
    """The loop with its drive."""
    asked = {name: value for name, value in static.items() if _loops.is_given(value)}
    pushed = None if push is None else {"body": push[0], "impulse": list(push[1:])}
    found = _single.specification(path, overrides, asked, plant, given, push=pushed)
    if found.plant is None:
        raise UserError("there is no robot to film; give its --model, or a --spec with a [plant]")
    return found


def _simulated(specification: Specification, labels: tuple[str, str], start: float) -> list[Motion]:
    """Both motions from their start, and a line on each of what came out."""
    from jaxact.plotting.film import Motion
    from jaxact.simulation import engines, single
    from jaxact.status import Verdict
    from jaxact.sweeping.without_drive import pair

    specification = engines.resolved(specification)
    motions = []
    runs = single.simulate_all(specification, pair(specification))
    for label, run in zip(labels, runs, strict=True):
        path = run.trajectory
        ticks = path.time[:: len(path.time) // len(path.configuration)]
        motions.append(_cut(Motion(label, ticks, path.configuration), label, start, None))
        rate, verdict = run.results["growth_rate"], Verdict(int(run.results["verdict"]))
        print(f"{label}: {verdict.label}, growth rate {rate:.3g} 1/s")
    return motions


def _check(
    speed: float,
    fps: float,
    size: tuple[int, int],
    distance: float | None,
    duration: float | None,
) -> None:
    positive = {"--speed": speed, "--fps": fps, "--distance": distance, "--duration": duration}
    for name, value in positive.items():
        if value is not None and not 0.0 < value < float("inf"):
            raise UserError(f"{name} {value:g}: must be a positive number")
    if size[0] not in SIZES or size[1] not in SIZES:
        raise UserError(
            f"--size {size[0]} {size[1]}: each from {SIZES[0]} to {SIZES[-1]} pixels, please"
        )


def _check_length(frames: float) -> None:
    if frames > MOST_FRAMES:
        raise UserError(
            f"the film would have {frames:.0f} frames (at most {MOST_FRAMES}); give a --duration, "
            "a lower --fps or a higher --speed"
        )


def _motion(path: Path, label: str) -> Motion:
    """The motion in an NPZ file.

    Raises UserError if there is no such file, or what it holds is not a motion.
    """
    from jaxact.plotting.film import Motion

    if not path.is_file():
        raise UserError(f"{path}: no such file")
    try:
        with np.load(path, allow_pickle=False) as file:
            missing = [name for name in ("time", "qpos") if name not in file]
            if missing:
                raise UserError(f"{path}: has no `{missing[0]}`; write it with jaxact simulate")
            time, qpos = (np.asarray(file[name], float) for name in ("time", "qpos"))
    except (ValueError, OSError, EOFError, TypeError) as error:
        raise UserError(f"{path}: is not an NPZ file of numbers ({error})") from error
    if time.ndim == 1 and qpos.ndim == 2 and len(qpos) > 0 and len(time) % len(qpos) == 0:
        # times of the physics steps, positions at the control ticks
        time = time[:: max(len(time) // len(qpos), 1)]
    if time.ndim != 1 or qpos.ndim != 2 or len(time) != len(qpos) or len(time) < 2:
        raise UserError(
            f"{path}: time has shape {time.shape} and qpos {qpos.shape}; (steps,) and (steps, nq) "
            "with two steps or more are needed"
        )
    if not (np.isfinite(time).all() and (np.diff(time) > 0.0).all()):
        raise UserError(f"{path}: its times do not increase")
    if not np.isfinite(qpos[0]).all():
        raise UserError(f"{path}: the motion is not finite from its start")
    return Motion(label, time, qpos)


def _cut(motion: Motion, path: str, start: float, duration: float | None) -> Motion:
    from jaxact.plotting.film import Motion

    end = motion.time[-1] if duration is None else start + duration
    kept = (motion.time >= start - 1e-9) & (motion.time <= end + 1e-9)
    if np.count_nonzero(kept) < 2:
        raise UserError(
            f"{path}: lasts from {motion.time[0]:g} to {motion.time[-1]:g} s; --start and "
            "--duration leave nothing of it"
        )
    return Motion(motion.label, motion.time[kept], motion.qpos[kept])
