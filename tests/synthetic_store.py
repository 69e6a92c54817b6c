"""Result stores made of exact theory, so that pictures are tested without simulating."""

import tempfile

import numpy as np
from scipy.linalg import expm

from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.sweeping import execution, location, opening, store
from jaxact.sweeping.planning import Planned

GRID = """
description = "a grid for tests"
[axes]
actuator = ["hyq", "starleth"]
delay = [0.005, 0.0]
kp = { min = 10, max = 1e5, num = 12, spacing = "log" }
kd = { min = 0.1, max = 2000, num = 10, spacing = "log" }
"""
DRAWN = """
description = "a random sample for tests"
[parameters]
force_limit = 100.0
[axes]
actuator = ["hyq", "starleth"]
kp = { min = 10, max = 1e5, spacing = "log" }
kd = { min = 0.1, max = 2000, spacing = "log" }
[sampling]
method = "latin-hypercube"
samples = 40
"""


def radius(values, index):
    """Spectral radius of the sampled loop by scipy's matrix exponential of an augmented system."""
    v = {name: float(array[index]) for name, array in values.items()}
    period, wn = 1.0 / v["control_rate"], v["wn"]
    if np.isinf(wn):
        a, b = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([0.0, 1.0 / v["mass"]])
    else:
        a = np.zeros((4, 4))
        a[0, 1], a[1, 2], a[2, 3] = 1.0, 1.0 / v["mass"], 1.0
        a[3, 2:] = -(wn**2), -2.0 * v["zeta"] * wn
        b = np.array([0.0, 0.0, 0.0, wn**2])
    n = len(b)

    def moved(time):
        augmented = np.zeros((n + 1, n + 1))
        augmented[:n, :n], augmented[:n, n] = a, b
        whole = expm(augmented * time)
        return whole[:n, :n], whole[:n, n]

    steps = int(np.floor(v["delay"] / period + 1e-9))
    late = max(v["delay"] - steps * period, 0.0)
    phi, _ = moved(period)
    after, newer = moved(period - late)
    older = after @ moved(late)[1]
    matrix = np.zeros((n + steps + 1, n + steps + 1))
    command = np.zeros(n + steps + 1)
    command[:2] = -v["kp"], -v["kd"]
    matrix[:n, :n] = phi
    matrix[:n, n + steps] += older
    if steps:
        matrix[:n, n + steps - 1] += newer
    else:
        matrix[:n] += np.outer(newer, command)
    matrix[n] = command
    for row in range(n + 1, n + steps + 1):
        matrix[row, row - 1] = 1.0
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def exact(text):
    """A specification, its loops, and results of them that are exact."""
    specification = reading.parse(text)
    samples = expand(specification)
    radii = np.array([radius(samples.values, index) for index in range(len(samples))])
    growth = np.log(radii) * samples.values["control_rate"]
    verdict = np.where(growth < 0, 0, np.where(growth < 20, 1, 2))
    results = {
        "growth_rate": growth,
        "verdict": verdict.astype(np.int8),
        "overshoot": np.exp(-np.abs(growth) / 30.0),
        "settling_time": np.where(verdict == 0, 4.0 / np.abs(growth), np.nan),
    }
    return specification, samples, results


def fake_plan(specification, samples, *, loops=10**6):
    """A plan that no device was asked for."""
    return Planned(
        tile=specification.tile or 64, loops=loops, devices=1, engine=specification.engine,
        digest="", platform="cpu", device="1 x none", memory=0, peak=0, seconds=0.0, startup=0.0,
        measured=False,
    )  # fmt: skip


def teller(results, *, upto=None):
    """Workers that know the results already, and stop after some chunks."""

    def work(work, numbers, begin):
        absent = np.full(len(work.samples), np.nan)
        for count, number in enumerate(numbers):
            if count == upto:
                raise KeyboardInterrupt
            if count == 0:
                begin()
            first, size = work.store.layout.span(number)
            rows = {
                name: results.get(name, absent)[first : first + size] for name in store.VARIABLES
            }
            work.store.write(number, rows, work.store.tile)
            yield number

    return work


def run(folder, specification, samples, results, *, upto=None, loops=10**6, **options):
    """Run a sweep whose results are known already."""
    how = execution.SweepOptions(
        planner=lambda asked, all_: fake_plan(asked, all_, loops=loops),
        workers=teller(results, upto=upto),
        **options,
    )
    return execution.sweep(specification, location.at(folder), how)


def dataset_of(specification, samples, results):
    """The dataset of a sweep with these results, in memory; without the variables not given."""
    with tempfile.TemporaryDirectory() as folder:
        run(folder, specification, samples, results)
        whole = opening.open_result(folder).load()
    return whole[[name for name in store.VARIABLES if name in results]]


def dataset(text):
    """A sweep's dataset whose growth rates and verdicts are exact."""
    return dataset_of(*exact(text))


def write(folder, text):
    """A results folder with such a store in it."""
    run(folder, *exact(text))
    return folder
