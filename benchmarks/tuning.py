"""Tuning: many joints at once against SciPy's Nelder-Mead, and robots as whole commands."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.commands import locomotion, python, within
from benchmarks.timing import Row, alternate

_QUADRUPED = (
    "--spec", "stand.toml", "three.toml", "hang.toml", "--groups", "HAA,HFE,KFE", "--actuator",
    "hyq", "--uncertainty", "wn=0.9..1.1,output_delay=0..1e-3", "--max-peak", "6",
)  # fmt: skip
_G1 = (
    "--base", "fixed", "--damping", "drive", "--groups",
    "hip,knee,ankle,waist,shoulder,elbow,wrist", "--actuator", "starleth", "--uncertainty",
    "wn=0.9..1.1,delay=1e-3..3e-3", "--max-peak", "7",  # the least that was found is 5.6
)  # fmt: skip
# Less of everything, which may take as long.
_QUICK = ("--ensemble", "2", "--starts", "2", "--steps", "20", "--validate", "0")


def rows(quick: bool) -> Iterator[Row]:
    """Lines of the table: a joint of many, one ensemble of 32, and robots."""
    yield from _joints(quick)
    yield from _robots(quick)


def _robots(quick: bool) -> Iterator[Row]:
    """From the command to the certificate, rollouts and pictures included."""
    repeats, how = (1, _QUICK) if quick else (3, ())
    words = ("-m", "jaxact", "tune", *how)
    with tempfile.TemporaryDirectory() as made:
        out = ("--out", str(Path(made) / "tuned"), "--overwrite")
        samples = () if quick else ("--ensemble", "16")
        experiment = Path("experiments/quadruped").resolve()
        command = python(*words, *_QUADRUPED, *samples, *out, folder=experiment)
        what = "`jaxact tune` of the quadruped in three postures, 16 members"
        less = ", but less of everything" if quick else ""
        yield within(f"{what}{less}", command, repeats, 45.0)
        folder = locomotion()
        if folder is None or quick:
            return
        scene = str(folder / "g1/xmls/scene_mjx_feetonly_flat_terrain.xml")
        command = python(*words, "--model", scene, *_G1, *out)
        yield within("`jaxact tune` of G1, 29 joints in seven groups", command, repeats, 180.0)


def _joints(quick: bool) -> Iterator[Row]:
    """A joint of many, and one ensemble of 32."""
    from jaxact.tuning.goal import Goal
    from jaxact.tuning.joint.ensemble import ensemble
    from jaxact.tuning.joint.problem import Case
    from jaxact.tuning.joint.search import tune_all

    number = 4 if quick else 64
    random = np.random.default_rng(0)
    plants = np.stack([
        np.exp(random.uniform(np.log(0.02), np.log(8.0), number)),
        np.exp(random.uniform(np.log(40.0), np.log(1200.0), number)),
        random.uniform(0.25, 1.3, number), random.uniform(0.0, 12e-3, number),
    ])  # fmt: skip
    goal = Goal(max_peak=1.6)
    cases = [Case(ensemble(*plant), goal) for plant in plants.T]
    members = ensemble(0.7, random.uniform(90, 130, 32), 0.9, random.uniform(0, 5e-3, 32))

    def joints() -> float:
        tune_all(cases)
        return number

    def together() -> float:
        tune_all([Case(members, goal)])
        return 1

    for what, ours, theirs in (
        (f"gains of a joint, {number} at once, certified", joints, cases[:3]),
        ("gains for an ensemble of 32 actuators, certified", together, [Case(members, goal)]),
    ):

        def rival(theirs=theirs) -> float:
            for case in theirs:
                _nelder_mead(case)
            return len(theirs)

        yield Row(what, "Nelder-Mead of SciPy, one start, same exact objective",
                  *alternate(ours, rival, 3), "tuning", "at least 1", 1.0)  # fmt: skip


def _nelder_mead(case) -> None:
    import scipy.optimize

    from jaxact.tuning.joint import problem as joint

    problem = joint.problem([case])
    # From the gains of the SIMC rule (Skogestad, Journal of Process Control 13, 2003).
    lag, mass = 2.0 * case.members.lag.max(), case.members.mass.min()
    kp, kd = mass / (4.0 * lag**2), mass / lag

    def penalised(x: np.ndarray) -> float:
        found = problem(x[None])
        return float(-x[0] + 40.0 * max(found.violation[0], 0.0)) if found.usable[0] else 1e3

    scipy.optimize.minimize(penalised, np.log([kp, kd]), method="Nelder-Mead",
                            options={"xatol": 1e-5, "fatol": 1e-6})  # fmt: skip
