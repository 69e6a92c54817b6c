"""The loops that the options name: of a joint, of a file, or of a robot."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxact import engines
from jaxact.cli import _arguments, _warnings
from jaxact.cli._arguments import typed
from jaxact.errors import UserError
from jaxact.loops import anew, drives
from jaxact.loops.drives import DRIVE, IdentifiedDrive
from jaxact.parameters import (
    CONTROL_RATE,
    FEEDFORWARD,
    GAIN_SCALE,
    INERTIA,
    INITIAL_POSITION,
    INITIAL_VELOCITY,
    JOINT_DAMPING,
    JOINT_FRICTION,
    LINEAR,
    MASS,
    PARAMETERS,
    PRESETS,
    REST_AMPLITUDE,
    SETPOINT,
    WN,
    ZETA,
    mass_word,
    of,
)

if TYPE_CHECKING:
    from jaxact.loops.control_loop import ControlLoop
    from jaxact.loops.specification import Specification

# Every option takes several values: all combinations are meant.
Linear = _arguments.parameters((*LINEAR, CONTROL_RATE), several=True)
# Parameters that a picture of linear loops, or their margins, need not mention: what the loop
# starts from, how far it goes, and what shifts it without changing how it responds.
_NO_MATTER = (
    GAIN_SCALE, SETPOINT, INITIAL_POSITION, INITIAL_VELOCITY, REST_AMPLITUDE,
)  # fmt: skip


def joints(chosen: Any, file: Path | None, velocity: str | None) -> ControlLoop:
    """Every combination of the values of the options, or the loops of a file.

    Args:
        chosen: options of parameters with several values each.
        file: of loops, None for none; then the options say what its loops do not say themselves.
        velocity: "sampled", or "differenced"; None for that of the drive or of the file.

    Raises:
        UserError: values that make no sense, or several where a file lists the loops.
    """
    import numpy as np

    from jaxact.loops.building import joint, loop_of

    given = _arguments.given(chosen)
    drive = {DRIVE: found} if (found := identified(given.pop(DRIVE, None), given)) else {}
    several = [name for name, values in given.items() if len(values) > 1]
    if "unit" in several:
        raise UserError("--unit: give one")
    if file is not None:
        if several:
            raise UserError(f"{typed(several[0])}: give one value, {file} lists the loops")
        alone = {name: values[0] for name, values in given.items()}
        return loop_of(file, velocity=velocity, **drive, **alone)  # type: ignore[arg-type]
    for name in several:
        if len(set(given[name])) < len(given[name]):
            raise UserError(f"{typed(name)} has the same value more than once; give each once")
    grid = np.ix_(*(np.arange(len(given[name])) for name in several))
    spread = {
        name: np.asarray(given[name], object if name == "actuator" else float)[places]
        for name, places in zip(several, grid, strict=True)
    }
    alone = {name: values[0] for name, values in given.items()}
    return joint(velocity=velocity, **drive, **alone | spread)  # type: ignore[arg-type]


def identified(
    file: Path | None, given: Collection[str], *, robot: bool = False
) -> IdentifiedDrive | None:
    """The identified drive in a file, None without one; what it cannot say here is warned of.

    Args:
        file: of `jaxact identify`.
        given: parameters that are given beside it.
        robot: whether the loop is a robot's.

    Raises:
        UserError: the file is not a drive.
    """
    if file is None:
        return None
    found = drives.load_drive(file)
    if left_out := found.left_out(robot=robot):
        _warnings.warn(f"{found.name}: left out here: {', '.join(left_out)}")
    if robot and found.plant != drives.ROBOT:
        rubbing = {JOINT_DAMPING, JOINT_FRICTION} & set(found.parameters(robot=True)) - set(given)
        if rubbing:
            _warnings.warn(
                f"{found.name}: its {' and '.join(sorted(rubbing))} are added to every driven"
                " joint's own damping and frictionloss, which may hold the same friction already"
            )
    if not robot and MASS not in found.joint and not {MASS, INERTIA} & set(given):
        word, size = mass_word(found.unit), of(MASS, found.unit)
        _warnings.warn(
            f"{found.name}: does not say what the joint moves; taken: {size.default:g} {size.unit};"
            f" give {typed(word)}"
        )
    if not robot and found.per_inertia and not {MASS, INERTIA} & set(given):
        _warnings.warn(
            f"{found.name}: gains and friction are per unit of an inertia that is not known, here"
            f" 1; give {typed(mass_word(found.unit))}"
        )
    if found.level == drives.NOT_ENOUGH:
        _warnings.warn(f"{found.name}: the logs that it was not fitted to call it {found.level}")
    return found


def linear(chosen: Any, file: Path | None, velocity: str | None) -> ControlLoop:
    """As `joints`, of loops that are looked at as linear ones.

    Raises:
        UserError: options that have no effect on any of the loops.
    """
    import numpy as np

    loop = joints(chosen, file, velocity)
    if file is None and CONTROL_RATE not in loop.values:
        check_continuous(loop)
    left_out = sorted(
        name for name, value in loop.values.items()
        if name not in (*LINEAR, CONTROL_RATE, *_NO_MATTER)
        and np.any(value != PARAMETERS[name].default)
    )  # fmt: skip
    if left_out:
        _warnings.warn(f"linear loops are without {', '.join(left_out)}: left out here")
    return loop


def check_continuous(loop: ControlLoop) -> None:
    """Raise UserError where differencing would be ignored in continuous time."""
    import numpy as np

    if loop.kind.velocity == "differenced" and np.all(np.isinf(loop.velocity_filter)):
        raise UserError(
            "--velocity differenced: has no effect in continuous time without a filter; add"
            " --control-rate or --velocity-filter"
        )


def specified(
    robot: _arguments.Robot,
    given: Mapping[str, Any],
    static: Mapping[str, Any],
    *,
    defaults: Mapping[str, Any] | None = None,
    push: Mapping[str, Any] | None = None,
) -> Specification:
    """The checked specification of the options: the file, then the options, then --set.

    Args:
        robot: which one, or the file; neither for a joint.
        given: parameter (or `actuator`) -> its value, or a tuple of values, which are an axis then.
        static: options of the whole specification; None is not given.
        defaults: values of static options, used where there is no file.
        push: keys of the push, None where none was given.

    Raises:
        UserError: what does not fit; its message names the option.
    """
    from jaxact.loops import reading, toml  # slow to import

    given = dict(given)
    file = given.pop(DRIVE, None)
    if robot.spec is None:
        if robot.set and robot.model is None:
            raise UserError(
                "--set changes a specification; give one with --spec, or use the options"
            )
        base: dict[str, Any] = dict(defaults or {})
    else:  # what it varies is left at its nominal value
        base = reading.load(robot.spec, ["axes.feedforward=[0.0]"], file).document
        file = file or drives.named_by(robot.spec)
    own = base.pop("parameters", {})
    own = {name: value for name, value in own.items() if not anew.replaced(name, given)}
    if "actuator" in given:
        own = {name: value for name, value in own.items() if name not in (WN, ZETA)}
    elif {WN, ZETA} & set(given) and "actuator" in own:
        # of a preset, so that one of the two can be given otherwise
        own |= dict(zip((WN, ZETA), PRESETS[own.pop("actuator")], strict=True))
    values = {n: v if isinstance(v, tuple) else (v,) for n, v in given.items()}
    fixed = {name: value[0] for name, value in values.items() if len(value) == 1}
    varied = {name: list(value) for name, value in values.items() if len(value) > 1}
    plant = base.pop("plant", {}) | robot.plant
    _check_engine(static.get("engine"), robot.set, robot=bool(plant))
    document = base | {name: value for name, value in static.items() if value is not None}
    document |= {"plant": plant} if plant else {}
    document |= {} if push is None else {"push": dict(push)}
    document |= {
        "parameters": {name: value for name, value in own.items() if name not in varied} | fixed,
        "axes": varied or {FEEDFORWARD: [0.0]},
    }
    document.pop("sampling", None)
    if file is not None:
        identified(file, {**own, **given}, robot=bool(plant))
        document |= {} if robot.spec else {DRIVE: str(file.resolve())}
    try:
        return reading.parse(toml.dumps(document), overrides=robot.set)
    except UserError as error:
        own = "|".join(robot.plant) or "plant"
        keys = rf"\b(?:(?:parameters|axes)\.(\w+)|plant\.({own})\b)"
        said = re.sub(keys, lambda found: typed(found[1] or found[2]), str(error))
        if said.startswith("--"):  # relative to where one is
            said = said.replace(" (relative to the specification)", "")
        raise UserError(said) from None


def _check_engine(given: Any, changes: Sequence[str], *, robot: bool) -> None:
    """Raise UserError for an unknown engine of an option or of --set, where loops are simulated."""
    parts = [change.partition("=") for change in changes]
    names = [value.strip(" '\"") for key, _, value in parts if key.strip() == "engine"]
    for name in (given, *names):
        engines.check_name(name, robot=robot)


def of_robot(
    robot: _arguments.Robot,
    given: Mapping[str, Any],
    velocity: str | None,
    *,
    engine: str | None = None,
) -> Specification:
    """As `specified`, of a robot that is linearised.

    Args:
        velocity: None leaves a file, or a drive, its own.

    Raises:
        UserError: without a robot, and as `specified`.
    """
    for name in (MASS, INERTIA, "unit"):
        if name in given:
            raise UserError(
                f"--{name}: a robot's masses and units are its model's; change the masses with"
                " --set payload="
            )
    found = specified(robot, given, {"engine": engine, "velocity": velocity})
    if found.plant is None:
        raise UserError(f"{robot.spec}: has no [plant] model; give a robot with --model")
    return found


def postures(robot: Any, given: dict[str, Any], velocity: str | None) -> list[ControlLoop]:
    """The loop of a robot in every posture, each with its name.

    Args:
        robot: `jaxact.cli.tune.Robot`.
        given: parameter (or `actuator`) -> its value.
        velocity: as for `of_robot`.

    Raises:
        UserError: postures given twice or both ways, and as `specified`.
    """
    if len(set(robot.keyframe)) < len(robot.keyframe):
        raise UserError("--keyframe: the same one is given twice")
    if robot.spec:
        for name in ("model", "keyframe"):
            if getattr(robot, name):
                raise UserError(f"--{name}: is in the specifications of --spec")
        named = [(path.stem, robot.one(spec=path)) for path in robot.spec]
        for name, _ in named:
            if [other for other, _ in named].count(name) > 1:
                raise UserError(f"--spec: two files are called {name}; name them differently")
    else:
        named = [
            (key or robot.model.stem, robot.one(model=robot.model, keyframe=key))
            for key in robot.keyframe or (None,)
        ]
    asked = [(name, of_robot(one, given, velocity)) for name, one in named]

    from jaxact.loops.building import loop_of

    return [loop_of(one).named(name) for name, one in asked]
