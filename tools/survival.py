"""What survives: sweeps that are killed, and results that are damaged, many times over.

    python tools/survival.py kills --number 300 --seed 1
    python tools/survival.py damages --number 600 --seed 1

`kills` ends sweeps of one degree of freedom, plain and adaptive, with SIGKILL, SIGTERM, SIGHUP, one
Ctrl-C or two, at random moments from the start of the interpreter to the end, up to three times in
a row, each time resumed or begun anew with `--overwrite`; the last command runs undisturbed. What
is in the folder then must be what an undisturbed sweep leaves: the same file names, the same bytes
but for when and by which command it was begun. No signal may end in a traceback, and exit codes
must be those of the manual.

`damages` flips a bit of a file of a store, cuts it off or removes it. `status`, `validate`, `plot`
and `export` must each refuse the store with exit code 2 and one line, and write nothing; `sweep
--resume` must make it what it was, byte for byte.

The exit code is 1 where anything else happened. A tenth of the sweeps are processes of their own,
imports included; the others are forks of one that has imported everything, in small chunks.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import dataclasses
import io
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
SWEEP = """
engine = "mass"
duration = 0.1
tile = 8
[parameters]
actuator = "starleth"
position_noise = 1e-4
[axes]
delay = [0.0, 0.005]
kp = { min = 10, max = 1e5, num = 5, spacing = "log" }
kd = { min = 0.1, max = 2000, num = 5, spacing = "log" }
"""
KINDS: dict[str, list[str]] = {"grid": [], "adaptive": ["--adaptive", "--width", "0.2"]}
_CHUNK = 16  # loops
# What ends a sweep: the signals, in order, and the exit codes that it may then have.
ENDS: dict[str, tuple[tuple[int, ...], tuple[int, ...]]] = {
    "SIGKILL": ((signal.SIGKILL,), (-signal.SIGKILL,)),
    "SIGTERM": ((signal.SIGTERM,), (143,)),
    "SIGINT": ((signal.SIGINT,), (130,)),
    "SIGINT twice": ((signal.SIGINT, signal.SIGINT), (130,)),
    "SIGHUP": ((signal.SIGHUP,), (129,)),
}


def small_chunks() -> None:
    """Have the command line cut sweeps of this process into small chunks."""
    from jaxact.sweeping import planning

    usual = planning.plan

    def plan(*given: Any, **named: Any) -> planning.Planned:
        return dataclasses.replace(usual(*given, **named), loops=_CHUNK)

    planning.plan = plan


def contents(folder: Path, *, same_run: bool = False) -> dict[str, bytes]:
    """Every file below a folder by its path.

    folder: of the results
    same_run: keep when and by which command the sweep was begun, which other runs do not share
    """
    found = {}
    for path in sorted(folder.rglob("*")):
        if not path.is_file():
            continue
        content = path.read_bytes()
        if path.name == "zarr.json" and path.parent.name == "sweep.zarr" and not same_run:
            root = json.loads(content)
            for name in ("created", "command"):
                root["attributes"].pop(name, None)
            content = json.dumps(root, indent=2).encode()
        found[path.relative_to(folder).as_posix()] = content
    return found


def serve() -> None:
    """Fork a command line for every line of standard input; say its number and how it ended."""
    import xarray  # noqa: F401
    import zarr  # noqa: F401

    from jaxact.cli import main, sweep  # noqa: F401
    from jaxact.plotting import theme  # noqa: F401
    from jaxact.simulation import execute, kernel, spectra  # noqa: F401

    small_chunks()
    for line in sys.stdin:
        request = json.loads(line)
        number = os.fork()
        if not number:
            os.dup2(os.open(request["stderr"], os.O_WRONLY | os.O_CREAT | os.O_APPEND), 2)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            sys.argv = ["jaxact", *request["arguments"]]
            main.entry()
        print(number, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(number, 0)[1]), flush=True)


class Server:
    """Runs command lines: forks of one process, or processes of their own."""

    def __init__(self, folder: Path) -> None:
        """Start it; folder: for its files."""
        self.folder = folder
        self.environment = os.environ | {
            "PYTHONPATH": str(ROOT), "TF_CPP_MIN_LOG_LEVEL": "3", "JAX_PLATFORMS": "cpu",
            "JAXACT_PROGRAMS": os.environ.get("JAXACT_PROGRAMS", str(folder / "programs")),
        }  # fmt: skip
        self.process = subprocess.Popen(
            [sys.executable, __file__, "serve"], cwd=folder, env=self.environment, bufsize=0,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip

    def run(
        self, arguments: list[str], *, fork: bool, disturb: Callable[[int], None] | None = None
    ) -> tuple[int, str]:
        """The exit code of a command line, and what it said on standard error.

        arguments: what follows `jaxact`
        fork: rather than a process of its own
        disturb: is given its process id once it runs
        """
        said = self.folder / "said.txt"
        said.write_text("")
        if not fork:
            with said.open("w") as file:
                one = subprocess.Popen(
                    [sys.executable, "-m", "jaxact", *arguments], cwd=self.folder,
                    env=self.environment, stdout=subprocess.DEVNULL, stderr=file,
                )  # fmt: skip
                if disturb is not None:
                    disturb(one.pid)
                return one.wait(), said.read_text()
        assert self.process.stdin is not None and self.process.stdout is not None
        request = json.dumps({"arguments": arguments, "stderr": str(said)})
        self.process.stdin.write(f"{request}\n".encode())
        number = int(self.process.stdout.readline())
        if disturb is not None:
            disturb(number)
        return int(self.process.stdout.readline()), said.read_text()

    def close(self) -> None:
        """End it."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.close()
        self.process.wait()
        self.process.stdout.close()


@dataclass
class Undisturbed:
    """What a sweep leaves that nobody has disturbed, and the time it took [s]."""

    files: dict[str, bytes]
    seconds: float


def _undisturbed(server: Server, kind: str, *, fork: bool) -> Undisturbed:
    for name in ("warm", "calm"):  # the first compiles
        begun = time.perf_counter()
        out = server.folder / f"{name} {kind} {fork}"
        code, said = server.run(["sweep", "sweep.toml", "--out", str(out), *KINDS[kind]], fork=fork)
        assert code == 0, said
    return Undisturbed(contents(out), time.perf_counter() - begun)


def kills(number: int, seed: int, folder: Path) -> list[str]:
    """What was not as it should be after so many kills; seed: of all that is random."""
    chance = random.Random(seed)
    (folder / "sweep.toml").write_text(SWEEP)
    server = Server(folder)
    ways = [(kind, fork) for kind in KINDS for fork in (True, False)]
    calm = {way: _undisturbed(server, way[0], fork=way[1]) for way in ways}
    wrong: list[str] = []
    count: collections.Counter[str] = collections.Counter()
    while sum(count[end] for end in ENDS) < number:
        kind, fork = chance.choice(list(KINDS)), chance.random() < 0.9
        out, told = folder / "out", f"{kind}, {'fork' if fork else 'process'}: "
        command = ["sweep", "sweep.toml", "--out", str(out), *KINDS[kind]]
        for _ in range(chance.choice([1, 1, 2, 3])):
            end, more = chance.choice(list(ENDS)), chance.choice(["--resume", "--overwrite"])
            told += f"{more} {end}; "
            moment = chance.uniform(0.0, calm[kind, fork].seconds)
            disturb = _disturbance(end, moment, chance)
            ended = server.run([*command, more], fork=fork, disturb=disturb)
            count[end] += 1
            wrong += _misbehaved(told, end, *ended, count)
        last = chance.choice(["--resume", "--overwrite"])
        code, said = server.run([*command, last], fork=fork)
        if code or said or contents(out) != calm[kind, fork].files:
            names = sorted(set(contents(out)) ^ set(calm[kind, fork].files))
            wrong.append(f"{told}{last}: code {code}, other files: {names[:4]} {said[-300:]}")
        count["sweeps compared"] += 1
        _show(count, wrong)
        shutil.rmtree(out, ignore_errors=True)
    server.close()
    print(", ".join(f"{what}: {times}" for what, times in sorted(count.items())))
    return wrong


def _show(count: collections.Counter[str], wrong: list[str]) -> None:
    """Where it stands, on a terminal or in a log."""
    print(f"{dict(count)}, {len(wrong)} wrong", file=sys.stderr, flush=True)


def _disturbance(end: str, moment: float, chance: random.Random) -> Callable[[int], None]:
    """Sends the signals of an end to a process, after so long [s]."""

    def disturb(process: int) -> None:
        time.sleep(moment)
        for number in ENDS[end][0]:
            with contextlib.suppress(ProcessLookupError):  # it has ended by itself
                os.kill(process, number)
            time.sleep(chance.choice([0.0, 0.01, 0.1]))

    return disturb


def _misbehaved(
    told: str, end: str, code: int, said: str, count: collections.Counter[str]
) -> list[str]:
    """What was wrong with how a sweep ended."""
    wanted = ENDS[end][1]
    before = "jaxact" not in said.replace("jaxact: ", "") and (
        "Traceback" in said or code == -ENDS[end][0][0]
    )
    if end != "SIGKILL" and before:
        # the interpreter itself was still starting, and none of our code had run
        count["before the first line of jaxact"] += 1
        return []
    if "Traceback" in said or code not in (0, *wanted) or said.count("\n") > 1:
        return [f"{told}code {code}: {said[-600:]}"]
    count["ended early"] += code != 0
    return []


def damages(number: int, seed: int, folder: Path) -> list[str]:
    """What was not as it should be after so many damages; seed: of all that is random."""
    chance = random.Random(seed)
    (folder / "sweep.toml").write_text(SWEEP)
    small_chunks()
    wrong: list[str] = []
    count: collections.Counter[str] = collections.Counter()
    whole = {}
    for kind, more in KINDS.items():
        assert (
            _command(["sweep", f"{folder}/sweep.toml", "--out", f"{folder}/{kind}", *more])[0] == 0
        )
        whole[kind] = contents(folder / kind, same_run=True)
    for _ in range(number):
        kind, how = chance.choice(list(KINDS)), chance.choice(["bit", "truncation", "deletion"])
        key = _chosen(whole[kind], chance)
        path = folder / kind / key
        _damage(path, how, chance)
        told = f"{kind}, {how} of {key}"
        wrong += [f"{told}: {line}" for line in _unnoticed(folder, kind)]
        resumed = ["sweep", f"{folder}/sweep.toml", "--out", f"{folder}/{kind}", "--resume"]
        code, said = _command([*resumed, *KINDS[kind]])
        begun_unknown = key == "sweep.zarr/zarr.json"
        after = contents(folder / kind, same_run=not begun_unknown)
        if begun_unknown and contents(folder / kind, same_run=True) == whole[kind]:
            count["roots mended with their beginning"] += 1
        if code or said or after != _compared(whole[kind], folder / kind, begun_unknown):
            wrong.append(f"{told}: not mended: code {code} {said}")
        for name, content in whole[kind].items():
            (folder / kind / name).write_bytes(content)
        count[f"{how} of {'metadata' if key.endswith('zarr.json') else 'numbers'}"] += 1
        _show(count, wrong)
    print(", ".join(f"{what}: {times}" for what, times in sorted(count.items())))
    return wrong


def _compared(whole: dict[str, bytes], folder: Path, begun_unknown: bool) -> dict[str, bytes]:
    """What is to be there after mending; without its beginning where that was damaged."""
    if not begun_unknown:
        return whole
    with tempfile.TemporaryDirectory() as other:
        root = Path(other) / "sweep.zarr" / "zarr.json"
        root.parent.mkdir()
        root.write_bytes(whole["sweep.zarr/zarr.json"])
        return whole | contents(Path(other))


def _chosen(files: dict[str, bytes], chance: random.Random) -> str:
    """A file of a store: half of the time metadata or coordinates, of which there are fewer."""
    described = [key for key in files if key.endswith("zarr.json") or "/c/" in key]
    return chance.choice(described if chance.random() < 0.5 else sorted(files))


def _damage(path: Path, how: str, chance: random.Random) -> None:
    content = bytearray(path.read_bytes())
    if how == "deletion":
        path.unlink()
    elif how == "truncation":
        path.write_bytes(content[: chance.randrange(len(content))])
    else:
        content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
        path.write_bytes(content)


def _unnoticed(folder: Path, kind: str) -> list[str]:
    """Commands that did not refuse a damaged store, in a few words each."""
    picture, file = folder / "map.png", folder / "map.nc"
    found = []
    for command in (
        ["status", f"{folder}/{kind}"],
        ["validate", f"{folder}/{kind}", "--samples", "0"],
        ["plot", f"{folder}/{kind}", "--quick", "--out", str(picture)],
        ["export", f"{folder}/{kind}", str(file)],
    ):
        code, said = _command(command)
        if code != 2 or said.count("\n") != 1 or picture.exists() or file.exists():
            found.append(f"{command[0]}: code {code} {said}")
        picture.unlink(missing_ok=True)
        file.unlink(missing_ok=True)
    return found


def _command(arguments: Sequence[str]) -> tuple[int, str]:
    """The exit code of a command line in this process, and what it said on standard error."""
    import traceback

    from jaxact.cli import main

    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            return main.main(arguments), said.getvalue()
        except Exception:
            return 1, said.getvalue() + traceback.format_exc()


def main() -> int:
    """Run what is asked for; 1 where anything was wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("kills", "damages", "serve"))
    parser.add_argument("--number", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    if given.what == "serve":
        serve()
        return 0
    work = kills if given.what == "kills" else damages
    with tempfile.TemporaryDirectory(prefix="jaxact-survival-") as folder:
        wrong = work(given.number, given.seed, Path(folder))
    print(f"{given.number} {given.what}: {len(wrong)} wrong")
    print("\n".join(wrong))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
