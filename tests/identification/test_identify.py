"""From synthetic logs to the drive that made them: numbers, choice of model, verdict, files."""

import tomllib
from dataclasses import replace

import jax
import numpy as np
import pytest
from matplotlib import pyplot
from scipy.linalg import expm

import jaxact
from jaxact.cli.main import main
from jaxact.errors import UserError
from jaxact.identification import forces, model
from jaxact.identification.fitting import METHODS, solve
from jaxact.identification.identify import identify
from jaxact.identification.log import Log
from jaxact.identification.result import check_gains

ROWS = 1500
TICK = 1e-3
STARLETH, HYQ = (110.0, 0.9, 2.3e-3), (800.0, 0.45, 1.4e-3)


def _prbs(seed, hold=5):
    generator = np.random.default_rng(seed)
    return np.repeat(generator.choice([-1.0, 1.0], ROWS // hold + 1), hold)[:ROWS]


def _chirp(top):
    time = np.arange(ROWS) * TICK
    return np.sin(np.pi * top * time**2 / time[-1])


def _log(command, drive, seed=0, noise=0.02):
    """A bench's log: the drive in steps of a hundredth of a tick, by the matrix exponential."""
    wn, zeta, delay = drive
    fine = 100
    matrix = np.array([[0.0, 1.0, 0.0], [-(wn**2), -2.0 * zeta * wn, wn**2], [0.0, 0.0, 0.0]])
    over = expm(matrix * TICK / fine)
    late = round(delay / TICK * fine)
    held = np.concatenate([np.full(late, command[0]), np.repeat(command, fine)])
    state, forces = np.array([command[0], 0.0]), np.empty(ROWS)
    for row in range(ROWS):
        forces[row] = state[0]
        for step in range(fine):
            state = over[:2, :2] @ state + over[:2, 2] * held[row * fine + step]
    generator = np.random.default_rng(seed + 100)
    coloured = np.convolve(generator.normal(size=ROWS), 0.8 ** np.arange(20), "same")
    return Log(
        f"bench_{seed}", np.arange(ROWS) * TICK,
        {"command": command, "force": 0.95 * forces + noise * coloured},
    )  # fmt: skip


@pytest.fixture(scope="module")
def starleth():
    return identify(_log(_prbs(1), STARLETH, 1), validate=[_log(_prbs(2, hold=9), STARLETH, 2)])


@pytest.fixture(scope="module")
def hyq():
    return identify(_log(_prbs(3), HYQ, 3), validate=[_log(_prbs(4, hold=9), HYQ, 4)])


@pytest.mark.parametrize("name", ["starleth", "hyq"])
def test_a_prbs_identifies_the_drive(name, request):
    found, drive = request.getfixturevalue(name), {"starleth": STARLETH, "hyq": HYQ}[name]
    assert found.chosen.rung.name == "second order with delay"
    known = found.chosen.knowledge
    for estimate, truth in zip((known["wn"], known["zeta"], known["delay"]), drive, strict=True):
        assert estimate.identified and estimate.low <= truth <= estimate.high
    assert known["wn"].value == pytest.approx(drive[0], rel=0.03)
    assert known["zeta"].value == pytest.approx(drive[1], abs=0.03)
    assert known["delay"].value == pytest.approx(drive[2], abs=1e-4)
    assert known["gain"].value == pytest.approx(0.95, abs=0.02)
    assert found.verdict.level.value == "good"


def test_the_simulated_bench_is_the_force_loop(hyq):
    log = _log(_prbs(3), HYQ, 3, noise=0.0)
    numbers = {"gain": 0.95, "offset": 0.0, "force_limit": np.inf, "wn": HYQ[0], "zeta": HYQ[1],
               "delay": HYQ[2]}  # fmt: skip
    with jax.enable_x64(True):
        found = model.predicted(hyq.ladder.family, log, numbers)
    # Where the drive began is fitted, too.
    np.testing.assert_allclose(found, log["force"], atol=1e-6)


def test_coloured_residuals_have_wider_intervals_than_independent_ones(starleth):
    assert max(estimate.wider for estimate in starleth.chosen.knowledge.estimates) > 1.2


@pytest.mark.exhaustive
def test_a_slow_chirp_identifies_only_the_sum():
    found = identify(_log(_chirp(10.0), HYQ, 5), validate=[_log(_chirp(10.0), HYQ, 6)])
    last = next(c for c in found.ladder.candidates if c.rung.name == "second order with delay")
    assert not last.knowledge.identified
    value, deviation = found.chosen.knowledge.lag
    truth = HYQ[2] + 2.0 * HYQ[1] / HYQ[0]
    assert value == pytest.approx(truth, abs=max(3.0 * deviation, 2e-4))


def test_what_was_found_is_a_loop_and_an_ensemble(starleth):
    loop = starleth.loop
    assert loop.wn == pytest.approx(110.0, rel=0.03) and loop.control_rate == pytest.approx(1000.0)
    many = starleth.samples(40)
    assert many.shape == (40,)
    spread = np.std(np.log(many.wn))
    names = starleth.chosen.knowledge.names
    expected = np.sqrt(np.diag(starleth.chosen.knowledge.covariance))[names.index("wn")]
    assert spread == pytest.approx(expected, rel=0.5)


@pytest.mark.exhaustive
def test_rows_that_are_missing_often_make_a_verdict_no_better_than_usable():
    log = _log(_prbs(1), STARLETH, 1)
    kept = np.random.default_rng(3).random(ROWS) > 0.02
    thin = replace(log, time=log.time[kept], signals={n: v[kept] for n, v in log.signals.items()})
    found = identify(thin, validate=[_log(_prbs(2, hold=9), STARLETH, 2)])
    assert found.verdict.level.value == "usable"
    assert "places, where what was commanded is not known" in found.verdict.sentence


@pytest.mark.exhaustive
def test_a_log_that_does_not_carry_over_is_not_good():
    other = _log(_prbs(8), (60.0, 0.3, 6e-3), 8)
    found = identify(_log(_prbs(7), STARLETH, 7), validate=[other])
    assert found.verdict.level.value != "good"
    assert any("carry over" in reason for reason in found.verdict.reasons)


@pytest.mark.exhaustive
def test_a_limit_that_noise_hides_is_found():
    logs = [_log(_prbs(seed), STARLETH, seed, noise=0.0) for seed in (31, 32)]
    generator = np.random.default_rng(33)
    clipped = [
        replace(log, signals={
            "command": log["command"],
            "force": np.clip(log["force"], -0.6, 0.6) + 0.01 * generator.normal(size=ROWS),
        })
        for log in logs
    ]  # fmt: skip
    found = identify(clipped[0], validate=clipped[1])
    known = found.chosen.knowledge
    truths = {"force_limit": 0.6, "gain": 0.95, "wn": 110.0, "zeta": 0.9}
    for name, truth in truths.items():
        assert known[name].value == pytest.approx(truth, rel=0.02)
    assert known["delay"].value == pytest.approx(2.3e-3, abs=1e-4)
    assert found.verdict.level.value == "good"


@pytest.mark.exhaustive
def test_a_force_of_the_wrong_sign_is_said():
    logs = [_log(_prbs(seed), STARLETH, seed) for seed in (34, 35)]
    turned = [replace(log, signals={**log.signals, "force": -log["force"]}) for log in logs]
    verdict = identify(turned[0], validate=turned[1]).verdict
    assert verdict.level.value != "good" and "has the wrong sign" in verdict.sentence


@pytest.mark.exhaustive
def test_one_log_alone_is_not_called_good():
    found = identify(_log(_prbs(9), STARLETH, 9))
    assert found.ladder.kept_apart and found.verdict.level.value != "good"


def test_gains_that_contradict_the_command_are_refused():
    command, log = _prbs(10), _log(_prbs(10), STARLETH, 10)
    position = np.cumsum(np.cumsum(command)) * 1e-6
    setpoint = position + command / 50.0
    signals = {**log.signals, "command": command, "position": position, "setpoint": setpoint}
    wrong = Log("closed", log.time, signals, gains=(100.0, 0.0))
    with pytest.raises(UserError, match="contradicts the command, which follows from kp = 50"):
        identify(wrong)


@pytest.mark.parametrize("follows", (False, True))
def test_damping_that_contradicts_the_command_is_refused(follows):
    """Of a controller that damps the velocity, or its difference from the setpoint's."""
    time = np.arange(4000) * 1e-3
    waves = [(0.2, 7.0, 0.3), (0.1, 23.0, 1.1), (0.03, 61.0, 0.2)]
    position, rate = (
        sum(a * w**n * np.sin(w * time + p + n * np.pi / 2) for a, w, p in waves) for n in (0, 1)
    )
    setpoint, wanted = (
        sum(a * w**n * np.sin(w * time + p + 0.2 + n * np.pi / 2) for a, w, p in waves)
        for n in (0, 1)
    )
    command = 50.0 * (setpoint - position) + 0.8 * (wanted * follows - rate)
    signals = {"command": command, "position": position, "setpoint": setpoint}

    def log(kd):
        return Log("closed", time, signals, gains=(50.0, kd))

    check_gains([log(0.8), log(None)])
    if follows:  # what the setpoint's velocity adds is no gain of the joint's
        return
    with pytest.raises(UserError, match=r"kd = 8 contradicts the command, .* kd = 0\.[78]"):
        check_gains([log(8.0)])


def test_a_picture_does_not_take_the_drives_place(files, tmp_path, capsys):
    out = tmp_path / "drive.png"
    assert main(["identify", str(files / "bench_1.csv"), "--out", str(out)]) == 2
    assert "the picture has this name; give --out drive.toml" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def _csv(path, log):
    rows = np.stack([log.time, log["command"], log["force"]], axis=1)
    np.savetxt(path, rows, delimiter=",", header="time,command,force", comments="", fmt="%.9g")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    for seed in (1, 2):
        _csv(folder / f"bench_{seed}.csv", _log(_prbs(seed), STARLETH, seed))
    return folder


def test_the_command_writes_the_drive_and_a_picture(files, tmp_path, capsys):
    out = tmp_path / "drive.toml"
    given = [str(files / "bench_1.csv"), "--validate", str(files / "bench_2.csv")]
    report = tmp_path / "drive.html"
    assert main(["identify", *given, "--out", str(out), "--report", str(report)]) == 0
    said = capsys.readouterr().out
    assert "chosen: second order with delay" in said and "verdict: good" in said
    document = tomllib.loads(out.read_text())
    assert document["loop"][0]["wn"] == pytest.approx(110.0, rel=0.03)
    assert document["estimates"]["delay"]["identified"] is True
    assert f"wrote {report}" in said and "bench_2.csv" in report.read_text()
    assert (tmp_path / "drive.png").stat().st_size > 10_000
    assert main(["margins", "--loops", str(out), "--mass", "0.7"]) == 0
    assert "identified" in capsys.readouterr().out
    assert main(["identify", *given, "--out", str(out)]) == 2
    assert "exists; give another name, or --overwrite" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--plant", "car"], "plant = 'car'"),
        (["--loss", "cubic"], "loss = 'cubic'"),
        (["--method", "newton"], "method = 'newton'"),
        (["--method", "adam", "--loss", "huber"], "--loss is of the least squares"),
        (["--plant", "mass"], "has no position; a mass needs one"),
        (["--joint", "elbow"], "joint 'elbow' is not in the map"),
        (["--control-rate", "0"], "--control-rate = 0 is out of range"),
        (["--wn", "100"], "--wn is for --design; logs say it themselves"),
        (["--design"], "--design needs no logs"),
        (["--report", "bench.pdf"], "output bench.pdf: a report is an .html file"),
        (["--design", "--report", "bench.html"], "is of logs, not of --design"),
    ],
)
def test_what_does_not_fit_is_one_line_and_writes_nothing(files, tmp_path, capsys, options, said):
    out = tmp_path / "drive.toml"
    assert main(["identify", str(files / "bench_1.csv"), "--out", str(out), *options]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_columns_that_are_not_known_point_to_the_option_for_them(tmp_path, capsys):
    (tmp_path / "log.csv").write_text("a,b\n1,2\n")
    assert main(["identify", str(tmp_path / "log.csv"), "--out", str(tmp_path / "d.toml")]) == 2
    assert "give --map, a TOML file that says which is which" in capsys.readouterr().err


def test_pictures_on_the_callers_axes(starleth):
    axes = jaxact.plot.profile_likelihood(starleth, "wn")
    line = axes.get_lines()[1]
    known = starleth.chosen.knowledge["wn"]
    # Where the interval ends the sum of squares has risen by what an interval of 95 % allows.
    at_end = np.interp([known.low, known.high], *line.get_data())
    np.testing.assert_allclose(at_end, 1.0, atol=0.35)
    assert np.min(line.get_ydata()) == pytest.approx(0.0, abs=1e-3)
    bars = jaxact.plot.residual_autocorrelation(starleth).collections
    assert len(bars) == 1
    with pytest.raises(UserError, match="'mass' is not an unknown of the model"):
        jaxact.plot.profile_likelihood(starleth, "mass")
    pyplot.close("all")


@pytest.mark.exhaustive
def test_a_first_order_method_over_a_few_of_many_logs_ends_near_the_least_squares():
    logs = [_log(_prbs(seed), STARLETH, seed) for seed in range(20, 32)]
    with jax.enable_x64(True):
        family = forces.family(logs)
        rung = next(rung for rung in family.rungs if rung.name == "second order with delay")
        both = [solve(model.of_rung(family, rung, logs), method=method) for method in METHODS]
    exact, near = (fit.square_sum for fit in both)
    assert exact <= near < 1.05 * exact
    assert both[1].values["wn"] == pytest.approx(both[0].values["wn"], rel=0.05)
    assert both[1].values["delay"] == pytest.approx(both[0].values["delay"], abs=3e-4)


@pytest.mark.exhaustive
def test_of_gains_that_are_not_known_all_is_per_unit_of_the_inertia():
    """With neither gains nor force in the log, friction is an acceleration, not a force."""
    time = np.arange(1500) * 2e-3
    setpoint = 0.2 * np.sign(np.sin(9.0 * time)) * np.abs(np.sin(2.3 * time))
    position, speed, found = 0.0, 0.0, []
    for wanted in setpoint:
        for _ in range(2):
            push = 300.0 * (wanted - position) - 25.0 * speed - 1.5 * np.tanh(speed / 1e-3)
            speed += 1e-3 * push
            position += 1e-3 * speed
        found.append(position)
    log = Log("servo", time, {"setpoint": setpoint, "position": np.array(found)})
    found = identify(log, plant="mass").chosen.knowledge.estimates
    units = {one.name: one.unit for one in found}
    assert units["kp"] == "1/s^2" and units["coulomb"] == "rad/s^2"
