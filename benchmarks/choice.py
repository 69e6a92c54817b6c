"""Whether `engine = "auto"` of a sweep is the faster engine on a CPU, programs being compiled anew.

    python -m benchmarks.choice                 # measures what was not yet, and writes the table
    python -m benchmarks.choice --run "Go1" mjx 512 4.0     # a whole sweep, from the shell

The time of a sweep is  start + steps x step, where the start has all compiling in it. Both are
measured of each robot in each engine, in a process of its own: a sweep, and the same sweep once
more, with the programs that there are then. Times are the processor's, of all cores together, which
what else runs on a machine changes less than the wall clock. A choice is right if its time is the
smaller one, or at most a tenth more.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from benchmarks.commands import locomotion
from jaxact.cli import _xla
from jaxact.engines import AUTO

Row = dict[str, Any]

ENGINES = ("mjx", "mujoco")
# Loops, and how long each is simulated [s].
SIZES = ((100, 1.0), (1000, 2.0), (2500, 2.0), (10000, 4.0))
MEASURED = Path("results/choice/measured.jsonl")
HEADER = (
    '# Which engine `engine = "auto"` takes on a CPU, and which one is faster',
    "",
    "Made by `python -m benchmarks.choice`, on two cores of an AMD EPYC that others used as well.",
    "Processor time of whole sweeps [s], everything compiled anew; * was run as a command, the",
    "others are computed from the start and the time of a physics step (measured.jsonl), most of",
    "them in a rollout of 1 s. Right is the engine that takes less, or at most a tenth more. The",
    "rule was made from the same measurements.",
    "",
    "| robot | loops | physics steps | MJX | C MuJoCo | auto | right |",
    "|---|---|---|---|---|---|---|",
)
_LOCOMOTION = locomotion() or Path("mujoco_playground")
_QUADRUPED = Path("experiments/quadruped")
_PLAIN = "kp = 60\nkd = 1.5"
_STIFF = "kp = 400\nkd = 20"
_LEGS = 'kp = 709\nkd = 20\n"kd@.*_HAA" = 39.9\n"kd@.*_HFE" = 41.4\n"kd@.*_KFE" = 5.57'
_HINGE = """<mujoco><option timestep="0.001"/><worldbody><body>
<joint name="hinge" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.03" mass="1"
contype="0" conaffinity="0"/></body></worldbody>
<actuator><motor joint="hinge"/></actuator></mujoco>"""


@dataclasses.dataclass(frozen=True)
class Robot:
    """A robot's model, posture and base, and parameters beside those of the drive.

    Attributes:
        file: MJCF, or its text.
        keyframe: "" for none.
        base: as in specifications.
        parameters: TOML.
        replaced: what of the file's text becomes what else.
    """

    file: Path | str
    keyframe: str = ""
    parameters: str = ""
    base: str = "free"
    replaced: tuple[tuple[str, str], ...] = ()


_DAMPED = 'armature="0.1" damping="1"'
_ARM = Robot(Path("benchmarks/arm.xml"), "reach", _STIFF)
_STAND = Robot(_QUADRUPED / "quadruped.xml", "stand", _LEGS)


def _of_playground(name: str, scene: str, keyframe: str, base: str = "free") -> Robot:
    return Robot(_LOCOMOTION / name / "xmls" / scene, keyframe, base=base)


def _arm(more: str) -> Robot:
    return dataclasses.replace(_ARM, replaced=((_DAMPED, f"{_DAMPED} {more}"),))


_FLAT = "scene_mjx_feetonly_flat_terrain.xml"
ROBOTS = {
    "hinge": Robot(_HINGE, "", _PLAIN),
    "two hinges": Robot(Path("experiments/engines/pendulum.xml"), "bent", _PLAIN),
    "two hinges with limits": Robot(
        Path("experiments/engines/pendulum.xml"),
        "bent",
        _PLAIN,
        replaced=(('damping="0.05"', 'damping="0.05" limited="true" range="-170 170"'),),
    ),
    "arm": _ARM,
    "arm with limits": _arm('limited="true" range="-170 170"'),
    "arm with limits and friction": _arm('limited="true" range="-170 170" frictionloss="1"'),
    "quadruped": _STAND,
    "quadruped on three feet": dataclasses.replace(_STAND, keyframe="three"),
    "quadruped, hung": Robot(_QUADRUPED / "quadruped_hung.xml", "hang", _LEGS),
    "quadruped with an arm": Robot(
        _QUADRUPED / "quadruped_arm.xml", "stand", f'{_LEGS}\n"kp@arm_.*" = 60\n"kd@arm_.*" = 1.5'
    ),
    "Go1": _of_playground("go1", _FLAT, "home"),
    "Go1, fixed": _of_playground("go1", _FLAT, "home", "fixed"),
    "Berkeley Humanoid": _of_playground("berkeley_humanoid", _FLAT, "home"),
    "G1, fixed": _of_playground("g1", _FLAT, "knees_bent", "fixed"),
}


def written(robot: Robot, folder: Path, engine: str, loops: int, duration: float) -> Path:
    """The specification of a sweep over the gains of a robot under its drives, in a folder."""
    model = robot.file
    if isinstance(model, str) or robot.replaced:
        text = model if isinstance(model, str) else model.read_text(encoding="utf-8")
        for old, new in robot.replaced:
            text = text.replace(old, new)
        model = folder / "model.xml"
        model.write_text(text, encoding="utf-8")
    keyframe = f'keyframe = "{robot.keyframe}"' if robot.keyframe else ""
    path = folder / "sweep.toml"
    path.write_text(
        f"""
        engine = "{engine}"
        duration = {duration}
        [plant]
        model = "{model.resolve()}"
        base = "{robot.base}"
        {keyframe}
        [parameters]
        actuator = "hyq"
        delay = 0.001
        measurement_delay = 0.0005
        position_noise = 1e-5
        {robot.parameters}
        [axes]
        gain_scale = {{ min = 0.8, max = 1.0, num = {loops} }}
        """,
        encoding="utf-8",
    )
    return path


def _seconds(work: Callable[[], object], who: int = resource.RUSAGE_SELF) -> tuple[float, float]:
    """Wall clock and processor time of some work [s]."""
    before, begun = resource.getrusage(who), time.perf_counter()
    work()
    wall, after = time.perf_counter() - begun, resource.getrusage(who)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _measured(name: str, engine: str, loops: int, duration: float) -> Row:
    """A sweep and the same sweep once more, and what share of its loops is stable."""
    _xla.prepare(all_cores=True)
    _xla.enlarge_pool()
    from jaxact.loops import reading
    from jaxact.loops.samples import expand
    from jaxact.simulation import execute, plans
    from jaxact.status import Verdict

    with tempfile.TemporaryDirectory() as folder:
        asked = reading.load(written(ROBOTS[name], Path(folder), engine, loops, duration), ())
        _xla.call_at_once(asked)
        samples, found = expand(asked), {}
        first = _seconds(lambda: found.update(execute.run(asked, samples)))
        second = _seconds(lambda: execute.run(asked, samples))
        steps = loops * plans.groups(asked, samples)[0].steps
    return {
        "robot": name, "engine": engine, "loops": loops, "duration": duration, "steps": steps,
        "first": first, "second": second,
        "stable": float((found["verdict"] == Verdict.STABLE).mean()),
    }  # fmt: skip


def _run(name: str, engine: str, loops: int, duration: float) -> Row:
    """`jaxact sweep` from the shell with an empty cache."""
    with tempfile.TemporaryDirectory() as folder:
        path = written(ROBOTS[name], Path(folder), engine, loops, duration)
        words = ("-m", "jaxact", "sweep", str(path), "--out", f"{folder}/out", "--quiet")
        given = os.environ | {"XDG_CACHE_HOME": folder}

        def work() -> None:
            subprocess.run([sys.executable, *words], check=True, env=given)

        whole = _seconds(work, resource.RUSAGE_CHILDREN)
    return {
        "robot": name, "engine": engine, "loops": loops, "duration": duration, "whole": whole,
    }  # fmt: skip


def _chosen(name: str, loops: int, duration: float) -> tuple[str, int]:
    """The engine that "auto" comes to, and the physics steps of the sweep."""
    from jaxact.loops import reading
    from jaxact.loops.samples import expand
    from jaxact.simulation import engines, plans
    from jaxact.sweeping import throughput

    with tempfile.TemporaryDirectory() as folder:
        asked = reading.load(written(ROBOTS[name], Path(folder), AUTO, loops, duration), ())
        samples = expand(asked)
        steps = loops * plans.groups(engines.resolved(asked), samples)[0].steps
        return throughput.fastest(asked, samples, say=None), steps


def _lines(rows: list[Row]) -> Iterator[tuple[str, bool]]:
    """The table's lines, and whether the choice is right in each."""
    parts = {(row["robot"], row["engine"]): row for row in rows if "first" in row}
    whole = {
        (row["robot"], row["engine"], row["loops"], row["duration"]): row["whole"][1]
        for row in rows
        if "whole" in row
    }
    for name in ROBOTS:
        if not all((name, engine) in parts for engine in ENGINES):
            continue
        for loops, duration in SIZES:
            chosen, steps = _chosen(name, loops, duration)
            times, run = {}, []
            for engine in ENGINES:
                row, case = parts[name, engine], (name, engine, loops, duration)
                each = row["second"][1] / row["steps"]
                times[engine] = row["first"][1] - row["second"][1] + steps * each
                if case in whole:
                    times[engine] = whole[case]
                    run.append(engine)
            right = times[chosen] <= 1.1 * min(times.values())
            words = [
                name, f"{loops:,} x {duration:g} s", f"{steps:.2g}",
                *(f"{times[engine]:,.0f}{'*' if engine in run else ''}" for engine in ENGINES),
                chosen, "yes" if right else "**no**",
            ]  # fmt: skip
            yield f"| {' | '.join(words)} |", right


def _known() -> list[Row]:
    if not MEASURED.is_file():
        return []
    return [json.loads(line) for line in MEASURED.read_text("utf-8").splitlines()]


def _keep(row: Row) -> None:
    MEASURED.parent.mkdir(parents=True, exist_ok=True)
    with MEASURED.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


def _measure_missing() -> None:
    """Measure each robot in each engine, each in a process of its own."""
    known = {(row["robot"], row["engine"]) for row in _known() if "first" in row}
    for name in ROBOTS:
        for engine in ENGINES:
            if (name, engine) not in known:
                words = (name, engine, "128", "1.0")
                subprocess.run(
                    [sys.executable, "-m", __spec__.name, "--measure", *words], check=True
                )


def main() -> None:
    """Measure, and write the table."""
    arguments = argparse.ArgumentParser(description=__doc__)
    for option in ("--measure", "--run"):
        names = ("ROBOT", "ENGINE", "LOOPS", "DURATION")
        arguments.add_argument(option, nargs=4, metavar=names, help="keep this one")
    asked = arguments.parse_args()
    for words, work in ((asked.measure, _measured), (asked.run, _run)):
        if words:
            _keep(work(words[0], words[1], int(words[2]), float(words[3])))
            return
    _measure_missing()
    _xla.prepare(all_cores=True)
    _xla.enlarge_pool()
    lines = list(_lines(_known()))
    right = sum(right for _, right in lines)
    text = "\n".join(
        [*HEADER, *(line for line, _ in lines), "", f"Right: {right} of {len(lines)}."]
    )
    MEASURED.with_name("README.md").write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
