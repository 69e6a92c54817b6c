"""Whole commands that people wait for, against the time they may take; programs are kept."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks.timing import Row, failed, seconds

# As the user has it; the process of a group of lines adds what its own JAX needs.
# Of an installed package Python keeps what it has compiled of the sources.
_GIVEN = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
# Of the robots of MuJoCo Playground: joints, scene, options, and what may be taken by the whole
# command and by the margins alone of a robot that is linearised already [s]; None: not limited.
_ROBOTS = (
    ("Go1", 12, "go1/xmls/scene_mjx_feetonly_flat_terrain.xml",
     ("--keyframe", "home", "--delay", "0.005"), 2.0, 0.3),
    ("OP3", 20, "op3/xmls/scene_mjx_feetonly.xml",
     ("--keyframe", "stand_bent_knees", "--delay", "0.002", "--base", "fixed"), 3.5, None),
    ("G1", 29, "g1/xmls/scene_mjx_feetonly_flat_terrain.xml",
     ("--delay", "0.002", "--base", "fixed"), 4.5, 1.5),
)  # fmt: skip
_JOINT = ("margins", "--actuator", "hyq")
# What that command imports, and nothing else of it.
_IMPORTS = "import tyro, jaxact.cli.margins, jaxact.loops.building, jaxact.verbs.margins"


def rows(quick: bool) -> Iterator[Row]:
    """Lines of the table: margins of a joint, importing within it, and margins of robots."""
    repeats = 1 if quick else 5
    words = "-m", "jaxact", *_JOINT
    joint = within("the whole command `jaxact margins` of one joint", python(*words), repeats, 0.8)
    yield joint
    if not joint.failure:
        importing = seconds(python("-c", _IMPORTS), repeats)
        yield Row(
            "importing what `jaxact margins` of one joint uses", "that whole command",
            importing, joint.ours, "command", "none: what it costs", 0.0,
        )  # fmt: skip
    with tempfile.TemporaryDirectory() as made:
        whole = _margins_map(Path(made), 2 if quick else 10)
        what = "1,000 combinations of gains and delay of a quadruped, all margins"
        yield within(what, whole, repeats, 20.0)
    folder = locomotion()
    if folder is None:
        print("no MuJoCo Playground: the commands of its robots are left out")
        return
    for name, joints, scene, options, most, alone in _ROBOTS[: 1 if quick else None]:
        whole = python("-m", "jaxact", "margins", "--model", str(folder / scene), *options)
        what = f"the whole command `jaxact margins` of {name}, {joints} joints"
        yield within(what, whole, repeats, most)
        if alone is not None:
            evaluation = _evaluation(folder / scene, options)
            yield within(f"margins of {name} alone, linearised already", evaluation, repeats, alone)


def within(what: str, command: Callable[[], object], repeats: int, most: float) -> Row:
    """A line of something against the seconds that it may take."""
    rival, target = f"the {most:g} s it may take", "at least 1"
    try:
        taken = seconds(command, repeats)
    except subprocess.CalledProcessError as error:
        return failed(what, f"exit code {error.returncode}", rival, target)
    return Row(what, rival, taken, most, "command", target, 1.0)


def python(*words: str, folder: Path | None = None) -> Callable[[], object]:
    """Runs Python with these words, in a folder, and gives what it ended with."""
    return lambda: subprocess.run(
        [sys.executable, *words], check=True, stdout=subprocess.DEVNULL, cwd=folder, env=_GIVEN
    )


def _margins_map(folder: Path, along: int) -> Callable[[], object]:
    """The command that maps margins of the quadruped over kp, kd and delay, so many of each."""
    specification = folder / "map.toml"
    model = Path("experiments/quadruped/quadruped.xml").resolve()
    specification.write_text(
        f'''engine = "linear"
[plant]
model = "{model}"
keyframe = "stand"
[parameters]
actuator = "hyq"
[axes]
kp = {{ min = 100, max = 3000, num = {along}, spacing = "log" }}
kd = {{ min = 3, max = 120, num = {along}, spacing = "log" }}
delay = {{ min = 0.0, max = 0.005, num = {along} }}
'''
    )
    words = ("sweep", str(specification), "--out", str(folder / "map"), "--overwrite")
    return python("-m", "jaxact", *words)


def locomotion() -> Path | None:
    """The folder of the Playground's robots; found without importing it."""
    found = importlib.util.find_spec("mujoco_playground")
    if found is None or not found.submodule_search_locations:
        return None
    return Path(found.submodule_search_locations[0]) / "_src" / "locomotion"


def _evaluation(model: Path, options: tuple[str, ...]) -> Callable[[], object]:
    import jaxact
    from jaxact.analysis.robot.margins import robot_margins

    given = {
        name.removeprefix("--"): float(value) if name == "--delay" else value
        for name, value in zip(options[::2], options[1::2], strict=True)
    }
    robot = jaxact.margins(jaxact.robot(model, **given)).details[0].robot
    return lambda: robot_margins(robot)
