"""Robots with what Python says of them, as the tests of a robot's page read them."""

from pathlib import Path

import numpy as np

import jaxact as jx
from jaxact import files
from jaxact.analysis.robot import multiloop
from jaxact.parameters import KP
from jaxact.verbs import report_robot

ROOT = Path(__file__).resolve().parents[2]
QUADRUPED = ROOT / "experiments" / "quadruped" / "quadruped.xml"
GAINS = {"kp": 100.0, "kd": 3.0}
# Model, keyframe, base, and the parameters of the drives: whole and broken delays, several physics
# steps in a period, differenced velocities, ideal actuators, drives that shake.
CASES = (
    (QUADRUPED, "stand", "fixed", {**GAINS, "delay": 2e-3, "control_rate": 500.0, "wn": 400.0,
                                   "zeta": 0.6}),
    (QUADRUPED, "stand", "free", {**GAINS, "delay": 3.3e-3, "output_delay": 1e-3,
                                  "measurement_delay": 1.7e-3, "control_rate": 200.0, "wn": 110.0,
                                  "zeta": 0.9}),
    (QUADRUPED, "stand", "fixed", {"kp": 300.0, "kd": 15.0, "measurement_delay": 2e-3,
                                   "control_rate": 250.0, "velocity": "differenced",
                                   "velocity_filter": 300.0}),
    # Two summits of the disk margin's curve that are almost alike, far from each other.
    (QUADRUPED, "stand", "fixed", {"kp": 40.8, "kd": 1.224, "delay": 6.842e-3, "wn": 229.4,
                                   "zeta": 0.837, "control_rate": 500.0}),
)  # fmt: skip
PUBLIC = ROOT / ".robots" / "mujoco_playground" / "_src" / "locomotion"
PUBLIC_CASES = tuple(
    (PUBLIC / name / "xmls" / scene, keyframe, base, parameters)
    for name, scene, keyframe, base in (
        ("go1", "scene_mjx_feetonly_flat_terrain.xml", "home", "free"),
        ("op3", "scene_mjx_feetonly.xml", None, "fixed"),
        ("g1", "scene_mjx_feetonly_flat_terrain.xml", "knees_bent", "fixed"),
    )
    for parameters in (
        {"delay": 2e-3, "control_rate": 500.0, "wn": 800.0, "zeta": 0.45},
        {"delay": 1.3e-3, "measurement_delay": 1.7e-3, "control_rate": 200.0, "wn": 300.0,
         "zeta": 0.9},
    )
)  # fmt: skip
# Nearest to its margins at rest.
PUBLIC_CASES += (
    (*PUBLIC_CASES[0][:3], {"kp": 28.3, "kd": 0.0, "delay": 5.1e-3, "control_rate": 500.0,
                            "wn": 820.0, "zeta": 0.8}),
)  # fmt: skip
# Where random points are taken: a robot, its gains, and factors on them.
RANDOM = (
    (QUADRUPED, "stand", "fixed", GAINS, (0.3, 2.0)),
    (QUADRUPED, "stand", "free", GAINS, (0.3, 2.0)),
    (ROOT / "tests" / "data" / "chain.xml", None, "fixed", {"kp": 30.0, "kd": 1.0}, (0.2, 5.0)),
)
FREQUENCIES = 12
TICKS = 200


def random_cases(number, *, seed=0):
    """Cases at random gains, delays and actuators, so many of each of `RANDOM`."""
    rng = np.random.default_rng(seed)
    return tuple(
        (model, keyframe, base, {
            **{name: gain * scale for name, gain in gains.items()}, "control_rate": 500.0,
            "delay": delay, "wn": wn, "zeta": zeta,
        })
        for model, keyframe, base, gains, factors in RANDOM
        for scale, delay, wn, zeta in zip(
            np.exp(rng.uniform(*np.log(factors), number)),
            rng.uniform(0.0, 5e-3, number),
            rng.uniform(200.0, 900.0, number),
            rng.uniform(0.4, 1.1, number),
            strict=True,
        )
    )  # fmt: skip


def rows(cases=CASES, *, seed=0):
    """A row for each robot: the page's data, singular values at random frequencies, margins."""
    rng = np.random.default_rng(seed)
    return [files.plain(_row(*case, rng)) for case in cases]


def _row(model, keyframe, base, parameters, rng):
    loop = jx.robot(model, keyframe=keyframe, base=base, **parameters)
    (found,) = jx.margins(loop).details
    closed = multiloop.multiloop(*found.robot.matrices, found.robot.period)
    angle = np.append(np.exp(rng.uniform(np.log(1e-2), np.log(np.pi), FREQUENCIES)), np.pi)
    S = multiloop.sensitivity(closed, angle)
    data = report_robot.content(loop).parts["robot"]
    (drawn,) = data["loops"]
    used = drawn["plants"][f"{drawn['rate']:.10g}"]
    own = found.margins
    first = own.first_to_shake
    return {
        "robot": f"{model.stem}, {base}, {parameters}",
        "data": data | {"plants": [p if k == used else None for k, p in enumerate(data["plants"])]},
        "angle": angle.tolist(),
        "S": np.linalg.svd(S, compute_uv=False).tolist(),
        "T": np.linalg.svd(np.eye(S.shape[-1]) - S, compute_uv=False).tolist(),
        "unstable_roots": own.unstable_roots,
        "growth_rate": own.growth_rate,
        "verdict": own.verdict,
        "whole": None if own.whole is None else vars(own.whole),
        "joints": [vars(joint) for joint in own.joints],
        "first": None if first is None else first.tolist(),
        "step": _step(found.robot, drawn["drives"][KP]),
        "more_gain": None if own.changes.more_gain is None else own.changes.more_gain.value,
    }


def _step(robot, kp):
    """Positions of all joints at the ticks after a unit step of the last one's setpoint."""
    M, N, _ = robot.matrices
    state, found = np.zeros(len(M)), []
    for _ in range(TICKS):
        found.append(robot.positions @ state)
        # What the setpoint adds to the command is the gain times it.
        state = M @ state + N[:, -1] * kp[-1]
    return np.array(found).tolist()
