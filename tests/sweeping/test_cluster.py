"""Sweeps on a Ray cluster that the test starts: the same bits, whatever workers are lost.

In processes of their own: Ray changes the process it runs in.
"""

import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from test_resume import contents

from jaxact.errors import UserError
from jaxact.sweeping import cluster, location, progress, store
from jaxact.sweeping.progress import State

ROOT = Path(__file__).resolve().parent.parent.parent
SWEEP = """
engine = "mass"
duration = 1.0
tile = 8
[parameters]
actuator = "starleth"
position_noise = 1e-4
[axes]
delay = [0.0, 0.0013]
kp = { min = 10, max = 2000, num = 16, spacing = "log" }
kd = { min = 1, max = 100, num = 8, spacing = "log" }
"""
CODE = """
import dataclasses, sys
from pathlib import Path
from jaxact.loops import reading
from jaxact.sweeping import cluster, execution, location, planning

asked = reading.load(Path(sys.argv[1]))
small = lambda planned: dataclasses.replace(planned, loops=16)
if sys.argv[3] == "ray":
    with cluster.attached(None) as attached:
        plan = lambda *given: small(attached.plan(*given, None))
        how = execution.SweepOptions(resume=True, planner=plan, workers=attached.work)
        execution.sweep(asked, location.at(sys.argv[2]), how)
else:
    how = execution.SweepOptions(resume=True, planner=lambda *given: small(planning.plan(*given)))
    execution.sweep(asked, location.at(sys.argv[2]), how)
"""
needs_ray = pytest.mark.skipif(
    importlib.util.find_spec("ray") is None, reason="Ray is not installed (jaxact[ray])"
)


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ray")
    (folder / "sweep.toml").write_text(SWEEP)
    environment = os.environ | {
        "PYTHONPATH": str(ROOT),
        "JAXACT_PROGRAMS": str(folder / "programs"),
        "TF_CPP_MIN_LOG_LEVEL": "3",
    }

    def start(out, who):
        arguments = [sys.executable, "-c", CODE, str(folder / "sweep.toml"), str(out), who]
        return subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True, env=environment)

    return start


def _parent(process):
    try:
        return int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])
    except (OSError, IndexError):
        return 0


def _workers(driver):
    """Processes that compute a chunk for this driver."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            name = (folder / "cmdline").read_bytes()
        except OSError:
            continue
        above = int(folder.name)
        while name.startswith(b"ray::_compute") and above not in (0, 1, driver):
            above = _parent(above)
        if name.startswith(b"ray::_compute") and above == driver:
            found.append(int(folder.name))
    return found


@pytest.mark.exhaustive
@needs_ray
def test_lost_workers_cost_only_their_chunk_and_no_bit(start, tmp_path):
    with start(tmp_path / "local", "local") as process:
        _, said = process.communicate(timeout=300)
    assert process.returncode == 0, said
    out = tmp_path / "cluster"
    receipts = out / store.STORE / "progress" / "receipt"
    killed = 0
    with start(out, "ray") as driver:
        while driver.poll() is None and killed < 3:
            done = len(list(receipts.glob("c.*")))
            workers = _workers(driver.pid) if done > 3 * killed else []
            if workers:
                os.kill(workers[0], signal.SIGKILL)
                killed += 1
            time.sleep(0.01)
        _, said = driver.communicate(timeout=300)
    assert driver.returncode == 0, said
    assert killed == 3, "no worker was met at work"
    there = progress.existing(location.at(out / store.STORE))
    assert all(there.look(n).state is State.DONE for n in range(len(there.layout)))
    local, ray = contents(tmp_path / "local"), contents(out)
    assert local.keys() == ray.keys()
    # device and command are named in the root
    assert all(local[key] == ray[key] for key in local if key != "sweep.zarr/zarr.json")


def test_without_ray_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(UserError, match=r"jaxact\[ray\]"), cluster.attached(None):
        raise AssertionError("there is no cluster")
