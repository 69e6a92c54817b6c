"""What dry friction holds: a robot that shakes once it moves, and stands still until it is pushed.

Coulomb friction of size f takes as much energy from an oscillation of velocity amplitude V as
viscous damping 4 f / (pi V) does (the describing function of a relay; Gelb, Vander Velde,
"Multiple-Input Describing Functions", 1968, section 2.3): much while the motion is small, and ever
less as it grows. So a loop whose moving joints shake comes to rest from a small push, and does not
from a larger one. How large, and how it shakes then, is found by simulation: the whole drive, in C
MuJoCo, with friction as the model has it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import jax
import mujoco
import numpy as np

from jaxact.analysis.robot.margins import RobotMargins
from jaxact.analysis.robot.modes import Robot, ranked
from jaxact.loops import robots
from jaxact.loops.robots import Scene
from jaxact.loops.samples import Samples
from jaxact.loops.specification import Specification
from jaxact.parameters import (
    ERRORS,
    INITIAL_POSITION,
    INITIAL_VELOCITY,
    JOINT_FRICTION,
    SETPOINT,
)
from jaxact.plants.mujoco import JointPush
from jaxact.robots import friction as _friction
from jaxact.simulation import mujoco_batch, plans
from jaxact.simulation.trajectory import Trajectory

START, PUSH = 0.05, 0.05
"""When a joint is pushed, and how long [s]."""

# Pushes tried side by side: from a part of the joint's friction to a multiple of it, or to what
# would bring the joint alone to this speed [rad/s, m/s]; then as many around the limit.
_WEAKEST, _MULTIPLE, _FASTEST, _NUMBER = 0.25, 4.0, (20.0, 2.0), 16
# Where the weakest push lasts already, pushes down to this part of it; friction withstands those.
_TINY = 1e-4
# Simulated time: so many times the shaking's own time constant, within these bounds [s].
_CONSTANTS, _SHORTEST, _LONGEST = 25.0, 2.0, 8.0
# A motion this far [m or rad] has left every physical range.
_OUT_OF_RANGE = 100.0
# What goes on is at least this much of what was a quarter of the time ago (friction ends what
# decays ever faster), and turns at least so often in a quarter; what is smaller than this
# [m or rad] is at rest.
_LASTING, _TURNS, _REST = 0.95, 3, 1e-6
# What is left out of a simulation that is about friction.
_LEFT_OUT = (*ERRORS, SETPOINT, INITIAL_POSITION, INITIAL_VELOCITY)


@dataclass(frozen=True)
class Stiction:
    """A robot that friction holds although its moving joints shake.

    Attributes:
        joint: the one that is pushed, which takes the largest part in the growing motion.
        push: smallest force on it, for `PUSH` seconds, after which the motion goes on [N or N m];
            inf if there is none up to `strongest`, 0 if friction does not hold it.
        strongest: largest push tried [N or N m].
        shaking: the joint that then moves most, empty if none does.
        amplitude: half the range of its motion [m or rad], inf where it grows without bound, 0 if
            none.
        frequency: of it [rad/s], NaN if there is none.
        rotary: whether the joint pushed, and the one that moves most, are hinges.
    """

    joint: str
    push: float
    strongest: float
    shaking: str
    amplitude: float
    frequency: float
    rotary: tuple[bool, bool]

    @property
    def sentence(self) -> str:
        """What a person wants to know of it."""
        unit = "N m" if self.rotary[0] else "N"
        pushed = f"for {1e3 * PUSH:g} ms"
        if not np.isfinite(self.push):
            return (
                f"stands still because dry friction holds it: no push on {self.joint} of up to "
                f"{self.strongest:.3g} {unit} {pushed} made it shake"
            )
        begins = (
            "stands still only because of dry friction: pushed on "
            f"{self.joint} with more than {self.push:.2g} {unit} {pushed}, it shakes"
        )
        if self.push == 0.0:
            begins = (
                "is not held by its dry friction: after the smallest of pushes on "
                f"{self.joint} it shakes"
            )
        if not np.isfinite(self.amplitude):
            return f"{begins} without bound, as no force limit stops it"
        length = "rad" if self.rotary[1] else "m"
        at = f" at {self.frequency:.3g} rad/s" if np.isfinite(self.frequency) else ""
        return f"{begins}{at}, {self.amplitude:.2g} {length} ({self.shaking})"


def held(
    specification: Specification, values: Mapping[str, float], robot: Robot, margins: RobotMargins
) -> Stiction | None:
    """Whether friction holds a robot that shakes once it moves, and up to which push.

    Args:
        specification: of the robot.
        values: parameters of the loop by key.
        robot: linearised, with joints that move.
        margins: its margins.

    Returns:
        None where nothing is to be said: no dry friction, or no growing oscillation.
    """
    plant, mode = specification.plant, margins.critical
    if plant is None or "shakes" not in margins.verdict or not mode.participation.any():
        return None
    scene = robots.scene(plant)
    if not _rubs(scene, values):
        return None
    place = ranked(mode.participation)[0]
    duration = float(np.clip(_CONSTANTS / mode.growth_rate, _SHORTEST, _LONGEST))
    runs = _Runs(specification, dict(values), place, START + PUSH + duration)
    own = _at_joint(scene, values, place) or _largest(scene, values)
    fastest = _FASTEST[0] if _hinge(scene, place) else _FASTEST[1]
    strongest = max(_MULTIPLE * own, fastest * float(robot.inertias[place]) / PUSH)
    pushes = np.geomspace(_WEAKEST * own, strongest, _NUMBER)
    tried = runs.after(pushes)
    lasting = np.flatnonzero([_goes_on(positions) for positions in tried])
    name = scene.labels[place]
    if not lasting.size:
        none = (name, np.inf, float(pushes[-1]), "", 0.0, np.nan)
        return Stiction(*none, rotary=(_hinge(scene, place),) * 2)
    first = int(lasting[0])
    push = _least(runs, pushes, first) if first else _below(runs, float(pushes[0]))
    most, amplitude, frequency = _motion(tried[first], runs.step)
    return Stiction(
        name, push, float(pushes[-1]), scene.labels[most], amplitude, frequency,
        rotary=(_hinge(scene, place), _hinge(scene, most)),
    )  # fmt: skip


def _least(runs: _Runs, pushes: np.ndarray, first: int) -> float:
    """Smallest push that lasts [N or N m], where the one before `first` does not."""
    closer = np.geomspace(pushes[first - 1], pushes[first], _NUMBER)
    again = [_goes_on(positions) for positions in runs.after(closer)]
    return float(closer[int(np.argmax(again))]) if any(again) else float(pushes[first])


def _below(runs: _Runs, weakest: float) -> float:
    """The same where the weakest push lasts; 0 if much weaker ones do: nothing holds that motion.

    So it is where the joints that shake have no friction, but others do.
    """
    pushes = np.geomspace(_TINY * weakest, weakest, _NUMBER)
    lasting = np.array([_goes_on(positions) for positions in runs.after(pushes)])
    if lasting[0] or not lasting.any():
        return 0.0
    return _least(runs, pushes, int(np.argmax(lasting)))


def _rubs(scene: Scene, values: Mapping[str, float]) -> bool:
    return _largest(scene, values) > 0.0


def _added(values: Mapping[str, float]) -> list[float]:
    """Dry friction that the parameters add to joints [N or N m]."""
    own = [value for key, value in values.items() if key.partition("@")[0] == JOINT_FRICTION]
    return np.nan_to_num(own).tolist()


def _at_joint(scene: Scene, values: Mapping[str, float], place: int) -> float:
    """Dry friction of a driven joint [N or N m], with what the parameters add for all joints."""
    return float(_friction.at_joints(scene.robot)[place]) + float(values[JOINT_FRICTION])


def _largest(scene: Scene, values: Mapping[str, float]) -> float:
    """Largest dry friction that there is anywhere [N or N m]."""
    return max(_friction.largest(scene.robot.model), *_added(values))


def _hinge(scene: Scene, place: int) -> bool:
    kind = scene.robot.model.jnt_type[scene.robot.joints[place].joint]
    return int(kind) == int(mujoco.mjtJoint.mjJNT_HINGE)


class _Runs:
    """Simulations of one loop after pushes on one of its joints, side by side."""

    def __init__(
        self, specification: Specification, values: dict[str, float], place: int, duration: float
    ) -> None:
        quiet = values | {name: 0.0 for name in values if name.partition("@")[0] in _LEFT_OUT}
        self._specification = replace(
            specification, engine="mujoco", precision="float64", duration=duration, axes=(),
            sampling=None, motion=None, push=None, devices=1, tile=None,
        )  # fmt: skip
        self._values = {name: np.full(_NUMBER, value) for name, value in quiet.items()}
        samples = Samples(self._values, ("loop",), (_NUMBER,), {})
        (plan,) = plans.groups(self._specification, samples)
        # What follows a push is looked at here, and no other start.
        self._case, self._place = replace(plan.case, starts=()), place
        self.step = plan.case.step

    def after(self, pushes: np.ndarray) -> list[np.ndarray]:
        """Positions of all joints after pushes [N or N m]; shape (steps, joints) each."""
        setting = self._specification.setting
        joints = len(robots.scene(setting.plant).labels)  # type: ignore[arg-type]
        force = np.zeros((_NUMBER, joints))
        force[:, self._place] = pushes
        with jax.enable_x64(True):
            _, kept, _ = mujoco_batch.followed(
                self._case,
                setting,
                self._values,
                np.zeros(_NUMBER),
                self._specification.seed,
                np.arange(_NUMBER),
                JointPush(force, START, PUSH),
            )
        return _positions(kept)


def _positions(kept: Trajectory) -> list[np.ndarray]:
    position = np.asarray(kept.position)
    return list(position.reshape(*position.shape[:2], -1))


def _quarters(positions: np.ndarray) -> np.ndarray:
    """Half the range of each joint in each quarter of the time, shape (4, joints)."""
    return np.stack([0.5 * np.ptp(part, axis=0) for part in np.array_split(positions, 4)])


def _goes_on(positions: np.ndarray) -> bool:
    """Whether a motion has not come to rest by the end."""
    if not np.isfinite(positions).all() or np.max(np.abs(positions)) > _OUT_OF_RANGE:
        return True
    _, _, before, last = _quarters(positions)
    return bool(np.any((last > _REST) & (last > _LASTING * before) & (_turns(positions) >= _TURNS)))


def _turns(positions: np.ndarray) -> np.ndarray:
    """How often each joint comes back to the middle of its motion in the last quarter."""
    last = np.array_split(positions, 4)[-1]
    above = last >= last.mean(axis=0)
    return np.sum(above[1:] & ~above[:-1], axis=0)


def _motion(positions: np.ndarray, step: float) -> tuple[int, float, float]:
    """Joint that moves most in the last quarter, its amplitude [m or rad], frequency [rad/s]."""
    if not np.isfinite(positions).all() or np.max(np.abs(positions)) > _OUT_OF_RANGE:
        finite = positions[np.isfinite(positions).all(axis=1)]
        return int(np.argmax(np.abs(finite).max(axis=0))), np.inf, np.nan
    last = np.array_split(positions, 4)[-1]
    most = int(np.argmax(np.ptp(last, axis=0)))
    course = last[:, most] - last[:, most].mean()
    rising = np.flatnonzero((course[:-1] < 0.0) & (course[1:] >= 0.0))
    if rising.size < 2:
        return most, 0.5 * float(np.ptp(course)), np.nan
    at = rising + course[rising] / (course[rising] - course[rising + 1])
    turns = (rising.size - 1) / ((at[-1] - at[0]) * step)
    return most, 0.5 * float(np.ptp(course)), 2.0 * np.pi * float(turns)
