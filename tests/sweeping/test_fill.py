"""Filling a store: the same bits however it is done, devices short of memory, memory bounds."""

import dataclasses
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest
from quickly import compiled_fully as compiled_fully
from quickly import compiled_quickly as compiled_quickly
from quickly import optimised_fully

from jaxact import engines
from jaxact.errors import UserError
from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.simulation import execute, plans
from jaxact.sweeping import (
    cache,
    execution,
    layout,
    location,
    memory,
    opening,
    planning,
    progress,
    store,
    throughput,
    validation,
    variables,
)

ROOT = Path(__file__).resolve().parent.parent.parent
NOISY = """
engine = "mass"
duration = 0.2
tile = 16
[parameters]
actuator = "starleth"
position_noise = 1e-4
force_limit = 60
[axes]
delay = [0.0, 0.0013]
kp = { min = 10, max = 2000, num = 9, spacing = "log" }
kd = { min = 1, max = 100, num = 5, spacing = "log" }
"""


def _run(folder, text, *, loops, backwards=False, **options):
    def plan(specification, samples):
        return dataclasses.replace(planning.plan(specification, samples), loops=loops)

    def workers(work, numbers, begin):
        return execution.fill.here(work, numbers[::-1] if backwards else numbers, begin)

    how = execution.SweepOptions(planner=plan, workers=workers, **options)
    return execution.sweep(reading.parse(text), location.at(folder), how)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    with optimised_fully():
        _run(folder, NOISY, loops=1000)
    return folder


@pytest.mark.exhaustive
@pytest.mark.usefixtures("compiled_fully")
@pytest.mark.parametrize(("loops", "devices"), [(32, 2), (45, 1)])
def test_any_chunks_any_order_any_devices_give_the_same_bits(loops, devices, whole, tmp_path):
    assert len(jax.local_devices()) == 2
    _run(tmp_path, f"devices = {devices}\n" + NOISY, loops=loops, backwards=True)
    there, one = (opening.open_result(folder).load() for folder in (tmp_path, whole))
    for name in variables.variables(robot=False):
        np.testing.assert_array_equal(there[name].values, one[name].values, err_msg=name)
    again = validation.recompute(opening.find(tmp_path), 20, seed=3)
    assert (again.loops, again.wrong) == (20, 0) and again.words == "bit for bit the same"


@pytest.mark.exhaustive
def test_results_that_no_computation_gives_are_found(whole, tmp_path):
    shutil.copytree(whole, tmp_path, dirs_exist_ok=True)
    target = opening.find(tmp_path)
    filled = progress.existing(target)
    rows = {name: values.copy() for name, values in filled.read(0).items()}
    rows["growth_rate"] *= np.float32(1.001)
    filled.write(0, rows, filled.tile)
    assert validation.checksums(target).wrong == ()
    assert validation.recompute(target, 20, seed=3).wrong == 20


@pytest.mark.exhaustive
def test_a_device_short_of_memory_gets_smaller_tiles(monkeypatch, tmp_path):
    """One that has no room for the inputs, and one that finds out while it computes."""
    tiles = []

    def begin(groups, specification, samples, numbers, growth):
        assert growth[0].growth.size == groups[0].batch
        tiles.append(groups[0].tile)
        if groups[0].tile > 8:
            raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating")
        return groups[0].tile, numbers

    def finish(begun):
        tile, numbers = begun
        if tile > 4:
            raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating")
        return {name: numbers.astype(float) % 4 for name in store.VARIABLES}

    monkeypatch.setattr(execute, "begin", begin)
    monkeypatch.setattr(execute, "finish", finish)
    filled = _run(tmp_path, NOISY, loops=45)
    assert tiles[0] == 16 and tiles[-1] == 4 and {*tiles} == {16, 8, 4}
    assert [int(filled.receipt(n)[1]) for n in range(2)] == [4, 4] and filled.tile == 16
    results = opening.open_result(tmp_path)
    np.testing.assert_array_equal(results["rms_force"].values.ravel(), np.arange(90) % 4)


@pytest.mark.exhaustive
def test_other_failures_are_not_taken_for_a_lack_of_memory(monkeypatch, tmp_path):
    def finish(_):
        raise jax.errors.JaxRuntimeError("INTERNAL: something else")

    monkeypatch.setattr(execute, "finish", finish)
    with pytest.raises(jax.errors.JaxRuntimeError, match="something else"):
        _run(tmp_path, NOISY, loops=45)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("shape", "most"),
    [((6,), 4), ((3, 3, 64, 64), 1500), ((2, 5, 7), 1), ((10, 10), 1000), ((4, 1, 9), 9), ((), 3)],
)
def test_chunks_are_runs_of_samples_that_cover_the_grid_once(shape, most):
    cut = layout.cut(shape, most)
    assert cut.loops <= most or cut.loops == 1
    covered = np.concatenate([cut.numbers(n) for n in range(len(cut))])
    np.testing.assert_array_equal(covered, np.arange(int(np.prod(shape, dtype=int))))
    assert len({cut.key(n) for n in range(len(cut))}) == len(cut)


@pytest.mark.parametrize(
    ("text", "size"),
    [("800M", 800 * 2**20), ("1.5 GiB", 3 * 2**29), ("2000000", 2_000_000), ("4gb", 4 * 2**30)],
)
def test_sizes_are_read(text, size):
    assert memory.read_size(text) == size


@pytest.mark.parametrize("text", ["", "much", "-3G", "3X", "0", "nan", "1e9"])
def test_what_is_no_size_is_refused(text):
    with pytest.raises(UserError, match="`memory`"):
        memory.read_size(text)


HUGE = """
engine = "mass"
duration = 0.05
[axes]
kp = { min = 10, max = 1e5, num = 10000, spacing = "log" }
kd = { min = 0.1, max = 2000, num = 10000, spacing = "log" }
"""


def test_a_hundred_million_loops_take_no_memory_before_they_are_computed():
    samples = expand(reading.parse(HUGE))
    assert len(samples) == 10**8
    assert sum(array.nbytes for array in samples.along.values()) < 10**6
    some = samples.take(np.array([0, 12_345_678, 10**8 - 1]))
    assert some["kp"][0] == 10.0 and some["kd"][2] == pytest.approx(2000.0)
    assert some["kp"][1] == samples.coords["kp"].values[1234]


def test_a_smaller_bound_makes_smaller_chunks_and_too_small_a_one_is_refused():
    asked = reading.parse(HUGE)
    samples = expand(asked)
    sizes = [planning.plan(asked, samples, budget=g * 2**30).loops for g in (1, 2, 4)]
    assert sizes[0] < sizes[1] < sizes[2]
    with pytest.raises(UserError, match="needs at least"):
        planning.plan(asked, samples, budget=2**20)


def test_a_machine_with_little_free_memory_still_sweeps(monkeypatch):
    monkeypatch.setattr(memory, "free", lambda: 2**29)
    asked = reading.parse(HUGE)
    assert planning.plan(asked, expand(asked)).loops >= 1000
    robot = engines.ROBOT_IN_MJX.memory
    assert robot > engines.JOINT_IN_MJX.memory > engines.MASS.memory


@pytest.mark.exhaustive
def test_a_sweep_of_a_hundred_million_loops_stays_within_its_memory(tmp_path):
    (tmp_path / "huge.toml").write_text(HUGE)
    bound = int(1.4 * 2**30)
    process = subprocess.Popen(
        [sys.executable, "-m", "jaxact", "sweep", "huge.toml", "--memory", str(bound)],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    status = Path(f"/proc/{process.pid}/status")
    if not status.exists():
        process.kill()
        pytest.skip("this system does not tell the memory of a process")
    receipts, peak = tmp_path / "results/huge/sweep.zarr/progress/receipt", 0
    while process.poll() is None and len(list(receipts.glob("c.*"))) < 3:
        lines = dict(line.split(":", 1) for line in status.read_text().splitlines() if ":" in line)
        peak = max(peak, int(lines.get("VmHWM", "0 kB").split()[0]) * 1024)
        time.sleep(0.05)
    assert process.poll() is None
    process.kill()
    process.wait()
    assert 0 < peak < bound


def test_rates_are_kept_and_the_fastest_tile_is_taken(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache.usable() == ""
    asked = dataclasses.replace(reading.parse(HUGE), duration=20.0)
    samples = expand(asked)
    plan = plans.groups(asked, samples)[0]
    assert throughput.curve(plan, asked) == {}
    assert not throughput.seconds([plan], asked, 10)[1]
    said = []
    rates = {32: 1e8, 64: 2e8, 128: 5e8, 256: 3e8}

    def measured(plan, specification, samples):
        for tile, rate in rates.items():
            throughput.keep(
                dataclasses.replace(plan, tile=tile), specification, rate, throughput.ROLLOUTS
            )
        return rates

    monkeypatch.setattr(throughput, "_measured", measured)
    assert throughput.best_tile(asked, samples, say=None) is None, "nothing is measured unasked"
    assert throughput.best_tile(asked, samples, say=said.append) == 128 and len(said) == 1
    assert throughput.best_tile(asked, samples, say=said.append) == 128 and len(said) == 1
    assert throughput.curve(plan, asked, throughput.ROLLOUTS) == rates
    throughput.keep(plan, asked, 1e6)
    assert throughput.seconds([plan], asked, 10) == (10 * plan.steps / 1e6 / plan.devices, True)
    fixed = dataclasses.replace(asked, tile=8)
    assert throughput.best_tile(fixed, samples, say=None) is None, "the specification says it"
    (tmp_path / "jaxact" / "rates.json").write_text("{nonsense")
    assert throughput.curve(plan, asked) == {}
    short = reading.parse(NOISY.replace("tile = 16", ""))
    assert throughput.best_tile(short, expand(short), say=said.append) is None and len(said) == 1


@pytest.mark.exhaustive
def test_tiles_are_really_measured(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache.usable() == ""
    monkeypatch.setattr(throughput, "_FACTORS", (1.0, 2.0))
    asked = reading.parse(NOISY)
    samples = expand(asked)
    plan = plans.groups(asked, samples)[0]
    found = throughput._measured(plan, asked, samples)
    assert sorted(found) == [16, 32] and all(rate > 0 for rate in found.values())
    kept = throughput.curve(plan, asked, throughput.ROLLOUTS)
    assert kept == pytest.approx(found, rel=1e-3)
