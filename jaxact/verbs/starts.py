"""Which starts the verdict of a loop that is not linear rests on, in words."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.loops import conversion
from jaxact.parameters import (
    CONTROL_RATE,
    GAIN_SCALE,
    INITIAL_POSITION,
    JOINT_DAMPING,
    JOINT_STIFFNESS,
    KD,
    KP,
    LIMITS,
    RESOLUTIONS,
    WN,
    ZETA,
    base,
)

if TYPE_CHECKING:
    from jaxact.simulation.single import Joint, Single, Start

_NAMES = {
    "": "its own start",
    "on": "a step of 27 counts",
    "between": "a step to between two counts",
    "near": "a step to near a count",
    "drift": "a kick that no whole steps of the command stop",
    "slide": "a step of thirty times what friction withstands",
    "kick": "a small kick",
}

# By how much small motions should have decayed before what grows is said to be lost.
_MOSTLY = 0.5
# Farther from the posture [rad or m] its growth rate says little.
_ELSEWHERE = 0.05
_ON_ITS_WAY = (
    "The motion had neither turned nor ended when the duration was over: a longer one tells."
)
_MAY_CREEP = (
    "No motion that goes on has turned twice in the last quarter of the duration, so that it may "
    "yet come to rest: a longer one tells."
)


def lines(run: Single) -> list[str]:
    """What came of each start, where there are several, and what the duration leaves open."""
    from jaxact.status import Verdict

    starts = run.starts[1:] if run.told else run.starts
    verdict = Verdict(int(run.results["verdict"]))
    if not starts:
        return []
    if len(run.starts) == 1:
        return [_ON_ITS_WAY] if _on_its_way(run) else [_MAY_CREEP] if _unturned(run) else []
    stable = verdict == Verdict.STABLE
    rubs = _rubs(run)
    groups: dict[str, list[str]] = {}
    for start in starts:
        end = _end(start, run.joints, rubs, stable)
        if verdict == Verdict.LIMIT_CYCLE and end == Verdict.UNSTABLE.label:
            end = "still growing"
        groups.setdefault(end, []).append(_NAMES[start.name])
    parts = [f"{end} after {_listed(names)}" for end, names in groups.items()]
    found = [f"From {_many(len(starts))}: {'; '.join(parts)}."]
    if run.told:
        found.append(
            "Where setpoints move, the verdict is of small motions, not of following them."
        )
    open_ones = [start for start in starts if not (start.moving or start.resting)]
    if open_ones and stable:
        found.append(
            "What still decays at the end may yet go on as a limit cycle: a longer duration tells."
        )
    if _unturned(run):
        found.append(_MAY_CREEP)
    return found


def _many(number: int) -> str:
    return f"{number} starts" if number > 1 else "one other start"


def _unturned(run: Single) -> bool:
    """Whether a joint's limit cycle is one of motions too slow to have shown that they return.

    Where small motions grow, none comes to rest, and it is one all the same.
    """
    from jaxact.status import Verdict

    cycle = int(run.results["verdict"]) == Verdict.LIMIT_CYCLE and run.results["growth_rate"] < 0.0
    turned = any(one.moving and np.isfinite(one.frequency) for one in run.starts)
    return cycle and not turned and run.trajectory.configuration is None


def document(run: Single) -> list[dict[str, Any]]:
    """The same as an object of JSON."""

    def plain(value: float) -> float | None:
        return float(value) if np.isfinite(value) else None

    return [
        {
            "start": start.name or "own",
            "joint": run.joints[start.joint].name,
            "verdict": start.verdict.label,
            "moving": start.moving,
            "amplitude": plain(start.amplitude),
            "frequency": plain(start.frequency),
        }
        for start in run.starts
    ]


def advice(run: Single) -> str:
    """What the verdict means; of an unstable loop that friction held, that it did.

    Of one whose small perturbations decay, after which starts it was lost all the same; and of a
    limit cycle, what of the loop can keep it up.
    """
    from jaxact.status import Verdict

    verdict = Verdict(int(run.results["verdict"]))
    lost = [_NAMES[one.name] for one in run.starts if one.verdict == Verdict.UNSTABLE]
    if verdict == Verdict.UNSTABLE and run.results["growth_rate"] < 0.0 and lost:
        return (
            f"Small perturbations decay, but the motion after {_listed(lost)} grew: large ones do, "
            f"where limits are reached, or where a robot loses its footing and falls.{_short(run)}"
        )
    if verdict == Verdict.TOPPLES and run.results["growth_rate"] < 0.0:
        return (
            "The robot has fallen over or sunk, although small perturbations decay, and nothing "
            "shakes: it was pushed or moved too far for gains alone to keep it up, or its joints "
            "are too weak to."
        )
    if verdict == Verdict.LIMIT_CYCLE:
        return _of_limit_cycle(run)
    held = _rubs(run) and not any(start.moving for start in run.starts)
    if verdict == Verdict.UNSTABLE and held:
        return (
            "Perturbations of joints that move grow; from every start that was tried dry friction "
            "ended the motion, which it may not after a harder push, or where there is less of it."
        )
    if verdict == Verdict.UNSTABLE and (away := _resting_away(run)):
        return (
            f"The growth rate is that of the posture. The robot came to rest {away} from it, "
            "whatever grows there: whether it does where it rests, a keyframe there tells."
        )
    if verdict == Verdict.UNSTABLE and run.trajectory.configuration is None:  # of a joint
        return _of_unstable_joint(run.values) or verdict.advice
    return verdict.advice


def _of_limit_cycle(run: Single) -> str:
    """What keeps a motion up, of what the loop has, and what helps against it."""
    causes, more = [], []
    if any(value > 0.0 for value in _values(run, RESOLUTIONS)):
        causes.append("the counts of its sensors or commands")
        more.append("make the counts finer")
    # What is not a number is as the model has it.
    limits = _values(run, LIMITS)
    if np.isfinite(limits).any() or (run.limited and np.isnan(limits).any()):
        causes.append("the limits of its force")
        more.append("raise the limits")
    if _rubs(run):
        causes.append("dry friction")
    if causes:
        helps = ["lower the gains", "shorten the delay", *more]
        return (
            f"The motion stays bounded but goes on, as {_listed(causes)} can make it; "
            f"{', '.join(helps[:-1])} or {helps[-1]}.{_widening(run) or _narrowing(run)}"
        )
    size = "The motion keeps going at this amplitude"
    if run.trajectory.configuration is not None:  # of a robot
        size += ", of a robot far from its posture"
    return f"{size}; lower gains or a shorter delay help.{_narrowing(run)}"


def _widening(run: Single) -> str:
    """That the own motion of a joint was still getting wider when the duration was over."""
    own = run.starts[0]
    if run.trajectory.configuration is not None or not (own.moving and own.widening):
        return ""
    return " It was still getting wider when the duration was over: a longer one tells how wide."


def _narrowing(run: Single) -> str:
    """That no motion that goes on had stopped getting smaller when the duration was over."""
    going = [start for start in run.starts if start.moving]
    if not going or not all(start.narrowing for start in going):
        return ""
    ends = ", and whether it ends" if _rubs(run) or run.results["growth_rate"] < 0.0 else ""
    return (
        " It was still getting smaller when the duration was over: a longer one tells how small"
        f"{ends}."
    )


def _values(run: Single, names: Collection[str]) -> np.ndarray:
    """Those of some parameters, of all joints."""
    return np.array([value for key, value in run.values.items() if base(key) in names], float)


def _short(run: Single) -> str:
    """Where small motions hardly decay while a loop is simulated, that it was not for long."""
    duration = float(run.trajectory.time[-1])
    decayed = -np.expm1(float(run.results["growth_rate"]) * duration)
    if decayed > _MOSTLY:
        return ""
    return (
        f" Or {duration:.2g} s are too short to tell: the slowest small motion decays by "
        f"{decayed:.0%} in them."
    )


def _of_unstable_joint(values: Mapping[str, float]) -> str | None:
    """What helps where lower gains do not; None where they may.

    Rigidly m s^2 + c s + k + (kp + kd s)(1 - lag s) has the stiffness kp + k and, without
    damping of its own, the damping kd - kp lag.
    """
    scale, k = values[GAIN_SCALE], values[JOINT_STIFFNESS]
    kp, kd = scale * values[KP], scale * values[KD]
    if kp + k <= 0.0:
        return (
            "Nothing holds the joint at its setpoint: kp and its own stiffness are together not "
            "above 0; raise kp."
        )
    servo = 2.0 * values[ZETA] / values[WN] if np.isfinite(values[WN]) else 0.0
    lag = conversion.total_delay(values) + servo + 0.5 / values[CONTROL_RATE]
    if k == 0.0 and values[JOINT_DAMPING] == 0.0 and kd <= kp * lag:
        return "Perturbations grow, at lower gains too: raise kd against kp, or shorten the delay."
    return None


def _on_its_way(run: Single) -> bool:
    """Whether a joint behind a force limit was stable, but still under way at the end."""
    own = run.starts[0]
    ended = own.moving or own.resting or np.isfinite(own.frequency)
    return len(run.joints) == 1 and own.verdict == 0 and not ended


def _resting_away(run: Single) -> str:
    """How far from the posture a robot's joints came to rest, the farthest; "" where they did not.

    What its small motions do is known at the posture.
    """
    from jaxact.plotting.wording import quantity

    if run.trajectory.configuration is None or not all(start.resting for start in run.starts):
        return ""
    if _values(run, (INITIAL_POSITION,)).any():
        return ""  # it did not start from the posture
    moved = np.abs(run.trajectory.position[-1] - run.trajectory.position[0])
    farthest = int(np.argmax(moved))
    if not moved[farthest] > _ELSEWHERE:
        return ""
    return quantity(float(f"{moved[farthest]:.2g}"), "rad" if run.rotary[farthest] else "m")


def _rubs(run: Single) -> bool:
    """Whether joints have dry friction: such a robot has a start that makes them slide."""
    return any(start.name == "slide" for start in run.starts)


def _end(start: Start, joints: Sequence[Joint], rubs: bool, stable: bool) -> str:
    from jaxact.plotting.wording import quantity
    from jaxact.status import Verdict

    if start.verdict in (Verdict.UNSTABLE, Verdict.INVALID):
        if start.moving:
            return start.verdict.label
        if not start.resting:
            return "decaying by friction alone" if rubs else "decaying, although unstable,"
        still = "though unstable where joints move" if rubs else "where perturbations grow"
        return f"at rest, {still},"
    if start.verdict == Verdict.TOPPLES:
        return "fallen"
    if not start.moving:
        return "at rest" if start.resting else "decaying"
    joint = joints[start.joint]
    size = quantity(float(f"{start.amplitude:.3g}"), "rad" if joint.rotary else "m")
    size += f" ({joint.name})" * (len(joints) > 1)
    if stable:  # as the other starts show
        return f"moving by {size}, within a count,"
    at = f" at {start.frequency:.3g} rad/s" if np.isfinite(start.frequency) else ""
    return f"limit cycle of {size}{at}{', still getting smaller,' * start.narrowing}"


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
