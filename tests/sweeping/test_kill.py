"""Sweeps that are killed, again and again, at any moment: what is done in the end is the same."""

import contextlib
import os
import random
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from test_resume import contents

from jaxact.sweeping import location, lock, progress, store
from jaxact.sweeping.progress import State

ROOT = Path(__file__).resolve().parent.parent.parent
KILLS = 25
SWEEP = """
engine = "mass"
duration = 60.0
tile = 8
[parameters]
actuator = "starleth"
position_noise = 1e-4
force_limit = 60
[axes]
delay = [0.0, 0.0013]
kp = { min = 10, max = 2000, num = 30, spacing = "log" }
kd = { min = 1, max = 100, num = 16, spacing = "log" }
"""
# As the command line does it, but in small chunks, and in a fork for every folder that is named: a
# fork need not import anything. It says its number when it starts and how it ended.
CODE = """
import dataclasses, os, sys
from pathlib import Path
import xarray, zarr
from jaxact.loops import reading
from jaxact.simulation import execute, kernel, spectra
from jaxact.sweeping import execution, fill, location, planning, store

def plan(specification, samples):
    return dataclasses.replace(planning.plan(specification, samples), loops=16)

for line in sys.stdin:
    number = os.fork()
    if not number:
        asked = reading.load(Path(sys.argv[1]))
        how = execution.SweepOptions(resume=True, planner=plan)
        execution.sweep(asked, location.at(line.strip()), how)
        break
    print(number, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(number, 0)[1]), flush=True)
"""


class Sweeps:
    """One sweep at a time, in a process of its own."""

    def __init__(self, server):
        self.server = server

    def start(self, out):
        self.server.stdin.write(f"{out}\n".encode())
        self.number = int(self.server.stdout.readline())

    def ends_within(self, seconds):
        return bool(select.select([self.server.stdout], [], [], seconds)[0])

    def ended(self, seconds=300.0):
        """Its exit code, when it has one."""
        assert self.ends_within(seconds), "it hangs"
        return int(self.server.stdout.readline())

    def kill(self):
        with contextlib.suppress(ProcessLookupError):  # it has ended by itself
            os.kill(self.number, signal.SIGKILL)
        assert self.ended() in (0, -signal.SIGKILL)


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory):
    """Sweeps into folders; compiled programs are kept from run to run."""
    folder = tmp_path_factory.mktemp("kill")
    (folder / "sweep.toml").write_text(SWEEP)
    environment = os.environ | {
        "PYTHONPATH": str(ROOT),
        "JAXACT_PROGRAMS": str(folder / "programs"),
        "TF_CPP_MIN_LOG_LEVEL": "3",
    }
    with subprocess.Popen(
        [sys.executable, "-c", CODE, str(folder / "sweep.toml")],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, env=environment,
    ) as server:  # fmt: skip
        yield Sweeps(server)


def _receipts(folder):
    return len(list((folder / store.STORE / "progress" / "receipt").glob("c.*")))


def _kill_at_a_random_moment(sweeps, out, chance):
    """While it starts, or soon after it has finished some more chunks."""
    before = _receipts(out)
    if chance.random() < 0.2:
        time.sleep(chance.uniform(0.0, 0.3))
    else:
        more = chance.choice([0, 1, 1, 2])
        while _receipts(out) < before + more and not sweeps.ends_within(0.002):
            pass
        time.sleep(chance.uniform(0.0, 0.03))
    sweeps.kill()


@pytest.mark.exhaustive
def test_a_sweep_that_is_killed_25_times_ends_as_an_undisturbed_one(sweeps, tmp_path):
    calm, killed = tmp_path / "calm", tmp_path / "killed"
    sweeps.start(calm)
    assert sweeps.ended() == 0
    chance = random.Random(1)
    kept = []
    for _ in range(KILLS):
        sweeps.start(killed)
        _kill_at_a_random_moment(sweeps, killed, chance)
        kept.append(_receipts(killed))
    assert kept == sorted(kept), "a finished chunk was lost"
    sweeps.start(killed)
    assert sweeps.ended() == 0
    assert len(set(kept)) > 5, f"the kills did not fall into the work: {kept}"
    assert contents(killed) == contents(calm)
    there = progress.existing(location.at(killed / store.STORE))
    assert all(there.look(n).state is State.DONE for n in range(len(there.layout)))
    assert sorted(item.name for item in killed.iterdir()) == [store.STORE]
    assert not (killed / lock.NAME).exists()
