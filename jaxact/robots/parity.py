"""Fields of a model that MJX does not simulate as MuJoCo does, and what is done about each.

Found by comparing the fields of MuJoCo's model with those that MJX reads, and the trajectories of
the two; the tests hold every entry against both simulators again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

from jaxact.parameters import DELAY
from jaxact.robots.findings import (
    ASKED,
    EMULATED,
    GROUP_OFF,
    HARMLESS,
    INEXACT,
    MJX,
    REFUSED,
    WARP,
    Finding,
    named,
)
from jaxact.robots.touching import on_planes, pair_name

Places = Iterable[tuple[str, str]]
"""(where, value) of each element that has the field."""

ITERATIONS, SEARCHES = 100, 50
"""Most iterations of the solver, and of its line search, in place of very few: MuJoCo's own."""

# Models that are made for speed have one to three, with which not even Newton's method is done; it
# is with four, and conjugate gradients with some tens.
_ENOUGH = {mujoco.mjtSolver.mjSOL_NEWTON: 4, mujoco.mjtSolver.mjSOL_CG: 30}

_DISABLE, _ENABLE = mujoco.mjtDisableBit, mujoco.mjtEnableBit
_MUJOCO_CAN = "or choose the engine `mujoco`"


@dataclass(frozen=True)
class Claim:
    """What MJX does with a field, and what jaxact does.

    Attributes:
        field: as MJCF names it.
        find: the elements of a model that have it, given those of its actuators that are driven.
        mjx, action, advice: as in `Finding`.
        engines: that it stops where it is refused; MJX-Warp knows more fields than MJX.
    """

    field: str
    find: Callable[[mujoco.MjModel, frozenset[int]], Places]
    mjx: str
    action: str
    advice: str
    engines: tuple[str, ...] = (MJX,)


def findings(model: mujoco.MjModel, driven: Iterable[int]) -> list[Finding]:
    """What is to be said about the fields of a model.

    Args:
        model: as the user's file compiles.
        driven: its actuators that a drive replaces.
    """
    taken = frozenset(driven)
    return [
        Finding(
            where,
            claim.field,
            value,
            claim.mjx,
            claim.action,
            claim.advice,
            claim.engines if claim.action == REFUSED else (),
        )
        for claim in CLAIMS
        for where, value in claim.find(model, taken)
    ]


def _text(values: object) -> str:
    return " ".join(f"{value:g}" for value in np.atleast_1d(values))


def _rows(element: str, field: str, count: str) -> Callable[..., Places]:
    """Elements whose row of this field of the model is not zero."""

    def find(model: mujoco.MjModel, driven: frozenset[int]) -> Places:
        for index in range(getattr(model, count)):
            row = getattr(model, field)[index]
            if np.any(row != 0):
                yield named(element, getattr(model, element)(index).name, index), _text(row)

    return find


def _dof_rows(field: str) -> Callable[..., Places]:
    """Joints with a degree of freedom whose row of this field is not zero; each joint once."""

    def find(model: mujoco.MjModel, driven: frozenset[int]) -> Places:
        rows = getattr(model, field)
        for joint in dict.fromkeys(model.dof_jntid[np.any(rows != 0, axis=1)]):
            row = rows[model.jnt_dofadr[joint]]
            yield named("joint", model.joint(joint).name, int(joint)), _text(row)

    return find


def _undriven(
    has: Callable[[mujoco.MjModel, int], object],
) -> Callable[[mujoco.MjModel, frozenset[int]], Places]:
    """Actuators that stay as they are and for which this is true; a text is shown as the value."""

    def find(model: mujoco.MjModel, driven: frozenset[int]) -> Places:
        for index in range(model.nactuator):
            value = index not in driven and has(model, index)
            if value:
                name = model.actuator(index).name
                yield named("actuator", name, index), "yes" if value is True else str(value)

    return find


def _option(value: Callable[[mujoco.MjModel], object]) -> Callable[..., Places]:
    """The options, where this is true; a text is shown as the value."""

    def find(model: mujoco.MjModel, driven: frozenset[int]) -> Places:
        shown = value(model)
        if shown:
            yield "option", "yes" if isinstance(shown, bool | np.bool_) else str(shown)

    return find


def _disabled(bit: mujoco.mjtDisableBit) -> Callable[..., Places]:
    return _option(lambda model: "disable" if model.opt.disableflags & bit else "")


def _enabled(bit: mujoco.mjtEnableBit) -> Callable[..., Places]:
    return _option(lambda model: "enable" if model.opt.enableflags & bit else "")


def _integrator(*kinds: mujoco.mjtIntegrator) -> Callable[..., Places]:
    def name(model: mujoco.MjModel) -> str:
        kind = mujoco.mjtIntegrator(model.opt.integrator)
        return kind.name.removeprefix("mjINT_").lower() if kind in kinds else ""

    return _option(name)


def _in_fluid(model: mujoco.MjModel) -> bool:
    return model.opt.density > 0.0 or model.opt.viscosity > 0.0


def _ellipsoids(model: mujoco.MjModel, driven: frozenset[int]) -> Places:
    if _in_fluid(model):
        for index in np.flatnonzero(model.geom_fluid[:, 0] > 0.0):
            yield named("geom", model.geom(index).name, int(index)), "ellipsoid"


def _plugins(model: mujoco.MjModel, driven: frozenset[int]) -> Places:
    for index in np.flatnonzero(model.body_plugin >= 0):
        yield named("body", model.body(index).name, int(index)), "yes"


def _on_planes(*, margin: bool) -> Callable[[mujoco.MjModel, frozenset[int]], Places]:
    """Boxes and meshes that may touch a plane, with a margin or without one."""

    def find(model: mujoco.MjModel, driven: frozenset[int]) -> Places:
        found = {pair: size for pair, size in on_planes(model) if (size > 0.0) == margin}
        if found:
            value = f"{max(found.values()):g} m" if margin else "box or mesh on a plane"
            yield pair_name(model, list(found)), value

    return find


def _held_together(model: mujoco.MjModel, driven: frozenset[int]) -> Places:
    for index in range(model.neq):
        kind = mujoco.mjtEq(model.eq_type[index])
        if kind in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
            name = named("equality", model.equality(index).name, index)
            yield name, kind.name.removeprefix("mjEQ_").lower()


def ends_early(option: mujoco.MjOption) -> bool:
    """Whether the solver is ended before it can be done."""
    return bool(option.iterations < _ENOUGH.get(mujoco.mjtSolver(option.solver), 0))


def _few_iterations(model: mujoco.MjModel) -> str:
    return f"{model.opt.iterations}" if ends_early(model.opt) else ""


def _delayed_sensors(model: mujoco.MjModel, driven: frozenset[int]) -> Places:
    for index in range(model.nsensor):
        delay, interval = model.sensor_delay[index], model.sensor_interval[index, 0]
        if model.sensor_history[index, 0] or delay or interval:
            where = named("sensor", model.sensor(index).name, index)
            yield where, f"delay {delay:g} s, interval {interval:g} s"


def _delayed(model: mujoco.MjModel, index: int) -> str:
    delay = model.actuator_delay[index]
    return f"{delay:g} s" if delay else ""


def _group_off(model: mujoco.MjModel, index: int) -> str:
    group = int(model.actuator_group[index])
    return f"group {group}" if switched_off(model, index) else ""


def switched_off(model: mujoco.MjModel, index: int) -> bool:
    """Whether `<option actuatorgroupdisable>` switches this actuator off."""
    group = int(model.actuator_group[index])
    return 0 <= group < 31 and bool(model.opt.disableactuator >> group & 1)


def _may_saturate(model: mujoco.MjModel, index: int) -> bool:
    implicit = model.opt.integrator in _IMPLICIT
    damped = model.actuator_biasprm[index, 2] != 0.0 or model.actuator_gainprm[index, 2] != 0.0
    return bool(implicit and damped and model.actuator_forcelimited[index])


def unknown_to_mjx(model: mujoco.MjModel, index: int) -> str:
    """What of an actuator MJX has no counterpart for: "pid", "slidercrank", ...; "" if nothing."""
    gain, dyn = model.actuator_gaintype[index], model.actuator_dyntype[index]
    bias, trn = model.actuator_biastype[index], model.actuator_trntype[index]
    if model.actuator_plugin[index] >= 0:
        return "plugin"
    for kind, known, enum in (
        (gain, _MJX_GAINS, mujoco.mjtGain),
        (bias, _MJX_BIASES, mujoco.mjtBias),
        (dyn, _MJX_DYNAMICS, mujoco.mjtDyn),
        (trn, _MJX_TRANSMISSIONS, mujoco.mjtTrn),
    ):
        if enum(kind) not in known:
            return enum(kind).name.split("_")[-1].lower()
    return ""


_MJX_GAINS = [mujoco.mjtGain(i) for i in range(3)]  # fixed, affine, muscle
_MJX_BIASES = [mujoco.mjtBias(i) for i in range(3)]  # none, affine, muscle
_MJX_DYNAMICS = [mujoco.mjtDyn(i) for i in range(5)]  # none, integrator, filters, muscle
_MJX_TRANSMISSIONS = [
    mujoco.mjtTrn.mjTRN_JOINT,
    mujoco.mjtTrn.mjTRN_JOINTINPARENT,
    mujoco.mjtTrn.mjTRN_TENDON,
    mujoco.mjtTrn.mjTRN_SITE,
]
_IMPLICIT = (mujoco.mjtIntegrator.mjINT_IMPLICIT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
ACTUATOR_TYPE = "actuator type"
_IGNORES, _NOT_AT_ALL = "ignores it", "refuses the model"
_BOTH = (MJX, WARP)

CLAIMS = (
    Claim("stiffness (polynomial)", _rows("joint", "jnt_stiffnesspoly", "njnt"), _IGNORES, REFUSED,
          f"give one stiffness only, {_MUJOCO_CAN}"),
    Claim("damping (polynomial)", _dof_rows("dof_dampingpoly"), _IGNORES, REFUSED,
          f"give one damping only, {_MUJOCO_CAN}"),
    Claim("tendon stiffness (polynomial)", _rows("tendon", "tendon_stiffnesspoly", "ntendon"),
          _IGNORES, REFUSED, f"give one stiffness only, {_MUJOCO_CAN}"),
    Claim("tendon damping (polynomial)", _rows("tendon", "tendon_dampingpoly", "ntendon"),
          _IGNORES, REFUSED, f"give one damping only, {_MUJOCO_CAN}"),
    Claim(ACTUATOR_TYPE, _undriven(unknown_to_mjx), _NOT_AT_ALL, REFUSED,
          f"this undriven actuator has no counterpart in MJX; remove it, {_MUJOCO_CAN}", _BOTH),
    Claim(DELAY, _undriven(_delayed), _IGNORES, HARMLESS,
          "undriven: its control is constant, so a delay of it changes nothing"),
    Claim("actearly", _undriven(lambda model, i: bool(model.actuator_actearly[i])), _IGNORES,
          HARMLESS, "undriven: its force comes one physics step later, in every engine"),
    Claim("forcerange", _undriven(_may_saturate), "integrates its damping also when it saturates",
          HARMLESS, "the same as MuJoCo as long as this undriven actuator stays within its limits"),
    Claim("flag actuation", _disabled(_DISABLE.mjDSBL_ACTUATION), "switches all off, as C does",
          ASKED, "the drives of the joints that are driven act all the same; what is left undriven "
          "gives no force"),
    Claim(GROUP_OFF, _undriven(_group_off), "applies its force all the same", EMULATED,
          "it is left undriven, and gives no force"),
    Claim("sensor delay", _delayed_sensors, _IGNORES, HARMLESS,
          "sensors are left out: the drive measures the joints, with `measurement_delay`"),
    Claim("flag spring", _disabled(_DISABLE.mjDSBL_SPRING),
          "leaves out dampers and gravity compensation too", EMULATED,
          "springs have stiffness 0 instead"),
    Claim("flag damper", _disabled(_DISABLE.mjDSBL_DAMPER),
          "leaves out springs and gravity compensation too", EMULATED,
          "dampers have damping 0 instead"),
    Claim("noslip_iterations", _option(lambda model: model.opt.noslip_iterations), _IGNORES,
          HARMLESS, "contacts under load creep a little, in every engine"),
    Claim("iterations", _option(_few_iterations), "ends its solver as early", EMULATED,
          f"{ITERATIONS} instead, and {SEARCHES} of a line search, in every engine: a solver that "
          "ends so early leaves the forces of contacts unfinished, as no robot does"),
    Claim("contact margin", _on_planes(margin=True),
          "sees no contact of a box or mesh with a plane before it sinks in", INEXACT,
          "where these touch only `mujoco` has the margin; or set it to 0"),
    Claim("contact corners", _on_planes(margin=False),
          "leaves out corners that are more than 1 mm above the deepest one", INEXACT,
          "where heavy feet sink in further, or land on an edge, only `mujoco` has all of them"),
    Claim("equality", _held_together, "leaves out how anchors accelerate as their bodies turn",
          INEXACT, "forces in it are off, the more the faster it moves; `mujoco` has all of them"),
    Claim("flag sleep", _enabled(_ENABLE.mjENBL_SLEEP), _IGNORES, HARMLESS,
          "nothing falls asleep, in every engine"),
    Claim("flag energy", _enabled(_ENABLE.mjENBL_ENERGY), _NOT_AT_ALL, HARMLESS,
          "not computed; it touches no motion"),
    Claim("flag fwdinv", _enabled(_ENABLE.mjENBL_FWDINV), _NOT_AT_ALL, HARMLESS,
          "not computed; it touches no motion"),
    Claim("flag override", _enabled(_ENABLE.mjENBL_OVERRIDE), _NOT_AT_ALL, REFUSED,
          f"give the contact parameters to the geoms, {_MUJOCO_CAN}", _BOTH),
    Claim("flag diagexact", _enabled(_ENABLE.mjENBL_DIAGEXACT), _NOT_AT_ALL, REFUSED,
          f"remove the flag, {_MUJOCO_CAN}", _BOTH),
    Claim("integrator", _integrator(mujoco.mjtIntegrator.mjINT_IMPLICIT), _NOT_AT_ALL, EMULATED,
          "implicitfast instead, in every engine: without the derivative of Coriolis forces"),
    Claim("integrator", _integrator(mujoco.mjtIntegrator.mjINT_DISCRETE), _NOT_AT_ALL, REFUSED,
          f"use integrator=\"implicitfast\", {_MUJOCO_CAN}"),
    Claim("solver", _option(lambda model: "PGS" if model.opt.solver == mujoco.mjtSolver.mjSOL_PGS
                            else ""), _NOT_AT_ALL, EMULATED,
          "Newton instead, in every engine: it solves the same problem"),
    Claim("density, viscosity", _option(
              lambda model: model.opt.integrator in _IMPLICIT and _in_fluid(model)),
          _NOT_AT_ALL, REFUSED,
          f"use integrator=\"Euler\" with a fluid, {_MUJOCO_CAN}"),
    Claim("fluidshape", _ellipsoids, "takes the body's inertia box instead", REFUSED,
          f"use fluidshape=\"none\", {_MUJOCO_CAN}"),
    Claim("adhesion", _rows("geom", "geom_adhesion", "ngeom"), _IGNORES, REFUSED,
          f"remove it, {_MUJOCO_CAN}"),
    Claim("pair adhesion", _rows("pair", "pair_adhesion", "npair"), _IGNORES, REFUSED,
          f"remove it, {_MUJOCO_CAN}"),
    Claim("surfacevel", _rows("geom", "geom_surfacevel", "ngeom"), _IGNORES, REFUSED,
          f"remove it, {_MUJOCO_CAN}"),
    Claim("flex", _option(lambda model: f"{model.nflex}" if model.nflex else ""), _NOT_AT_ALL,
          REFUSED, f"remove the deformable objects, {_MUJOCO_CAN}", _BOTH),
    Claim("plugin", _plugins, _IGNORES, REFUSED,
          f"remove the plugin, {_MUJOCO_CAN}", _BOTH),
)  # fmt: skip
"""Everything that is known to differ, apart from what concerns the inertia of actuators."""
