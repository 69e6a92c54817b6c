"""The study's figures and claims: numbers against the oracle and other formulas, text, files."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.optimize
import scipy.signal
from experiment_modules import imported
from quickly import compiled_quickly as compiled_quickly
from theory import figures, plant_values, response

FOLDER = Path(__file__).resolve().parent.parent / "experiments" / "paper"
NAMES = ("claims", "claims_on_motion", "pade", "pictures", "report", "results", "run", "study")
with imported(FOLDER, *NAMES) as modules:
    _claims, motion, pade, pictures, _report, results, run, study = modules
claims, report = _claims.claims, _report.report
ORACLE = json.loads((Path(__file__).parent / "data" / "paper_loop.json").read_text())
ROBOTS, SWEEP, SAMPLED = (
    ORACLE["paper_cases"], ORACLE["frequency_sweep"], ORACLE["sampled_1khz"]
)  # fmt: skip
FILES = [f"{name}.png" for name in pictures.PICTURES] + ["claims.md"]


@pytest.fixture(scope="module")
def found():
    return results.compute()


def _in_order(cases):
    """Oracle's list of nine as an array (robots, delays)."""
    names = [f"{robot} {1e3 * delay:g} ms" for robot in study.ROBOTS for delay in study.DELAYS]
    assert [case["name"] for case in cases] == names
    return lambda values: np.array(values, float).reshape((3, 3))


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("ours", "theirs", "unit"),
    [
        ("gain_margin", "gain_margin", 1.0),
        ("phase_margin", "phase_margin_deg", math.pi / 180.0),
        ("delay_margin", "delay_margin", 1.0),
        ("sensitivity_peak", "sensitivity_peak", 1.0),
        ("sensitivity_peak_frequency", "sensitivity_peak_frequency", 1.0),
    ],
)
def test_continuous_margins_are_the_oracles(found, ours, theirs, unit):
    tolerance = 1e-6 if ours.endswith("frequency") else 1e-9
    want = _in_order(ROBOTS)(figures(ROBOTS, theirs)) * unit
    np.testing.assert_allclose(found.robots["continuous"][ours], want, rtol=tolerance)
    compared = 0
    for case, value in zip(SWEEP, figures(SWEEP, theirs) * unit, strict=True):
        near = np.isclose(found.natural_frequency, case["natural_frequency"], rtol=1e-12)
        z, d = study.DAMPING_RATIOS.index(case["damping_ratio"]), study.DELAYS.index(case["delay"])
        for got in found.curves["continuous"][ours][z, d][near]:
            # At 50 rad/s one loop is 0.8 % from the boundary: its peak is as sensitive.
            np.testing.assert_allclose(got, value, rtol=10 * tolerance)
            compared += 1
    assert compared == 30


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("ours", "theirs", "unit"),
    [
        ("gain_margin", "gm", 1.0),
        ("phase_margin", "pm", math.pi / 180.0),
        ("sensitivity_peak", "Ms", 1.0),
        ("sensitivity_peak_frequency", "wMs", 1.0),
    ],
)
def test_sampled_margins_are_the_oracles(found, ours, theirs, unit):
    want = _in_order(SAMPLED)([case["velocity_sampled"][theirs] * unit for case in SAMPLED])
    tolerance = 1e-6 if ours.endswith("frequency") else 1e-9
    np.testing.assert_allclose(found.robots["sampled"][ours], want, rtol=tolerance)


@pytest.mark.exhaustive
def test_sampled_delay_margins_are_the_oracles(found):
    """Its figure is the phase margin in seconds, which is exact for whole control periods alone."""
    sampled = found.robots["sampled"]
    want = _in_order(SAMPLED)([case["velocity_sampled"]["dm"] for case in SAMPLED])
    in_seconds = sampled["phase_margin"] / sampled["gain_crossover"]
    np.testing.assert_allclose(in_seconds, want, rtol=1e-9)
    np.testing.assert_allclose(sampled["delay_margin"], want, rtol=2e-5)


@pytest.mark.exhaustive
def test_bisected_margins_are_the_oracles(found):
    order = _in_order(SAMPLED)
    want = {
        name: order([case["velocity_sampled"][key] for case in SAMPLED])
        for name, key in (("gain_margin", "gm"), ("delay_margin", "dm"))
    }
    np.testing.assert_allclose(found.simulated_robots["gain_margin"], want["gain_margin"], 1e-3)
    np.testing.assert_allclose(found.simulated_robots["delay_margin"], want["delay_margin"], 1e-3)
    radius = order([case["velocity_sampled"]["rho"] for case in SAMPLED])
    rates = np.log(radius) * study.CONTROL_RATE
    np.testing.assert_allclose(found.growth_rate["nominal"], rates, rtol=1e-3)


@pytest.mark.exhaustive
def test_simulated_marks_lie_on_the_exact_curves(found):
    for name, atol in (("gain_margin", 0.0), ("delay_margin", 5e-6)):
        exact = found.curves["sampled"][name][..., found.marked]
        np.testing.assert_allclose(found.simulated_curves[name], exact, rtol=1e-3, atol=atol)
    np.testing.assert_allclose(found.measured_sensitivity, found.measured_reference, rtol=1e-5)


@pytest.mark.exhaustive
def test_sensitivity_curves_follow_the_definition(found):
    for z, zeta in enumerate(study.DAMPING_RATIOS):
        for d, delay in enumerate(study.DELAYS):
            for s, wn in enumerate(study.SHOWN):
                loop = (study.KP, study.KD, study.MASS, wn, zeta, delay)
                want = np.abs(1.0 / (1.0 + response(loop, found.frequency)))
                np.testing.assert_allclose(found.sensitivity["continuous"][z, d, s], want, 1e-9)


@pytest.mark.exhaustive
@pytest.mark.parametrize(("name", "factor"), [("boundary", 1.0), ("tripled_boundary", 3.0)])
def test_slowest_stable_actuators_solve_the_characteristic_equation(found, name, factor):
    for z, zeta in enumerate(study.DAMPING_RATIOS):
        for d, delay in enumerate(study.DELAYS):

            def closed(point, zeta=zeta, delay=delay):
                wn, w = np.exp(point)
                gains = factor * study.KP, factor * study.KD
                value = 1.0 + response((*gains, study.MASS, wn, zeta, delay), w)
                return value.real, value.imag

            got = getattr(found, name)["continuous"][z, d]
            if math.isnan(got):
                got = study.LOWEST
            wn, w = np.exp(scipy.optimize.fsolve(closed, np.log([got, 0.7 * got]), xtol=1e-12))
            assert np.hypot(*closed(np.log([wn, w]))) < 1e-9
            if math.isnan(getattr(found, name)["continuous"][z, d]):
                assert wn < study.LOWEST
            else:
                assert got == pytest.approx(wn, rel=1e-3)


@pytest.mark.exhaustive
def test_every_curve_covers_the_studys_range(found):
    assert found.natural_frequency[[0, -1]] == pytest.approx([50.0, 800.0])
    assert set(study.DAMPING_RATIOS) == {0.45, 0.9} and study.DELAYS == (0.0, 1e-3, 5e-3)
    values = plant_values(ROBOTS, "natural_frequency").reshape((3, 3))[:, 0]
    np.testing.assert_array_equal(found.robot_frequency, values)


def test_pade_margins_converge_to_the_oracles():
    want = _in_order(ROBOTS)(figures(ROBOTS, "gain_margin"))
    for order, tolerance in ((2, 1e-2), (6, 1e-5)):
        np.testing.assert_allclose(pade.gain_margins(study.robots(), order), want, tolerance)


@pytest.mark.exhaustive
def test_sampled_gain_margins_at_other_rates_have_a_closed_form(found):
    """z^2 + (k (a + b) - 2) z + 1 + k (a - b) has a root at -1 where k b = 2, b = kd T/m."""
    want = 2.0 * study.MASS * np.array(results.CONTROL_RATES) / study.KD
    np.testing.assert_allclose(found.rates[0, 0], want, rtol=1e-9)
    here = found.robots["sampled"]["gain_margin"]
    np.testing.assert_allclose(found.rates[..., 2], here, rtol=1e-9)


@pytest.mark.exhaustive
def test_margins_at_tripled_gains_follow_the_definition(found):
    robots = study.robots()
    for place in np.ndindex(robots.shape):
        case = (3 * study.KP, 3 * study.KD, study.MASS, *(a[place] for a in robots.columns))
        w = np.geomspace(1.0, 1000.0, 200001)
        L = response(case, w)
        (crossing,) = np.flatnonzero(np.diff(np.sign(np.abs(L) - 1.0)))
        late = np.angle(-L[crossing]) / w[crossing]
        got = found.tripled["delay_margin"][place]
        if math.isnan(got):
            assert late < 0.0
        else:
            assert got == pytest.approx(late, abs=1e-5)


@pytest.mark.exhaustive
def test_a_faster_joint_peaks_at_a_higher_frequency_in_proportion(found):
    base = found.robots["continuous"]["sensitivity_peak_frequency"][0, 0]
    np.testing.assert_allclose(found.speeds[0, 0], base * results.SPEEDS, rtol=1e-6)


@pytest.mark.parametrize("zeta", study.DAMPING_RATIOS)
def test_the_actuators_step_and_rise_time_are_scipys(zeta):
    t, want = scipy.signal.step(([1.0], [1.0 / 110.0**2, 2.0 * zeta / 110.0, 1.0]), N=40001)
    np.testing.assert_allclose(motion.actuator_step(110.0, zeta, t), want, atol=1e-9)
    rise = t[np.argmax(want > 0.9)] - t[np.argmax(want > 0.1)]
    assert motion.rise_time(110.0, zeta) == pytest.approx(rise, rel=1e-2)


@pytest.mark.exhaustive
def test_joints_steps_are_the_continuous_loops_where_sampling_hardly_matters(found):
    """Without actuator dynamics and delay: (kd s + kp)/(m s^2 + kd s + kp) without its kd s."""
    t = np.arange(found.robot_steps.shape[-1]) / study.CONTROL_RATE
    system = ([study.KP], [study.MASS, study.KD, study.KP])
    want = scipy.signal.step(system, T=t)[1]
    np.testing.assert_allclose(found.robot_steps[0, 0], want, atol=0.01)


@pytest.mark.exhaustive
def test_claims_are_judged_as_they_are_known_to_be(found):
    judged = claims(found)

    def verdict(words):
        (claim,) = [claim for claim in judged if words in claim.quote]
        return claim.verdict

    assert [claim.section for claim in judged] == sorted(claim.section for claim in judged)
    assert verdict("has infinite gain margin") == "Holds for continuous time (0 ms) only"
    assert verdict("factor of 3 to 5").startswith("Holds for HyQ to StarLETH, ")
    assert verdict("DM = min") == "Does not hold"
    assert verdict("unless they are very slow") == "Holds for HyQ only"
    assert "ζ 0.45" not in verdict("around 40 rad/s")
    assert verdict("unaltered hardware") == verdict("bare simulation suggests") == "Holds"
    assert verdict("reveals the instability") == "Holds for StarLETH (5 ms) only"
    assert sum(claim.verdict.startswith("Cannot be judged: ") for claim in judged) == 3


@pytest.mark.exhaustive
def test_quotes_are_short_and_every_judged_claim_has_cases(found):
    for claim in claims(found):
        assert len(claim.quote.split()) <= 25
        assert bool(claim.cases) != bool(claim.unjudged)


@pytest.mark.exhaustive
def test_claims_follow_the_numbers(found):
    """Nothing is typed in: other numbers give other verdicts."""
    robots = {kind: dict(found.robots[kind]) for kind in found.robots}
    for kind in robots:
        robots[kind]["gain_margin"] = np.array([[np.inf] * 3, [50.0] * 3, [50.0] * 3])
        robots[kind]["sensitivity_peak_frequency"] = np.full((3, 3), 99.0)
    rates = {"nominal": found.growth_rate["nominal"], "tripled": -np.ones((3, 3))}
    other = replace(
        found, robots=robots, growth_rate=rates, rates=found.rates[..., ::-1],
        speeds=0.0 * found.speeds, steps=3.0 * found.steps,
        robot_steps=np.cumsum(found.robot_steps, axis=0),
        robot_sensitivity=np.cumsum(found.robot_sensitivity, axis=0),
        faster=found.curves["continuous"] | {"delay_margin": np.ones((2, 3, 6))},
    )  # fmt: skip
    before, after = claims(found), claims(other)
    changed = {a.quote for a, b in zip(before, after, strict=True) if a.verdict != b.verdict}
    for words in (
        "has infinite gain margin", "factor of 3 to 5", "around 40 rad/s", "reveals the instab",
        "unless they are", "kinematic plans", "mitigate", "help indefinitely", "asymptotically",
        "lower extreme", "higher extreme", "noise rejection", "unmodeled", "discrete impl",
    ):  # fmt: skip
        assert any(words in quote for quote in changed), words


@pytest.mark.exhaustive
def test_report_says_first_whether_a_claim_holds(found):
    text = report(found)
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    columns = {len(row.replace("\\|", "").split("|")) - 2 for row in rows}
    assert columns == {3, 10}
    assert "nan" not in text and "inf " not in text and "e+0" not in text
    for figure in ("16.466", "3.9300", "54.524", "7.9420", "2.4023", "10.508"):
        assert figure in text
    assert "in 377 of the 377 stable continuous loops" in text
    off = re.search(r"in the 374 stable ones its margin is within (\S+) millionths of that", text)
    assert 0.0 < float(off[1]) < 20.0
    for claim in claims(found):
        assert f"\n\n**{claim.verdict}.** §{claim.section}: " in text
    assert text == report(found)
    for line in study.ASSUMED:
        assert line in text


@pytest.mark.exhaustive
def test_pictures_show_the_families(found):
    for name, picture in pictures.PICTURES.items():
        figure = picture(found)
        rows = {"figure_3_margins": 3}.get(name, 2)
        columns = 3 if name == "figure_4_sensitivity" else 2
        assert len(figure.axes) == rows * columns
        assert all("[" in axes.get_ylabel() for axes in figure.axes[::columns])
        unit = "time [" if name == "figure_2_steps" else "rad/s"
        assert all(unit in axes.get_xlabel() for axes in figure.axes[-columns:])
    left, right = pictures.margins(found).axes[:2]
    curves = [line for line in left.lines if len(line.get_xdata()) > 30]
    assert len(curves) == 6 and left.get_xscale() == left.get_yscale() == "log"
    marks = [line for line in right.lines if line.get_marker() in ("o", "s")]
    assert len(marks) == 6
    starts = [float(line.get_ydata()[0]) for line in curves]
    assert starts == pytest.approx([1.008, 1, 1, 1, 1, 1])


@pytest.mark.exhaustive
def test_the_experiment_writes_everything(found, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run, "compute", lambda: found)
    out = tmp_path / "new" / "paper"
    run.main(["--out", str(out)])
    assert sorted(path.name for path in out.iterdir()) == sorted(FILES)
    said = capsys.readouterr().out
    assert f"wrote {out}" in said and "Does not hold: 3.2: " in said
    assert (out / "claims.md").read_text(encoding="utf-8") == report(found)


@pytest.mark.exhaustive
def test_the_committed_claims_are_what_the_command_writes(found):
    committed = Path(__file__).parent.parent / "results" / "paper" / run.CLAIMS
    assert committed.is_file()
    lines = committed.read_text(encoding="utf-8").splitlines()
    for claim in claims(found):
        assert f"| {claim.section} | “{claim.quote}” | {claim.verdict} |" in lines
    for name in FILES:
        assert (committed.parent / name).is_file()
