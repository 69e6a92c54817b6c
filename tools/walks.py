"""The walks of two commands through the layers: where a path climbs back to a higher one.

    python tools/walks.py [--all]

A walk is the order in which a command first enters the modules of the package, beside those that
every layer stands on (`GROUND`) and what only runs while modules are loaded. It climbs where the
next module is of a higher layer than the one before: a layer was left out, and what a lower one
made is carried up to it. Where the next module is of the layer of the function that calls it,
control has only come back there, as it does from any call: returns are counted apart. So are calls
that go up, from code of a lower layer to a function of a higher one that it was given. The exit
code is 1 where a walk climbs more often than `MOST`.
"""

from __future__ import annotations

import ast
import contextlib
import io
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "jaxact"
GROUND = ("errors", "status", "files", "parameters", "compilation")
MOST = 3
CLIMB, RETURN, DOWN = "^", "<", " "
SPECIFICATION = """
engine = "mass"
duration = 0.2
[axes]
kp = { min = 10, max = 1e5, num = 4, spacing = "log" }
kd = [1, 10]
"""
ROBOT = """
<mujoco><worldbody><body><joint name="hinge" axis="0 1 0" armature="0.02"/>
<geom size="0.02" mass="0.1" pos="0.2 0 0"/></body></worldbody>
<actuator><position name="hinge" joint="hinge" kp="80" kv="2"/></actuator></mujoco>
"""


def layers() -> tuple[str, ...]:
    """The layers from low to high, from the test that guards them."""
    tree = ast.parse((ROOT / "tests" / "test_architecture.py").read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "LAYERS":
            return tuple(ast.literal_eval(node.value))
    raise LookupError("LAYERS")


class Walk:
    """Records the modules that calls enter, by `sys.setprofile`."""

    def __init__(self) -> None:
        self.modules: dict[str, str] = {}
        self.callers: dict[str, str | None] = {}
        self.upward: set[tuple[str, str]] = set()
        self._layers = [name for name in layers() if name not in GROUND]
        self._known: dict[str, str | None] = {}

    def __call__(self, frame: FrameType, event: str, _argument: object) -> None:
        """A profiler's event."""
        module = self._module(frame) if event == "call" else None
        if module is None or frame.f_code.co_name.startswith("<"):
            return
        below = self._callers(frame)
        if any(one.f_code.co_name == "<module>" for one in below):
            return
        caller = self._module(below[0]) if below else None
        self.modules.setdefault(module, frame.f_code.co_name)
        self.callers.setdefault(module, caller)
        if caller is not None and self.rank(module) > self.rank(caller):
            self.upward.add((caller, module))

    def step(self, before: str | None, module: str) -> str:
        """What a walk does between two modules that it enters one after the other."""
        if before is None or self.rank(module) <= self.rank(before):
            return DOWN
        caller = self.callers[module]
        own = caller is not None and self.rank(caller) == self.rank(module)
        return RETURN if own else CLIMB

    def rank(self, module: str) -> int:
        """Of the module's layer."""
        return self._layers.index(module.partition("/")[0])

    def _callers(self, frame: FrameType) -> list[FrameType]:
        """The frames of the package below, the nearest first."""
        found, one = [], frame.f_back
        while one is not None:
            if self._module(one) is not None:
                found.append(one)
            one = one.f_back
        return found

    def _module(self, frame: FrameType) -> str | None:
        """The module of a frame as `folder/name`; None outside of the layers."""
        name = frame.f_code.co_filename
        if name not in self._known:
            path = Path(name)
            inside = path.is_relative_to(PACKAGE) and len(path.relative_to(PACKAGE).parts) > 1
            own = path.relative_to(PACKAGE).as_posix() if inside else ""
            self._known[name] = own if own.partition("/")[0] in self._layers else None
        return self._known[name]


def walked(command: list[str]) -> Walk:
    """The walk of a command that is run in this process."""
    from jaxact.cli.main import main

    walk = Walk()
    set_profile: tuple[Callable, ...] = (sys.setprofile, threading.setprofile)
    try:
        for each in set_profile:
            each(walk)
        with contextlib.redirect_stdout(io.StringIO()):
            main(command)
    finally:
        for each in set_profile:
            each(None)
    return walk


def main() -> int:
    """Print the walks; 1 where one climbs too often."""
    most = 0
    with tempfile.TemporaryDirectory() as folder:
        specification, robot = Path(folder) / "small.toml", Path(folder) / "robot.xml"
        specification.write_text(SPECIFICATION)
        robot.write_text(ROBOT)
        for command in (
            ["sweep", str(specification), "--out", str(Path(folder) / "out"), "--quiet"],
            ["margins", "--model", str(robot), "--actuator", "starleth"],
        ):
            walk, before = walked(command), None
            lines, steps = [], []
            for module, function in walk.modules.items():
                steps.append(walk.step(before, module))
                lines.append(f"  {steps[-1]} {module}: {function}")
                before = module
            climbs = steps.count(CLIMB)
            most = max(most, climbs)
            print(
                f"{command[0]}: climbs {climbs} times; returns {steps.count(RETURN)} times; "
                f"calls that go up: {len(walk.upward)}"
            )
            if "--all" in sys.argv:
                print("\n".join([*lines, *(f"  {a} -> {b}" for a, b in sorted(walk.upward))]))
    return int(most > MOST)


if __name__ == "__main__":
    sys.exit(main())
