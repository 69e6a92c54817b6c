"""`jaxact.render`: a film of a robot twice, bare and with its drives."""

from __future__ import annotations

import dataclasses
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.engines import best_precision
from jaxact.errors import UserError
from jaxact.loops.samples import Samples, explicit
from jaxact.loops.specification import Specification
from jaxact.parameters import (
    DELAYS,
    ERRORS,
    FORCE_RATE_LIMIT,
    NO_LOAD_SPEED,
    PARAMETERS,
    POLICY_RATE,
    STALL_FORCE,
    VELOCITY_FILTER,
    WN,
    ZETA,
    base,
)

if TYPE_CHECKING:
    from jaxact.loops.control_loop import ControlLoop
    from jaxact.plotting.film import Motion
    from jaxact.robots.robot import Robot
    from jaxact.simulation.single import Single

LABELS = "bare: ideal actuators", "with the drive model"
MOST_FRAMES = 3000
SIMULATED = 2.0
"""What is simulated and shown [s] where nothing else is asked for."""
SIZES = range(64, 1921)
"""Of one half of the picture [pixels]."""
# What a drive is, at its defaults: an ideal actuator, no delays, perfect sensors and converters.
# What limits the force is the robot's and stays.
_OF_DRIVE = (
    WN, ZETA, *DELAYS, *ERRORS, VELOCITY_FILTER, POLICY_RATE, FORCE_RATE_LIMIT, STALL_FORCE,
    NO_LOAD_SPEED,
)  # fmt: skip


@dataclass(frozen=True)
class Film:
    """What was filmed.

    Attributes:
        path: of the film.
        outcomes: a line on each of the two motions that were simulated; () where files were shown.
        caption: that links are drawn as boxes, and why; "" where all have a shape.
    """

    path: Path
    outcomes: tuple[str, ...]
    caption: str


def render(
    loop: ControlLoop,
    out: str | os.PathLike[str],
    *,
    bare: str | os.PathLike[str] | None = None,
    drive: str | os.PathLike[str] | None = None,
    labels: tuple[str, str] = LABELS,
    start: float = 0.0,
    duration: float | None = None,
    speed: float = 1.0,
    fps: float = 25.0,
    size: tuple[int, int] = (480, 360),
    azimuth: float = 130.0,
    elevation: float = -15.0,
    distance: float | None = None,
    engine: str = "auto",
    precision: str | None = None,
    seed: int = 0,
) -> Film:
    """Film a robot twice, side by side: bare on the left, with its drives on the right.

        jaxact.render(jaxact.robot("go1.xml", keyframe="home", delay=5e-3), "go1.gif")

    The bare one has ideal actuators, no delays, no noise, quantisation or bias. Below each runs the
    speed of its joints (root mean square), on one scale for both.

    Args:
        loop: of a robot, a single one.
        out: film to write, .gif, or .mp4 where ffmpeg is; one that is there is replaced.
        bare, drive: NPZ files with `time` [s], shape (steps,), and `qpos`, shape (steps, nq): the
            motions, which are not simulated then; both or none.
        labels: above the two motions.
        start: where the film starts [s].
        duration: of what is simulated and shown [s]; None: 2 s, or all of a file.
        speed: 1 for real time, 0.25 for four times slower.
        fps: frames per second.
        size: width and height of each of the two pictures [pixels].
        azimuth, elevation: direction that the camera looks along [deg].
        distance: of the camera from the robot, which it follows [m]; None: all of it is seen.
        engine, precision, seed: as for `jaxact.simulate`.

    Raises:
        UserError: options that make no sense, a file that does not fit, or no OpenGL.
    """
    from jaxact.plotting import scene, video

    path = Path(out)
    _check(speed, fps, size, distance, duration)
    video.check_output(path, fps)
    files = files_of(bare, drive)
    plant = loop.kind.plant
    if plant is None or loop.shape:
        raise UserError("a film is of a single loop of a robot; make one with jaxact.robot(...)")
    shown = duration or SIMULATED
    if files is not None:
        motions = [_cut(load_motion(f, name), str(f), start, duration)
                   for f, name in zip(files, labels, strict=True)]  # fmt: skip
        shown = min(float(motion.time[-1] - motion.time[0]) for motion in motions)
    _check_length(shown * fps / speed)
    module = scene.backend()

    from jaxact.loops import robots
    from jaxact.plotting.film import film
    from jaxact.robots.model import read

    outcomes: tuple[str, ...] = ()
    if files is None:
        robot = robots.scene(plant).robot
        options = {"engine": engine, "seed": seed, "duration": start + shown}
        options["precision"] = precision or best_precision(engine)
        motions, outcomes = _simulated(loop, options, labels, start)
    else:
        robot = read(plant.model, keyframe=plant.keyframe, base=plant.base, damping=plant.damping)
        _demand_fit(motions, files, robot.model.nq, plant.model)
    view = scene.View(size[0], size[1], azimuth, elevation, distance)
    below, caption = _shapeless(robot)
    images = film(
        robot.model, *motions, module=module, view=view, fps=fps, speed=speed, caption=below
    )
    video.write(images, path, fps=fps)
    return Film(path, outcomes, caption)


def files_of(
    bare: str | os.PathLike[str] | None, drive: str | os.PathLike[str] | None
) -> list[Path] | None:
    """The files of both motions, None where they are to be simulated.

    Raises:
        UserError: only one of them is given.
    """
    if bare is None and drive is None:
        return None
    if bare is None or drive is None:
        given, missing = ("bare", "drive") if drive is None else ("drive", "bare")
        raise UserError(f"`{given}` needs `{missing}`; or give neither, and both are simulated")
    return [Path(bare), Path(drive)]


def load_motion(path: Path, label: str) -> Motion:
    """The motion in an NPZ file.

    Raises:
        UserError: there is no such file, or what it holds is not a motion.
    """
    from jaxact.plotting.film import Motion

    if not path.is_file():
        raise UserError(f"{path}: no such file")
    try:
        with np.load(path, allow_pickle=False) as file:
            missing = [name for name in ("time", "qpos") if name not in file]
            if missing:
                raise UserError(f"{path}: has no '{missing[0]}'; write it with jaxact simulate")
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


def _check(
    speed: float,
    fps: float,
    size: tuple[int, int],
    distance: float | None,
    duration: float | None,
) -> None:
    positive = {"speed": speed, "fps": fps, "distance": distance, "duration": duration}
    for name, value in positive.items():
        if value is not None and not 0.0 < value < float("inf"):
            raise UserError(f"`{name}` {value:g}: must be a positive number")
    if size[0] not in SIZES or size[1] not in SIZES:
        raise UserError(
            f"`size` {size[0]} {size[1]}: each from {SIZES[0]} to {SIZES[-1]} pixels, please"
        )


def _check_length(frames: float) -> None:
    if frames > MOST_FRAMES:
        raise UserError(
            f"the film would have {frames:.0f} frames (at most {MOST_FRAMES}); give a `duration`, "
            "a lower `fps` or a higher `speed`"
        )


def _simulated(
    loop: ControlLoop, options: dict[str, Any], labels: tuple[str, str], start: float
) -> tuple[list[Motion], tuple[str, ...]]:
    """Both motions from their start, and a line on each of what came out."""
    from jaxact.loops import conversion
    from jaxact.plotting.film import Motion
    from jaxact.simulation import engines
    from jaxact.status import Verdict

    asked = engines.resolved(conversion.specification(loop, **options))
    motions, outcomes = [], []
    for label, run in zip(labels, _runs(asked), strict=True):
        path = run.trajectory
        assert path.configuration is not None
        ticks = path.time[:: len(path.time) // len(path.configuration)]
        motions.append(_cut(Motion(label, ticks, path.configuration), label, start, None))
        rate, verdict = run.results["growth_rate"], Verdict(int(run.results["verdict"]))
        outcomes.append(f"{label}: {verdict.label}, growth rate {rate:.3g} 1/s")
    return motions, tuple(outcomes)


def _runs(specification: Specification) -> list[Single]:
    """What the two loops of `pair` did; an ideal drive has its velocity from a sensor."""
    from jaxact.simulation import single

    both = pair(specification)
    if specification.velocity == "sampled":
        return single.simulate_all(specification, both)
    ideal = dataclasses.replace(specification, velocity="sampled")
    return [
        run
        for place, one in enumerate((ideal, specification))
        for run in single.simulate_all(one, _alone(both, place))
    ]


def _alone(samples: Samples, place: int) -> Samples:
    """One of several samples, with its own random numbers."""
    along = {name: np.array([values[place]]) for name, values in samples.values.items()}
    first = samples.first + place
    return dataclasses.replace(samples, along=along, shape=(1,), coords={}, first=first)


def pair(specification: Specification) -> Samples:
    """Two loops: the nominal one of a specification without its drive, and the same as it is.

    Args:
        specification: checked; both have its gains, setpoint, push and random numbers.
    """
    columns = {}
    for key, value in specification.nominal.items():
        name, some = base(key), "@" in key
        if name in _OF_DRIVE:
            # of some joints only: nothing of their own, so that what holds for all counts
            columns[key] = np.array([math.nan if some else PARAMETERS[name].default, value])
    return explicit(specification, columns)


def _cut(motion: Motion, path: str, start: float, duration: float | None) -> Motion:
    """What is shown of a motion."""
    from jaxact.plotting.film import Motion

    end = motion.time[-1] if duration is None else start + duration
    kept = (motion.time >= start - 1e-9) & (motion.time <= end + 1e-9)
    if np.count_nonzero(kept) < 2:
        raise UserError(
            f"{path}: lasts from {motion.time[0]:g} to {motion.time[-1]:g} s; `start` and "
            "`duration` leave nothing of it"
        )
    return Motion(motion.label, motion.time[kept], motion.qpos[kept])


def _demand_fit(motions: list[Motion], files: list[Path], size: int, model: Path) -> None:
    """Raise UserError for a file that is not of this robot."""
    for motion, path in zip(motions, files, strict=True):
        columns = motion.qpos.shape[1]
        if columns != size:
            raise UserError(f"{path}: qpos has {columns} columns, {model} has {size} positions")


def _shapeless(robot: Robot) -> tuple[str, str]:
    """What a film says below it where links are drawn as boxes, and why; "" twice for none."""
    from jaxact.plotting.stand_ins import stand_ins
    from jaxact.robots.assets import MISSING

    found = stand_ins(robot.model)
    if not len(found.bodies):
        return "", ""
    count = f"{len(found.bodies)} of {found.links}" if len(found.bodies) < found.links else "all"
    caption = f"{count} links drawn as the boxes that have their inertia"
    lost = [item.value for item in robot.findings if item.field == MISSING]
    none = "the model has no shapes for them"
    why = f"files are missing: {lost[0]}" if lost else none
    return f"{caption}: {'mesh files are missing' if lost else none}", f"{caption} ({why})"
