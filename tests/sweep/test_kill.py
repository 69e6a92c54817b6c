"""Sweeps that are killed, again and again, at any moment: what is done in the end is the same."""

import os
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest
from test_resume import contents

from jaxact.sweep import lock, place, progress, store
from jaxact.sweep.progress import State

ROOT = Path(__file__).resolve().parent.parent.parent
KILLS = 25
SWEEP = """
engine = "mass"
duration = 1.0
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
# As the command line does it, but in small chunks.
CODE = """
import dataclasses, sys
from pathlib import Path
from jaxact.sweep import conduct, place, planning, reading

def plan(specification, samples):
    return dataclasses.replace(planning.plan(specification, samples), loops=16)

asked = reading.load(Path(sys.argv[1]))
conduct.sweep(asked, place.at(sys.argv[2]), conduct.How(resume=True, planner=plan))
"""


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    """Starts the sweep into a folder; compiled kernels are kept from run to run."""
    folder = tmp_path_factory.mktemp("kill")
    (folder / "sweep.toml").write_text(SWEEP)
    environment = os.environ | {
        "PYTHONPATH": str(ROOT),
        "JAX_COMPILATION_CACHE_DIR": str(folder / "cache"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "TF_CPP_MIN_LOG_LEVEL": "3",
    }

    def start(out):
        arguments = [sys.executable, "-c", CODE, str(folder / "sweep.toml"), str(out)]
        return subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True, env=environment)

    return start


def _receipts(folder):
    return len(list((folder / store.STORE / "progress" / "receipt").glob("c.*")))


def _kill_at_a_random_moment(process, out, chance):
    """While it starts, or soon after it has finished some more chunks."""
    before = _receipts(out)
    if chance.random() < 0.2:
        time.sleep(chance.uniform(0.0, 3.0))
    else:
        more = chance.choice([0, 1, 1, 2])
        while process.poll() is None and _receipts(out) < before + more:
            time.sleep(0.002)
        time.sleep(chance.uniform(0.0, 0.03))
    process.kill()
    process.wait()
    process.stderr.close()


def test_a_sweep_that_is_killed_25_times_ends_as_an_undisturbed_one(command, tmp_path):
    calm, killed = tmp_path / "calm", tmp_path / "killed"
    with command(calm) as process:
        _, said = process.communicate(timeout=300)
    assert process.returncode == 0, said
    chance = random.Random(1)
    kept = []
    for _ in range(KILLS):
        _kill_at_a_random_moment(command(killed), killed, chance)
        kept.append(_receipts(killed))
    assert kept == sorted(kept), "a finished chunk was lost"
    with command(killed) as process:
        _, said = process.communicate(timeout=300)
    assert process.returncode == 0, said
    assert len(set(kept)) > 5, f"the kills did not fall into the work: {kept}"
    assert contents(killed) == contents(calm)
    there = progress.existing(place.at(killed / store.STORE))
    assert all(there.look(n).state is State.DONE for n in range(len(there.layout)))
    assert sorted(item.name for item in killed.iterdir()) == [store.STORE]
    assert not (killed / lock.NAME).exists()
