"""Identified drives, as `jaxact identify` writes them: the one place where their numbers become
the parameters of a loop.

    drive = "drive.toml"     # of a specification or a [[loop]], relative to the folder of the file

What the loop says itself wins. Nothing here needs JAX, and few functions need NumPy: the command
line declares its options with this module.
"""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from jaxact.errors import UserError
from jaxact.loops import per_inertia
from jaxact.loops.model_numbers import parameters_of
from jaxact.loops.spread import Spread
from jaxact.loops.unmodelled import UNMODELLED
from jaxact.parameters import (
    DELAY,
    FORCE_LIMIT,
    GAIN_SCALE,
    INERTIA,
    JOINT_DAMPING,
    JOINT_FRICTION,
    JOINT_STIFFNESS,
    KD,
    KP,
    MASS,
    PARAMETERS,
    WN,
    ZETA,
    base,
    check,
    known,
)
from jaxact.units import UNITS

DRIVE = "drive"
"""The key of a specification, and the argument of a loop, that names an identified drive."""
ROBOT = "robot"
"""The plant of drives that were identified on the joints of a robot."""
DIFFERENCE_TICKS = "difference_ticks"
"""The key of a drive's file, and of a map: over how many rows positions were differenced."""
NOT_ENOUGH = "not good enough"
"""The verdict on a drive that should not be used."""
# What a joint of a robot has from its model, and not from the bench on which its drive was.
_OF_BENCH = (MASS, KP, KD, JOINT_STIFFNESS)


@dataclass(frozen=True)
class IdentifiedDrive:
    """An identified drive, in front of the joint that it was identified on.

    Attributes:
        name: of its file.
        plant: on which it was identified, "none" where its force was measured.
        unit: of the joint's position, "rad" or "m".
        level: of the verdict, such as "good".
        joint: parameters of the loop by short name.
        numbers: of the model by name, without those that change nothing.
        intervals: 95 % intervals of the model's numbers by name.
        spread: of the model's numbers together; None where the file has none.
        document: everything.
    """

    name: str
    plant: str
    unit: str
    level: str
    joint: Mapping[str, float]
    numbers: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    spread: Spread | None = None
    document: Mapping[str, Any] = field(default_factory=dict, repr=False)

    @property
    def velocity(self) -> str | None:
        """That its log's controller saw, if of "differenced" positions; None where not said."""
        return "differenced" if self.document.get(DIFFERENCE_TICKS) else None

    @property
    def per_inertia(self) -> bool:
        """Whether gains and friction are per unit of an inertia that is not known: 1 in its place.

        Gains are among the numbers where a log had neither them nor a command.
        """
        return KP in self.numbers and self.numbers.get("inertia", 1.0) == 1.0

    def moving(self, own: Mapping[str, Any]) -> IdentifiedDrive:
        """The same drive in front of the joint that a loop describes itself.

        What is known per unit of an inertia is multiplied by that of the loop.

        Args:
            own: parameters of the loop by short name.

        Raises:
            UserError: the loop gives a force of its own, and no inertia.
        """
        if not self.per_inertia:
            return self
        if MASS not in own:
            per_inertia.demand_inertia(self.name, own)
            return self
        whole = per_inertia.multiplied(self.joint, own[MASS] / self.joint.get(MASS, 1.0))
        return replace(self, joint={**whole, MASS: own[MASS]})

    def parameters(self, *, robot: bool = False) -> dict[str, float]:
        """What the drive says of a loop, by short name.

        Args:
            robot: of a robot, whose own inertias, springs and gains stay; else of the joint on
                which the drive was identified.

        Raises:
            UserError: the drives are those of a robot's joints, and the loop is not a robot's.
        """
        if self.plant == ROBOT and not robot:
            raise UserError(f"{self.name}: has the drives of a robot's joints; give its `model`")
        if not robot or self.plant == ROBOT:
            return dict(self.joint)
        kept = {name: value for name, value in self.joint.items() if name not in _OF_BENCH}
        if self.per_inertia:
            return {name: value for name, value in kept.items() if name != JOINT_DAMPING}
        dry = self.numbers.get("coulomb", 0.0)
        return kept | ({JOINT_FRICTION: dry} if dry else {})

    def left_out(self, *, robot: bool = False) -> list[str]:
        """What the drive has and such a loop does not take, in words."""
        own = list(self.document.get("left_out", ()))
        number = self.document.get(DIFFERENCE_TICKS, 0)
        over = [f"that its positions were differenced over {number} rows, here over one"]
        over = over if number > 1 else []
        if self.plant == ROBOT:
            return own + over
        dry = self.numbers.get("coulomb", 0.0)
        said = self.beyond_a_loop
        if robot and self.per_inertia:
            rubs = dry or self.numbers.get("viscous")
            said = ["friction, which is known per unit of inertia only"] if rubs else []
        elif dry and not robot:
            said = [f"dry friction of {dry:.3g} {self._force}", *said]
        if robot:
            moved = {MASS: INERTIA if self.unit == "rad" else MASS, JOINT_STIFFNESS: "gravity"}
            said += [f"its joint's {words}" for name, words in moved.items() if name in self.joint]
            return said + (["the gains of its log"] if KP in self.joint else []) + over
        return said + own + over

    @property
    def _force(self) -> str:
        force = "N m" if self.unit == "rad" else "N"
        return f"{self.unit}/s^2" if self.per_inertia else force

    @property
    def beyond_a_loop(self) -> list[str]:
        """The friction and the limit that it has and no loop does, in words."""
        said = [words for name, words in UNMODELLED.items() if self.numbers.get(name)]
        limit = self.document.get("command_limit", self.numbers.get("command_limit"))
        # Behind a delay and a gain alone it is one of the force.
        if limit and (FORCE_LIMIT not in self.joint or WN in self.joint):
            said.append(f"a limit of its command of {limit:.3g} {self._force}")
        return said

    @property
    def strength(self) -> tuple[float, float]:
        """The ends of its gain's 95 % interval as factors on it, from 0 where it may be 0."""
        gain = abs(self.numbers.get("gain", 1.0))
        low, high = self.intervals.get("gain", (gain, gain))
        weak, strong = sorted((abs(low) / gain, abs(high) / gain))
        return (weak, strong) if low * high > 0.0 else (0.0, strong)

    @property
    def uncertainty(self) -> dict[str, tuple[float, float] | str]:
        """The 95 % intervals as `jaxact.tune` takes them: wn and zeta as factors.

        A drive whose gain is not known moves a joint as one whose inertia is not.
        """
        if self.plant == ROBOT:
            return {name: (low, high) for name, (low, high) in self.intervals.items()}
        found: dict[str, tuple[float, float] | str] = {}
        for name in (WN, ZETA):
            if name in self.intervals and name in self.numbers:
                low, high = (end / self.numbers[name] for end in self.intervals[name])
                found[name] = (low, high)
        for name, own in ((DELAY, DELAY), ("viscous", JOINT_DAMPING), ("gravity", JOINT_STIFFNESS)):
            if name in self.intervals and own in self.joint:
                low, high = self.intervals[name]
                size = self.joint[MASS] if self.per_inertia and own != DELAY else 1.0
                found[own] = size * low, size * high
        weak, strong = self.strength
        usual = self.numbers.get("inertia", 1.0)
        light, heavy = (end / usual for end in self.intervals.get("inertia", (usual, usual)))
        if {"gain", "inertia"} & set(self.intervals) and not self.per_inertia:
            heaviest = heavy / weak if weak else math.inf
            found[MASS] = f"{light / strong!r}x..{heaviest!r}x"
        return found

    def draws(self, number: int, seed: int = 0) -> dict[str, Any]:
        """Parameters of the loop, drawn from what is known of them together.

        Args:
            number: of draws.
            seed: of the draws.

        Returns:
            By short name, those that are not known of shape (number,).

        Raises:
            UserError: the file has no covariance.
        """
        import numpy as np

        if self.spread is None:
            raise UserError(f"{self.name}: has no covariance to draw from; identify the drive anew")
        # All that is not drawn is what it was; a gain of the drive scales the controller's.
        drawn = dict(self.numbers) | self.spread.draw(self.numbers, number, seed)
        own = parameters_of(drawn, self.plant)
        if self.per_inertia:
            own = per_inertia.multiplied(own, self.joint[MASS]) | {MASS: self.joint[MASS]}
        kept = {**self.joint, **{n: v for n, v in own.items() if n in self.joint}}
        if "gain" not in drawn or KP in self.numbers:
            return kept
        share = np.abs(drawn["gain"]) / abs(self.numbers["gain"])
        if FORCE_LIMIT in self.joint and FORCE_LIMIT not in self.numbers:
            kept[FORCE_LIMIT] = share * self.joint[FORCE_LIMIT]
        return {**kept, GAIN_SCALE: self.joint.get(GAIN_SCALE, 1.0) * share}


def load_drive(path: str | os.PathLike[str]) -> IdentifiedDrive:
    """Read a drive that `jaxact identify` wrote.

    Args:
        path: TOML file.

    Raises:
        UserError: it cannot be read, or is not such a file.
    """
    where = Path(path)
    try:
        document = tomllib.loads(where.read_text(encoding="utf-8-sig"))
    except OSError as error:
        reason = error.strerror or error
        raise UserError(f"{where}: cannot be read ({reason}); give a drive of identify") from None
    except (ValueError, RecursionError) as error:
        raise UserError(f"{where}: is not valid TOML: {str(error)[:200]}") from None
    return of_document(where.name, document)


def is_drive(path: Path) -> bool:
    """Whether a file is of an identified drive; not where it cannot be read at all."""
    try:
        return path.suffix == ".toml" and "estimates" in tomllib.loads(path.read_text("utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        return False


def of_document(name: str, document: Mapping[str, Any]) -> IdentifiedDrive:
    """An identified drive from all that its file says.

    Args:
        name: of the file, for messages.
        document: as `jaxact.identification.result.Identified.document` has it.

    Raises:
        UserError: it is not such a document.
    """
    plant = document.get("plant")
    # Of a robot one table of all joints, whose keys name them.
    loops = [document.get(ROBOT)] if plant == ROBOT else document.get("loop")
    if not isinstance(loops, list) or not isinstance(plant, str) or "estimates" not in document:
        raise UserError(f"{name}: is not a drive; give a file that jaxact identify wrote")
    if len(loops) != 1:
        raise UserError(f"{name}: has {len(loops)} loops; a drive has one")
    try:
        covariance = document.get("covariance")
        keys = Spread.__dataclass_fields__
        spread = None if covariance is None else Spread(*(_frozen(covariance[k]) for k in keys))
        found = IdentifiedDrive(
            name=name, plant=plant, unit=str(document["unit"]),
            level=document.get("verdict", {}).get("level", ""),
            joint=_checked(name, loops[0]),
            numbers={k: float(v) for k, v in document.get("numbers", {}).items()},
            intervals=_intervals(document),
            spread=spread, document=document,
        )  # fmt: skip
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UserError(
            f"{name}: is damaged ({type(error).__name__}: {error}); identify it anew"
        ) from None
    if found.unit not in UNITS:
        raise UserError(f"{name}: unit = {found.unit!r}; allowed: {', '.join(UNITS)}")
    return found


def taken(drive: Any) -> IdentifiedDrive:
    """A drive from its file's path, or from whatever has one as `drive`.

    Args:
        drive: path, `IdentifiedDrive`, or what `jaxact.identify` gave.

    Raises:
        UserError: it is none of these, or its file cannot be read.
    """
    if isinstance(drive, IdentifiedDrive):
        return drive
    if isinstance(drive, str | os.PathLike):
        return load_drive(drive)
    own = getattr(drive, DRIVE, None)
    if not isinstance(own, IdentifiedDrive):
        raise UserError(f"`drive` is {type(drive).__name__}; give a file of jaxact identify")
    return own


def filled(drive: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """What a loop says itself, and what its drive says of the rest.

    Args:
        drive: parameters of the drive by short name.
        own: parameters of the loop by short name, or `actuator`, which sets wn and zeta.
    """
    said = {*own, *((WN, ZETA) if "actuator" in own else ())}
    rest = {name: v for name, v in drive.items() if name not in said and base(name) not in said}
    return {**rest, **own}


def named_by(specification: Path) -> Path | None:
    """The file of the drive that a specification names, which was read; None for none."""
    given = tomllib.loads(specification.read_text(encoding="utf-8-sig")).get(DRIVE)
    return None if given is None else specification.parent / given


def written_out(document: Mapping[str, Any], drive: IdentifiedDrive) -> dict[str, Any]:
    """A specification with the parameters of its drive, where it does not say them itself.

    Args:
        document: of the specification, with canonical names.
        drive: that it names.

    Raises:
        UserError: forces of the drive are per unit of an inertia that is varied, or not given.
    """
    rest = {key: value for key, value in document.items() if key != DRIVE}
    robot = "plant" in rest
    if drive.unit == "rad" and not robot:
        rest.setdefault("unit", drive.unit)
    if drive.velocity is not None:
        rest.setdefault("velocity", drive.velocity)
    given = {**rest["axes"], **rest["parameters"]}
    if not robot:
        if drive.per_inertia and MASS in rest["axes"]:
            raise UserError(
                f"axes: {drive.name} says gains and friction per unit of an inertia that is not"
                " known; give one inertia, and vary something else"
            )
        # No feedforward stands for no axis at all, and is none of any unit.
        drive = drive.moving({name: value for name, value in given.items() if value != [0.0]})
    said = drive.parameters(robot=robot)
    own = filled(said, given)
    # What is varied keeps the drive's number as its nominal one.
    own |= {name: said[name] for name in rest["axes"] if name in said}
    fixed = {n: v for n, v in own.items() if n not in rest["axes"] or n in said}
    return {**rest, "parameters": fixed | rest["parameters"]}


def _intervals(document: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """By name of the model's number; a time constant as the frequency it is."""
    found = {key: (float(low), float(high)) for key, (low, high) in
             document.get("uncertainty", {}).items()}  # fmt: skip
    for name, one in document["estimates"].items():
        own = one.get("number", name)
        if own != name:
            one = {"low": one["value"] / one["high"], "high": one["value"] / one["low"]}
            one = {end: ratio * document["numbers"][own] for end, ratio in one.items()}
        found[own] = float(one["low"]), float(one["high"])
    return found


def _checked(name: str, table: Mapping[str, Any]) -> dict[str, float]:
    """The parameters of the loop in a file."""
    found = {}
    for key, value in table.items():
        if key in ("name", "velocity"):  # that of a list of loops
            continue
        if base(key) not in PARAMETERS or not known(key):
            raise UserError(f"{name}: {key} is not a parameter")
        found[key] = check(key, value, f"{name}: {key}")
    return found


def _frozen(value: Any) -> Any:
    return tuple(map(_frozen, value)) if isinstance(value, list | tuple) else value
