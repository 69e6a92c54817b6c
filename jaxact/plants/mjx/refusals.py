"""What MJX itself refuses or warns of in a model: asked of MJX, and told in words."""

from __future__ import annotations

import copy

import mujoco

from jaxact.plants.mjx.plant import put_model
from jaxact.robots.findings import HARMLESS, MJX, Finding, refused
from jaxact.robots.parity import unknown_to_mjx
from jaxact.robots.touching import pair_name, touching

_INSTEAD = "choose the engine `mujoco`"


def find(model: mujoco.MjModel) -> list[Finding]:
    """Everything that MJX refuses or warns of, apart from what `jaxact.robots.parity` knows.

    Args:
        model: with its driven actuators converted.
    """
    probe = _without_known(model)
    types, affinities = probe.geom_contype.copy(), probe.geom_conaffinity.copy()
    probe.geom_contype[:] = probe.geom_conaffinity[:] = 0
    reason, _ = _answer(probe)
    if reason is not None:
        advice = f"remove what it names, or {_INSTEAD}"
        return [refused("model", "MJX", reason, "refuses the model", advice, (MJX,))]
    found: list[Finding] = []
    warned: set[str] = set()
    for kinds, pairs in touching(model, types, affinities).items():
        # one pair of each kind: the one with the widest margin, which not all kinds may have
        first, second = max(pairs, key=lambda pair: model.geom_margin[list(pair)].sum())
        probe.geom_contype[first] = probe.geom_conaffinity[second] = 1
        reason, remarks = _answer(probe)
        warned.update(remarks)
        probe.geom_contype[first] = probe.geom_conaffinity[second] = 0
        if reason is not None:
            found.append(_collision(model, kinds, pairs, "margin" in reason))
    return found + [_remark(text) for text in sorted(warned)]


def _answer(model: mujoco.MjModel) -> tuple[str | None, list[str]]:
    """Why MJX refuses the model, None if it takes it, and what it warns of."""
    try:
        return None, put_model(model)[1]
    except NotImplementedError as error:
        return " ".join(str(error).split()), []


def _remark(text: str) -> Finding:
    return Finding(
        "model", "warning", text, "simulates it", HARMLESS, "the engine `mujoco` does not mind"
    )


def _without_known(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy without what is refused for other reasons, so that MJX gets to what is left."""
    probe = copy.copy(model)
    probe.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    probe.opt.enableflags = 0
    for index in range(probe.nactuator):
        if unknown_to_mjx(probe, index):
            probe.actuator_gaintype[index] = probe.actuator_biastype[index] = 0
            probe.actuator_dyntype[index] = probe.actuator_trntype[index] = 0
    return probe


def _collision(
    model: mujoco.MjModel, kinds: tuple[int, int], pairs: list[tuple[int, int]], margin: bool
) -> Finding:
    names = [mujoco.mjtGeom(kind).name.removeprefix("mjGEOM_").lower() for kind in kinds]
    value = " and ".join(names)
    lacks = f"has no contact margin between {value}" if margin else f"has no {value} contacts"
    return refused(
        pair_name(model, pairs), "contact", value, "refuses the model",
        f"MJX {lacks}; switch them off (contype, conaffinity or <exclude>), use other shapes, or "
        f"{_INSTEAD}",
        (MJX,),
    )  # fmt: skip
