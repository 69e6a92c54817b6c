"""The ladder of a joint that moved: from setpoint or command to position.

Friction comes first, with a delay in the drive, since wrong friction is taken for delay; then the
drive's dynamics, with the friction that was found.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np

from jaxact.errors import UserError
from jaxact.identification import joint_motion, starts, supply
from jaxact.identification.alike import demand_alike, stated
from jaxact.identification.joint_motion import COMMAND_LIMIT, INITIAL_FORCE, Structure
from jaxact.identification.log import LINKS, Log, filled
from jaxact.identification.model import (
    DYNAMICS,
    LONG_DELAYS,
    MOST_FREE_BEGINNINGS,
    NEUTRAL_DRIVE,
    Family,
    Rung,
    drive_unknowns,
    ticks_of_delay,
)
from jaxact.identification.problem import Unknown
from jaxact.identification.recording import Recording, of_rows
from jaxact.parameters import (
    FEEDFORWARD,
    FORCE_LIMIT,
    INITIAL_POSITION,
    INITIAL_VELOCITY,
    KD,
    KP,
    MASS,
    SETPOINT,
    WN,
    ZETA,
)

PLANTS = (MASS, "pendulum")
_MOST_TICKS_OF_DELAY = 6
# Share of its highest speed from which on a joint is in motion.
_IN_MOTION = 0.15
# Share of a controller's damping with which the search for viscous friction beside it begins.
_OF_THE_DAMPING = 0.05
# The time over which a joint's motion is a line at the beginning of a log [s].
_LINE = 0.037
# The longest time over which friction and gravity are integrated in one step [s].
_LONGEST_STEP = 2.5e-3

FRICTION: dict[str, tuple[str, ...]] = {
    "no friction": (),
    "viscous": ("viscous",),
    "viscous and dry": ("viscous", "coulomb"),
    "asymmetric": ("viscous", "coulomb", "viscous_asymmetry", "coulomb_asymmetry"),
    "asymmetric, with an offset": (
        "viscous", "coulomb", "viscous_asymmetry", "coulomb_asymmetry",
    ),
    "load-dependent": ("viscous", "loaded"),
    "dry and load-dependent": ("viscous", "coulomb", "loaded"),
    "load-dependent, more at rest": (
        "viscous", "coulomb", "loaded", "stribeck", "stribeck_speed",
    ),
}  # fmt: skip
"""Names of the numbers that each kind of friction leaves free."""

_NEUTRAL: dict[str, float] = {
    "inertia": 1.0, "gain": 1.0, FORCE_LIMIT: 1e12, COMMAND_LIMIT: 1e12,
    "viscous": 1e-12, "coulomb": 1e-12, "viscous_asymmetry": 0.0, "coulomb_asymmetry": 0.0,
    "loaded": 0.0, "stribeck": 0.0, "stribeck_speed": 1.0,
    "gravity": 0.0, "zero": 0.0, "offset": 0.0, KP: 1.0, KD: 0.0, **NEUTRAL_DRIVE,
    # Not known: where the log begins.
    INITIAL_POSITION: math.nan, INITIAL_VELOCITY: math.nan, INITIAL_FORCE: math.nan,
}  # fmt: skip
_OF_THE_LOAD = ("loaded", "stribeck", "stribeck_speed")
_POSITIVE = frozenset(
    ("inertia", "armature", "viscous", "coulomb", "stribeck_speed", COMMAND_LIMIT, KP, WN, ZETA)
)


@dataclass(frozen=True)
class Simulate:
    """Position for a structure; as a value, so that equal ones share a program."""

    structure: Structure
    sought_gains: bool

    def __call__(self, values: Mapping[str, Any], recording: Recording) -> jax.Array:
        """Position at each row [m or rad], shape (rows,)."""
        return self.both(values, recording)[0]

    def both(self, values: Mapping[str, Any], recording: Recording) -> tuple[jax.Array, jax.Array]:
        """Position [m or rad] and command [N or N m] at each row."""
        turned = {
            "viscous": values["viscous"] * (1.0 + values["viscous_asymmetry"]),
            "viscous_back": values["viscous"] * (1.0 - values["viscous_asymmetry"]),
            "coulomb": values["coulomb"] * (1.0 + values["coulomb_asymmetry"]),
            "coulomb_back": values["coulomb"] * (1.0 - values["coulomb_asymmetry"]),
        }
        whole = {**values, **turned, **recording.stated}
        if not self.structure.gravity:  # nothing of the friction is the load's
            whole = {name: value for name, value in whole.items() if name not in _OF_THE_LOAD}
        if not self.sought_gains:
            whole = {name: value for name, value in whole.items() if name not in (KP, KD)}
        return joint_motion.simulate(whole, recording, self.structure)


def family(
    logs: Sequence[Log], plant: str, control_rate: float | None = None, *, lines: bool = False,
    longest: float = LONG_DELAYS[0],
) -> Family:  # fmt: skip
    """The ladder for logs of a joint's motion.

    Args:
        logs: to be fitted.
        plant: "mass" or "pendulum".
        control_rate: at which the controller ran [Hz]; None for once a row.
        lines: what is asked for lies on lines between the rows instead of being held from one
            to the next.
        longest: delay that is tried [s].

    Raises:
        UserError: a log lacks the position, or both setpoint and command, or what others have.
    """
    for log in logs:
        if "position" not in log:
            raise UserError(f"{log.title}: has no position; a {plant} needs one")
        if SETPOINT not in log and "command" not in log:
            raise UserError(f"{log.title}: has neither setpoint nor command; map one of them")
    first = logs[0]
    known = [log.gains[0] is not None for log in logs]
    closed = SETPOINT in first and (all(known) or "command" not in first)
    sought = closed and not any(known)
    ticks, _ = cut(first, control_rate)
    history = ticks_of_delay(first.period, _MOST_TICKS_OF_DELAY, longest) * ticks + 2
    structure = Structure(closed, history, first.difference_ticks, plant == "pendulum")
    demand_alike(logs, structure, sought)
    context = Context(logs, plant, structure, sought, control_rate, lines, longest)
    perhaps = not sought and all(math.isinf(starts.command_limit(log)) for log in logs)
    limited = perhaps and starts.guess(logs, context, perhaps_limited=True)["limited"]
    context = replace(context, perhaps_limited=perhaps, limited=limited)
    if context.robot and sought:
        raise UserError(f"{first.title}: a robot needs kp and kd in the map, or its command")
    unit = "rad" if first.unit == "rad" else "m"
    return Family(
        rungs=context.rungs(),
        unknowns=context.unknowns,
        neutral=context.neutral(),
        positive=_POSITIVE,
        inputs=context.inputs,
        simulate=Simulate(structure, sought),
        measured=lambda log: log["position"],
        stimulus=lambda log: log[SETPOINT] if closed else log["command"],
        signal="position",
        unit=unit,
        nuisances=context.nuisances,
        # Not quite one: the drive's lag lies between them, which kp and the rest make up for.
        beside=("viscous",) if sought else (),
        perhaps=(COMMAND_LIMIT,) if perhaps and not limited else (),
    )


def cut(log: Log, control_rate: float | None) -> tuple[int, int]:
    """(ticks of a row, of which every how-many-th is the controller's) for a log.

    Args:
        log: any.
        control_rate: [Hz], None for once a row.
    """
    if control_rate is None:
        ticks = max(math.ceil(log.period / _LONGEST_STEP - 1e-6), 1)
        return ticks, ticks
    controls = max(round(log.period * control_rate), 1)
    finer = max(math.ceil(log.period / controls / _LONGEST_STEP - 1e-6), 1)
    return controls * finer, finer


@dataclass(frozen=True)
class Context:
    """Logs of one joint, and what is known of it and of its controller.

    Attributes:
        logs: to be fitted.
        plant: "mass" or "pendulum".
        structure: of the simulation.
        sought_gains: whether the controller's gains are sought.
        control_rate: of the controller [Hz]; None for once a row.
        lines: what is asked for lies on lines between the rows.
        longest: delay that is tried [s].
        perhaps_limited: whether the drive may follow commands up to a limit that no log says.
        limited: whether it clearly does.
    """

    logs: Sequence[Log]
    plant: str
    structure: Structure
    sought_gains: bool
    control_rate: float | None
    lines: bool = False
    longest: float = LONG_DELAYS[0]
    perhaps_limited: bool = False
    limited: bool = False

    @property
    def robot(self) -> bool:
        """Whether the joint is one of a robot, whose links are known."""
        return set(LINKS) <= set(self.logs[0].signals)

    def known(self) -> dict[str, float]:
        """Numbers that the details of the first log give; other logs may state others."""
        return self.stated(self.logs[0])

    def stated(self, log: Log) -> dict[str, float]:
        """Numbers that a log's details give; of a joint whose gains are sought gravity is too."""
        found = stated(log, self.structure.gravity)
        return {name: v for name, v in found.items() if name == "inertia" or not self.sought_gains}

    def neutral(self) -> dict[str, float]:
        """Every number of the model, at the value at which it changes nothing."""
        if self.robot:  # the links' inertia is known, and the rotor's is sought
            rest = {name: value for name, value in _NEUTRAL.items() if name != "inertia"}
            return {**rest, "armature": 1e-12}
        return {**_NEUTRAL, **self.known()}

    def always(self) -> tuple[str, ...]:
        """Unknowns of every rung."""
        if self.robot:
            # Where the gains are stated, the drive's own is in them: dry friction hides the rest.
            gain = () if self.structure.closed else ("gain",)
            return ("offset", "armature", *gain, *((COMMAND_LIMIT,) if self.limited else ()))
        known = self.known()
        names = ["offset"] if not self.structure.gravity else ["zero"]
        names += [COMMAND_LIMIT] if self.limited else []
        if self.sought_gains:
            # Without a force in the log only ratios to the inertia can be known.
            return (*names, KP, KD, *(("gravity",) if self.structure.gravity else ()))
        if "inertia" not in known:
            names.append("inertia")
        if self.structure.gravity and "gravity" not in known:
            names.append("gravity")
        if "gravity" in known or "inertia" in known:
            names.append("gain")
        return tuple(names)

    def rungs(self) -> tuple[Rung, ...]:
        """Every friction with a delay, then every other dynamics with the richest friction."""
        made = []
        for dynamics, (drive, fixed) in DYNAMICS.items():
            for kind, terms in FRICTION.items():
                if "load" in kind and not self.structure.gravity:
                    continue
                own = self.always()
                if kind == "asymmetric" and "offset" in own:
                    # While the joint slides an offset is the asymmetry of dry friction.
                    own = tuple(name for name in own if name != "offset")
                if self.sought_gains:
                    # kd and viscous friction are nearly one where no force was recorded.
                    terms = tuple(t for t in terms if not t.startswith("viscous"))
                name = f"{dynamics}, {kind}"
                made.append(Rung(name, dynamics, kind, (*own, *terms, *drive), fixed))
        return tuple(made)

    def unknowns(self, logs: Sequence[Log]) -> dict[str, Unknown]:
        """What can be sought, by name, with ranges and starts from the logs."""
        guess = starts.guess(logs, self, perhaps_limited=self.perhaps_limited)
        force = "N m" if logs[0].unit == "rad" else "N"
        rubbing = f"{force} s/{logs[0].unit}"
        stiffness, inertia = f"{force}/{logs[0].unit}", self.known().get("inertia", 1.0)
        if self.sought_gains:
            guess["viscous"] = _OF_THE_DAMPING * guess[KD]
            if "inertia" not in self.known():  # all of it per unit of that
                force, rubbing, stiffness = f"{logs[0].unit}/s^2", "1/s", "1/s^2"
        mass = "kg m^2" if logs[0].unit == "rad" else "kg"
        speed = "rad/s" if logs[0].unit == "rad" else "m/s"
        size, asked = guess["size"], guess["asked"]
        coulomb = max(abs(guess["coulomb"]), 0.02 * guess["size"])
        viscous = max(guess["viscous"], 1e-3 * guess["inertia"])
        low, high = 1e-4, 1e4
        # A pendulum may swing under its own weight, far above what the drive gives.
        heavy = 100.0 * max(size, abs(guess["gravity"]))
        sought = (
            *(Unknown(name, mass, low * guess["inertia"], high * guess["inertia"],
                      (guess["inertia"],), positive=True) for name in ("inertia", "armature")),
            Unknown("gain", "1", 1e-3 * guess["gain"], 1e3 * guess["gain"], (guess["gain"],)),
            Unknown("viscous", rubbing, low * viscous, high * viscous, (viscous,), positive=True),
            Unknown("coulomb", force, low * coulomb, 1e2 * coulomb, (coulomb,), positive=True),
            Unknown("viscous_asymmetry", "1", -1.0, 1.0, (0.0,)),
            Unknown("coulomb_asymmetry", "1", -1.0, 1.0, (0.0,)),
            Unknown("loaded", "1", 0.0, 0.95, (0.01, 0.1)),
            Unknown("stribeck", "1", 0.0, 10.0, (0.02, 0.3)),
            Unknown("stribeck_speed", speed, 1e-3 * guess["speed"], 3.0 * guess["speed"],
                    (0.1 * guess["speed"],), positive=True),
            Unknown(COMMAND_LIMIT, force, 1e-3 * asked, 2.0 * asked, (guess[COMMAND_LIMIT],),
                    positive=True),
            Unknown("offset", force, -size, size, (guess["offset"],)),
            Unknown("gravity", force, -heavy, heavy, (guess["gravity"],)),
            Unknown("zero", "rad", -0.5, 0.5, (0.0,)),
            Unknown(KP, stiffness, inertia, 1e7 * inertia, guess[KP], positive=True),
            Unknown(KD, rubbing, 0.0, 1e5 * inertia, (guess[KD],)),
            *drive_unknowns(logs, _MOST_TICKS_OF_DELAY, self.longest),
        )  # fmt: skip
        return {unknown.name: unknown for unknown in sought}

    def nuisances(self, logs: Sequence[Log], tried: bool) -> tuple[Unknown, ...]:
        """Where each of a few logs begins, and with which force where it begins in motion."""
        if len(logs) > MOST_FREE_BEGINNINGS:
            return ()
        found = []
        for number, log in enumerate(logs):
            position, velocity = beginning(log)
            room = 0.05 * float(np.ptp(log["position"]))
            fast = max(float(np.max(np.abs(starts.speed(log)))), 1e-9)
            each = [
                (INITIAL_POSITION, position, room, log.unit),
                (INITIAL_VELOCITY, velocity, fast, f"{log.unit}/s"),
            ]
            if tried or abs(velocity) > _IN_MOTION * fast:
                force = 100.0 * max(float(np.max(np.abs(starts.asked(log, self)))), 1e-9)
                each.append((INITIAL_FORCE, 0.0, force, "N m" if log.unit == "rad" else "N"))
            for name, value, reach, unit in each:
                found.append(
                    Unknown(f"{name}[{number}]", unit, value - reach, value + reach, (value,),
                            log=number)
                )  # fmt: skip
        return tuple(found)

    def inputs(self, log: Log) -> Recording:
        """What the simulation needs of a log."""
        zero = np.zeros(len(log))
        ticks, controlled = cut(log, self.control_rate)
        gains = (math.nan, math.nan) if self.sought_gains else log.gains
        own = self.stated(log)
        position, velocity = beginning(log)
        return of_rows(
            filled(log.time, rising=True),
            setpoint=filled(log[SETPOINT] if SETPOINT in log else zero),
            command=filled(log["command"] if "command" in log else zero),
            feedforward=filled(log[FEEDFORWARD] if FEEDFORWARD in log else zero),
            strength=filled(supply.strength(log, self.logs)),
            position=filled(np.append(position, log["position"][1:])),
            velocity=velocity,
            gains=(float(gains[0] or 0.0), float(gains[1] or 0.0)),
            command_limit=min(starts.command_limit(log), 1e12),
            ticks_per_row=ticks,
            controlled=controlled,
            lines=self.lines,
            links=tuple(filled(log[name]) for name in LINKS) if self.robot else None,
            stated={} if self.robot or own == self.known() else own,
        )


def beginning(log: Log) -> tuple[float, float]:
    """Position and velocity at a log's first row, by a line through its first rows.

    Through few of those that are far apart, as the joint turns back between them.
    """
    rows = min(max(round(_LINE / log.period), 2), 7)
    time = log.time[:rows] - log.time[0]
    slope, start = np.polyfit(time, log["position"][:rows], 1)
    return float(start), float(slope)
