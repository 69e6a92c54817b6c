"""Random loops of a joint with what Python says of them, as the page's tests read them."""

import numpy as np

import jaxact as jx
from jaxact import files
from jaxact.verbs.margins import of_values

KINDS = ("sampled", "differenced")


def random_parameters(number, seed):
    """Parameters of loops by name, shape (number,) each: ideal and not, filtered, sprung, late."""
    rng = np.random.default_rng(seed)

    def between(low, high):
        return np.exp(rng.uniform(np.log(low), np.log(high), number))

    def some(values, share, other=0.0):
        return np.where(rng.uniform(size=number) < share, values, other)

    mass = between(0.05, 5.0)
    kp = mass * between(3.0, 60.0) ** 2
    kd = 2.0 * rng.uniform(0.1, 1.5, number) * np.sqrt(kp * mass)
    sprung = rng.uniform(size=number) < 0.4
    return {
        "mass": mass, "kp": kp, "kd": kd,
        "wn": some(between(50.0, 2000.0), 0.85, np.inf),
        "zeta": rng.uniform(0.15, 1.5, number),
        "delay": some(between(1e-4, 6e-3), 0.7),
        "measurement_delay": some(between(1e-4, 4e-3), 0.5),
        "output_delay": some(between(1e-4, 2e-3), 0.3),
        "setpoint_delay": np.zeros(number),
        "control_rate": between(200.0, 2000.0),
        "velocity_filter": some(between(100.0, 2000.0), 0.4, np.inf),
        "joint_damping": np.where(sprung, some(kd * rng.uniform(0.0, 0.5, number), 0.7), 0.0),
        "joint_stiffness": np.where(sprung, some(kp * rng.uniform(-0.6, 1.0, number), 0.7), 0.0),
        "gain_scale": np.ones(number),
    }  # fmt: skip


def rows(number, *, bounded=0, stepped=0, seed=0):
    """A row for each loop: parameters, margins, and of the first few boundaries, or steps.

    Args:
        number: of loops.
        bounded: how many have the points of their boundaries.
        stepped: how many have their simulated answer to a step, all delay at the command.
    """
    values = random_parameters(number, seed)
    continuous = of_values(values, None)
    sampled = {kind: of_values(values, kind) for kind in KINDS}
    found = []
    for index in range(number):
        one = {name: float(array[index]) for name, array in values.items()}
        kind = KINDS[index % 2]
        row = {
            "loop": one | {"velocity": kind},
            "continuous": _at(continuous, index),
            "sampled": _at(sampled[kind], index),
        }
        if index < bounded:
            row["boundaries"] = [_boundary(one, kind, sampled) for sampled in (False, True)]
        found.append(row)
    return [files.plain(row) for row in [*found, *_steps(found[:stepped])]]


def _at(metrics, index):
    """Metrics of one loop; what is minus infinity means nothing."""
    one = {name: float(array[index]) for name, array in metrics.items()}
    return {name: None if value == -np.inf else value for name, value in one.items()}


def _boundary(one, kind, sampled):
    names = ("wn", "zeta")
    own = {
        name: value
        for name, value in one.items()
        if name not in (*names, "gain_scale", "kp", "kd", "setpoint_delay")
    }
    window = {"kp_range": (0.1 * one["kp"], 10.0 * one["kp"]),
              "kd_range": (0.1 * one["kd"], 10.0 * one["kd"])}  # fmt: skip
    plant = {"mass": own.pop("mass"), "natural_frequency": one["wn"], "damping_ratio": one["zeta"]}
    rate = own.pop("control_rate")
    if sampled:
        curves = jx.sampled_boundary(
            **plant, **own, **window, control_period=1.0 / rate, velocity=kind
        )
    else:
        own["delay"] += own.pop("measurement_delay") + own.pop("output_delay")
        curves = jx.continuous_boundary(**plant, **own, **window)
    points = [
        (w, kp, kd)
        for curve in curves
        if curve.kind == "curve"
        for w, kp, kd in zip(curve.frequency[::9], curve.kp[::9], curve.kd[::9], strict=True)
    ]
    return [list(map(float, point)) for point in points[:40]]


def _steps(rows):
    """The same loops with all their delay at the command, and how they answer a step."""
    for row in rows:
        one = dict(row["loop"])
        one["delay"] += one.pop("measurement_delay") + one.pop("output_delay")
        one["control_rate"] = float(round(one["control_rate"], -1))
        kind = one.pop("velocity")
        if kind == "sampled":
            one["velocity_filter"] = np.inf
        run = jx.simulate(jx.joint(**one, velocity=kind), setpoint=1.0, duration=0.2)
        loop = one | {"velocity": kind, "measurement_delay": 0.0, "output_delay": 0.0}
        position = np.asarray(run.position)
        others = {"continuous": {}, "sampled": {}, "boundaries": []}
        yield row | others | {"loop": loop, "step": position.tolist()}
