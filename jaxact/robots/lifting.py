"""What is said of the fields of an actuator that become its drive's."""

from __future__ import annotations

import math

import mujoco

from jaxact.parameters import DELAY
from jaxact.robots import actuators, selection
from jaxact.robots.actuators import FORCE, Law
from jaxact.robots.findings import EMULATED, HARMLESS, LIFTED, Finding
from jaxact.robots.selection import Driven


def findings(model: mujoco.MjModel, driven: Driven) -> list[Finding]:
    """What is said about the fields of a driven actuator that became the drive's."""
    law = driven.law
    where = actuators.label(model, law.index)
    found = selection.shared_limit(model, driven)
    if law.delay > 0.0:
        which = "command delay" if law.commands == FORCE else "setpoint delay"
        given = float(model.actuator_delay[law.index])
        advice = f"the drive's {which} is {law.delay:g} s"
        if abs(law.delay - given) > 1e-9:
            advice += f", which MuJoCo makes of {given:g} s in whole steps and its buffer"
        found.append(Finding(where, DELAY, f"{given:g} s", "ignores it", LIFTED, advice))
    if law.integrated:
        found.append(
            Finding(
                where,
                "dyntype",
                "integrator",
                "simulates it",
                LIFTED,
                "the drive holds the position setpoint that the integrated control has reached",
            )  # fmt: skip
        )
    if law.viscous > 0.0:
        found.append(
            Finding(
                where,
                "biasprm",
                f"{law.viscous:g} at the joint",
                "simulates it",
                EMULATED,
                "the motor's own damping is added to the joint's",
            )  # fmt: skip
        )
    if law.lag > 0.0:
        found.append(_lag_finding(where, law))
        if law.commands == FORCE and (math.isfinite(law.low) or math.isfinite(law.high)):
            found.append(_clamp_finding(model, where, law))
    found += [
        Finding(
            actuators.label(model, partner.index),
            "kv",
            f"{partner.kd:g}",
            "simulates it",
            LIFTED,
            f"its damping is part of the drive of {where}",
        )  # fmt: skip
        for partner in driven.partners
    ]
    return found


def _lag_finding(where: str, law: Law) -> Finding:
    value = f"filter, {law.lag:g} s"
    if law.commands != FORCE:
        return Finding(
            where, "dyntype", value, "simulates it", HARMLESS,
            "it smooths the setpoint, outside the loop; the drive follows its setpoint directly",
        )  # fmt: skip
    wn, zeta = law.lag_as_loop
    return Finding(
        where, "dyntype", value, "simulates it", LIFTED,
        f"the drive's actuator is wn = {wn:.4g} rad/s, zeta = {zeta:.4g} unless given otherwise",
    )  # fmt: skip


def _clamp_finding(model: mujoco.MjModel, where: str, law: Law) -> Finding:
    first = int(model.actuator_ctrladr[law.index])
    clamped = model.actuator_ctrllimited[first]
    low, high = model.actuator_ctrlrange[first] if clamped else model.actuator_actrange[law.index]
    return Finding(
        where, "ctrlrange" if clamped else "actrange", f"{low:g} {high:g}", "simulates it", LIFTED,
        "MuJoCo clamps the command before the filter, the drive limits the force behind its "
        "actuator: while a command is beyond the limit, the force follows another course",
    )  # fmt: skip
