"""What excitations promise, against differences of an independent simulation."""

import numpy as np
import pytest
from scipy import signal as scipy_signal

from jaxact.cli.main import main
from jaxact.errors import UserError
from jaxact.identification.design import Bench, design

WN, ZETA, DELAY, RATE = 300.0, 0.6, 3.25e-3, 1000.0
BENCH = Bench(wn=(WN, WN), zeta=(ZETA, ZETA), delay=(DELAY, DELAY), duration=1.0, noise=0.01)


@pytest.fixture(scope="module")
def promises():
    return design(BENCH)


def _force(command, wn, zeta, delay, gain, offset):
    """SciPy's own simulation of the drive, on a grid of a fortieth of a tick."""
    fine = 40
    late = delay * RATE * fine
    held = np.repeat(command, fine)
    whole = int(np.floor(late))
    moved = [np.concatenate([np.full(n, held[0]), held])[: len(held)] for n in (whole, whole + 1)]
    matrices = ([[0, 1], [-(wn**2), -2 * zeta * wn]], [[0], [wn**2]], [[1, 0]], [[0]])
    continuous = tuple(np.array(matrix, float) for matrix in matrices)
    system = scipy_signal.cont2discrete(continuous, 1.0 / RATE / fine, method="zoh")
    each = []
    for one in moved:
        # From rest at its first value on.
        each.append(scipy_signal.dlsim(system, one - one[0])[1])
    share = late - whole
    force = (1.0 - share) * each[0].ravel() + share * each[1].ravel()
    return gain * (force + held[0])[::fine] + offset


@pytest.mark.exhaustive
def test_the_bound_is_that_of_differences(promises):
    promise = next(one for one in promises if one.name == "chirp to 60 Hz")
    at = np.array([np.log(WN), ZETA, DELAY, 1.0, 0.0])

    def force(x):
        return _force(promise.signal, np.exp(x[0]), *x[1:])

    steps = np.array([1e-4, 1e-4, 1e-6, 1e-4, 1e-4])
    slopes = np.stack(
        [(force(at + h) - force(at - h)) / (2.0 * h.max()) for h in np.diag(steps)], axis=1
    )
    covariance = BENCH.noise**2 * np.linalg.inv(slopes.T @ slopes)
    deviations = np.sqrt(np.diag(covariance))
    assert promise.wn == pytest.approx(deviations[0], rel=0.02)
    assert promise.zeta == pytest.approx(deviations[1], rel=0.02)
    assert promise.delay == pytest.approx(deviations[2], rel=0.02)


def test_slow_excitation_knows_the_sum_better_than_its_parts(promises):
    slow = next(one for one in promises if one.name == "chirp to 10 Hz")
    fast = next(one for one in promises if one.name == "PRBS of 5 ms")
    assert slow.delay > 10.0 * slow.lag
    assert fast.delay < 0.2 * slow.delay
    assert promises[0].delay == min(one.delay for one in promises)


def test_noise_scales_all_promises(promises):
    twice = design(Bench(**{**vars(BENCH), "noise": 0.02}))
    for one, two in zip(promises, twice, strict=True):
        assert two.delay == pytest.approx(2.0 * one.delay)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"plant": "car"}, "plant = 'car'"),
        ({"wn": (100.0, 10.0)}, "`wn` = 100..10 is not a range"),
        ({"noise": 0.0}, "`noise` = 0 must be positive"),
        ({"kd": np.nan}, "`kd` = nan must be 0 or more"),
        ({"kd": -1.0}, "`kd` = -1 must be 0 or more"),
        ({"duration": 0.1}, "`duration` = 0.1: 100 rows"),
    ],
)
def test_numbers_that_make_no_sense_are_named(changes, said):
    with pytest.raises(UserError, match=said):
        design(Bench(**{**vars(BENCH), **changes}))


def test_the_command_writes_the_excitation(tmp_path, capsys):
    out = tmp_path / "excitation.csv"
    drive = ["--wn", "110", "--zeta", "0.9", "--delay", "1e-3..2e-3", "--duration", "0.5"]
    given = ["identify", "--design", "--plant", "mass", *drive, "--amplitude", "0.05"]
    given += ["--out", str(out)]
    assert main(given) == 0
    said = capsys.readouterr().out
    assert "standard deviations at best" in said and f"wrote {out}" in said
    table = np.loadtxt(out, delimiter=",", skiprows=1)
    assert table.shape == (500, 2) and np.max(np.abs(table[:, 1])) == pytest.approx(0.05)
    assert out.read_text().startswith("time,setpoint")
    assert main([*given[:4], "--wn", "fast", "--out", str(tmp_path / "other.csv")]) == 2
    assert "--wn = 'fast' is not a range" in capsys.readouterr().err


def test_without_logs_or_design_it_says_what_is_missing(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["identify"]) == 2
    assert "no logs; give the CSV or NPZ files to fit, or --design" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--map", "map.toml"], "--map is of logs, not of --design; leave one of them out"),
        (["--validate", "other.csv"], "--validate is of logs"),
        (["--joint", "elbow"], "--joint is of logs"),
        (["--groups", "hip,knee"], "--groups is of logs"),
        (["--control-rate", "77"], "--control-rate is of logs"),
        (["--loss", "huber"], "--loss is of logs"),
        (["--method", "adam"], "--method is of logs"),
        (["--bootstrap"], "--bootstrap is of logs"),
        (["--report", "drive.html"], "--report is of logs"),
        (["--mass", "2"], "--mass is of --plant mass; leave it out, or give that"),
        (["--kp", "9"], "--kp is of --plant mass"),
        (["--kd", "9"], "--kd is of --plant mass"),
    ],
)
def test_options_that_a_design_has_not_are_refused(tmp_path, monkeypatch, capsys, options, said):
    monkeypatch.chdir(tmp_path)
    assert main(["identify", "--design", *options]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())
