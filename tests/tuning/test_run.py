"""Constraints, rescue, uncertainty, objectives: what tuning promises, held against other code."""

import math

import brute_force
import exact
import numpy as np
import pytest
from loops import largest_peaks, margins_of
from quickly import compiled_quickly as compiled_quickly

from jaxact.errors import UserError
from jaxact.tuning.box import Points, read_box
from jaxact.tuning.goal import Goal, tail_weights
from jaxact.tuning.joint import brute
from jaxact.tuning.joint import problem as joint
from jaxact.tuning.joint.ensemble import FIELDS, Sampling, ensemble, uncertain
from jaxact.tuning.joint.exchange import fractions
from jaxact.tuning.joint.problem import Case
from jaxact.tuning.joint.response import timed
from jaxact.tuning.joint.search import STARTS, front, tune, tune_all
from jaxact.tuning.optimise import Descent

STARLETH = ensemble(0.7, 110.0, 0.9, 1e-3)
LATE = ensemble(0.7, 110.0, 0.9, 5e-3)
# Besides a start of one's own, so that there are as many in all and nothing is compiled anew.
OTHERS = STARTS - 1


def test_what_cannot_be_met_is_said_with_the_closest_value():
    """The study's loop: Ms cannot get below 2.9761 at kp = 400, best at kd = 24.49."""
    tuned = tune(LATE, Goal(max_peak=1.6, min_kp=400.0))
    assert not tuned.feasible and not tuned.certified
    assert "infeasible" in tuned.verdict and "2.976" in tuned.verdict
    assert "sensitivity peak" in tuned.verdict and "max_peak" in tuned.verdict
    (worst, _) = tuned.closest
    assert worst.value == pytest.approx(2.9761, abs=1e-4) and tuned.kp == 400.0
    assert tuned.kd == pytest.approx(24.49, rel=2e-3)


def test_a_member_without_any_lag_is_limited_by_the_others():
    """An ideal drive whose delay may be nothing: the delay that it may have limits the gains."""
    members = uncertain(ensemble(0.7, math.inf, 1.0, 0.0), read_box("delay=0..5e-3", FIELDS))
    late = members.at(Points(np.array([[0.0], [1.0]]), ("none", "late")))
    tuned = tune(late, Goal(max_peak=1.6))
    s = 1j * np.geomspace(0.1, 1e4, 100_000)
    loop = (tuned.kp + tuned.kd * s) / (0.7 * s * s) * np.exp(-5e-3 * s)
    assert tuned.certified and np.abs(1.0 / (1.0 + loop)).max() == pytest.approx(1.6, rel=1e-6)
    alone = tune(ensemble(0.7, math.inf, 1.0, 5e-3), Goal(max_peak=1.6))
    assert tuned.kp == pytest.approx(alone.kp, rel=1e-6)
    with pytest.raises(UserError, match="nothing limits"):
        tune(ensemble(0.7, math.inf, 1.0, 0.0), Goal(max_peak=1.6))


def test_no_stable_gains_at_all_is_said_too():
    tuned = tune(LATE, Goal(max_peak=1.6, min_kp=5000.0))
    assert not tuned.feasible and "stable" in tuned.verdict


def test_a_start_softer_than_allowed_is_not_the_closest():
    tuned = tune(LATE, Goal(max_peak=1.6, min_kp=5000.0), start=(400.0, 20.0), starts=OTHERS)
    assert tuned.kp >= 5000.0 and tuned.verdict.startswith("found infeasible: no gains with kp")


def test_of_an_unstable_start_nothing_is_said_to_be_good_enough():
    tuned = tune(LATE, Goal(max_peak=1.6, min_kp=5000.0), start=(5000.0, 1.0), starts=OTHERS)
    assert not tuned.certificate.stable and tuned.verdict.startswith("found infeasible: no gains")


@pytest.mark.exhaustive
def test_fifty_unstable_starts_are_rescued():
    members, peaks = brute_force.random_members(50, 3)
    random = np.random.default_rng(4)
    lag = members[:, 3] + 2.0 * members[:, 2] / members[:, 1]
    kp = members[:, 0] / lag**2 * np.exp(random.uniform(-0.5, 3.0, 50))
    kd = members[:, 0] / lag * np.exp(random.uniform(-3.0, 2.0, 50))
    cases = [
        Case(ensemble(*row), Goal(max_peak=float(peak)))
        for row, peak in zip(members, peaks, strict=True)
    ]
    plants = ensemble(*members.T)
    assert not margins_of(plants, kp, kd).stable.any()
    # No default start helps: each has to find back from where it is.
    tuned = tune_all(cases, list(zip(kp, kd, strict=True)), starts=0)
    assert all(t.certified and t.improved for t in tuned)
    assert all(math.isnan(t.value_before) for t in tuned)
    found = margins_of(plants, [t.kp for t in tuned], [t.kd for t in tuned])
    assert np.all(found.sensitivity_peak <= peaks * (1 + 1e-9))


def test_gains_are_never_worse_than_the_start():
    best = tune(STARLETH, Goal(max_peak=1.6))
    # One step of descent from a start that is already the optimum cannot do better.
    again = tune(STARLETH, Goal(max_peak=1.6), start=(best.kp, best.kd), starts=OTHERS)
    assert again.kp >= best.kp * (1.0 - 1e-12)
    softer = tune(STARLETH, Goal(max_peak=1.6), start=(20.0, 8.0), starts=OTHERS)
    assert softer.improved and softer.kp > 20.0 and softer.value_before == pytest.approx(20.0)
    # Where nothing can be met, the closer of the two is kept.
    kept = tune(LATE, Goal(max_peak=1.6, min_kp=400.0), start=(400.0, 24.506), starts=OTHERS)
    assert kept.certificate.checks[0].value <= 2.97616


@pytest.mark.exhaustive
def test_every_constraint_binds_where_it_should():
    # Bounds that ask for next to nothing keep the three goals of one kind: compiled once.
    easy = {"max_peak": 2.5, "min_gain_margin": 1.01, "min_delay_margin": 1e-6}
    goal = Goal(**easy | {"min_gain_margin": 6.0})
    tuned = tune(LATE, goal)
    found = margins_of(LATE, tuned.kp, tuned.kd)
    assert found.gain_margin[0] == pytest.approx(6.0, rel=1e-8) and tuned.certified
    assert found.gain_margin[0] >= 6.0 * (1 - 1e-9)
    goal = Goal(**easy | {"min_delay_margin": 0.05})
    tuned = tune(LATE, goal)
    found = margins_of(LATE, tuned.kp, tuned.kd)
    assert found.delay_margin[0] >= 0.05 * (1 - 1e-9) and tuned.certified
    tuned = tune(STARLETH, Goal(**easy, max_kp=90.0))
    assert tuned.kp == pytest.approx(90.0) and tuned.kp <= 90.0


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("objective", "bounds"),
    [("disk-margin", {"max_peak": math.inf, "min_kp": 100.0}), ("bandwidth", {"max_peak": 1.6})],
)
def test_other_objectives_leave_brute_force_nothing(objective, bounds):
    tuned = tune(LATE, Goal(objective=objective, **bounds), verify=True)
    assert tuned.certified and tuned.certificate.gap < 1e-3
    if objective == "disk-margin":
        found = margins_of(LATE, 100.0 * np.ones(400), np.linspace(8.0, 25.0, 400))
        assert tuned.value == pytest.approx(float(np.nanmax(found.disk_margin)), rel=1e-4)


@pytest.mark.exhaustive
def test_settling_is_faster_than_a_grid_of_gains_allows():
    goal = Goal(objective="settling", max_peak=1.6)
    tuned = tune(STARLETH, goal)
    how = timed(goal, [STARLETH])
    kp, kd = (a.ravel() for a in np.meshgrid(np.geomspace(40, 180, 24), np.geomspace(6, 20, 24)))
    found = joint.exact([Case(STARLETH, goal)] * kp.size, np.log([kp, kd]).T, how)
    met = (found.log["sensitivity_peak"] <= np.log(1.6))[:, 0]
    met &= (found.log["complementary_peak"] <= np.log(1.6))[:, 0]
    best = np.exp(found.log["settling_time"][met].min())
    assert tuned.certified and tuned.value < 1.001 * best


def _sampled_peak(kp, kd, *plant, period):
    """Largest |S| or |T|: S = det(z I - open) / det(z I - closed) of SciPy's matrices."""
    closed, opened = (
        np.linalg.eigvals(exact.one_period(p, d, *plant, period=period)[0])
        for p, d in ((kp, kd), (0.0, 0.0))
    )
    assert np.abs(closed).max() < 1.0

    def larger(angle):
        z = np.exp(1j * angle)[:, None]
        sensitivity = np.prod(z - opened, axis=1) / np.prod(z - closed, axis=1)
        return np.maximum(np.abs(sensitivity), np.abs(1.0 - sensitivity))

    angle = np.linspace(1e-3, np.pi, 5000)
    for _ in range(3):
        top = angle[np.argmax(larger(angle))]
        step = angle[1] - angle[0]
        angle = np.linspace(top - step, top + step, 1001)
    return larger(angle).max()


@pytest.mark.exhaustive
def test_sampled_margins_count_where_a_control_rate_is_given():
    members = ensemble(0.7, 110.0, 0.9, 1e-3, sampling=Sampling(5e-3))
    tuned = tune(members, Goal(max_peak=1.6))
    peak = _sampled_peak(tuned.kp, tuned.kd, 0.7, 110.0, 0.9, 1e-3, period=5e-3)
    assert tuned.certified
    assert peak == pytest.approx(1.6, rel=1e-6) and peak <= 1.6 * (1 + 1e-9)
    # The hold costs about half a period of delay.
    held = tune(ensemble(0.7, 110.0, 0.9, 3.5e-3), Goal(max_peak=1.6))
    assert tuned.kp == pytest.approx(held.kp, rel=0.02)


@pytest.mark.exhaustive
def test_a_filter_of_the_velocity_counts_in_continuous_time():
    """Against frequency responses on a dense grid, with poles and zeros written out here."""
    mass, wn, zeta, delay, cutoff = 0.7, 110.0, 0.9, 1e-3, 60.0
    members = ensemble(mass, wn, zeta, delay, sampling=Sampling(velocity_filter=cutoff))
    tuned = tune(members, Goal(max_peak=1.6))
    assert tuned.certified
    s = 1j * np.geomspace(0.05, 5e4, 20_000)
    plant = np.exp(-s * delay) / (mass * s**2 * (1.0 + 2.0 * zeta * s / wn + (s / wn) ** 2))

    def peak(kp, kd):
        loop = (kp + kd * s / (1.0 + s / cutoff)) * plant
        return max(np.abs(1.0 / (1.0 + loop)).max(), np.abs(loop / (1.0 + loop)).max())

    assert peak(tuned.kp, tuned.kd) == pytest.approx(1.6, rel=1e-5)
    # Stiffer by 2 %, no damping is within the bound.
    factors = np.geomspace(0.5, 2.0, 200)
    assert min(peak(1.02 * tuned.kp, tuned.kd * factor) for factor in factors) > 1.6
    # Without the filter the joint may be much stiffer.
    assert tune(STARLETH, Goal(max_peak=1.6)).kp > 1.5 * tuned.kp


@pytest.mark.exhaustive
def test_the_whole_box_is_certified_corners_and_interior():
    box = read_box("wn=0.8..1.2,zeta=0.7..1.1,delay=0..5e-3,mass=0.5..1.0", FIELDS)
    tuned = tune(STARLETH, Goal(max_peak=1.6), box, number=16)
    assert tuned.certified and tuned.certificate.corners == 16
    assert len(tuned.members) >= 32 and tuned.certificate.interior <= 1e-10
    fraction = np.random.default_rng(0).uniform(size=(4000, 4))
    inside = uncertain(STARLETH, box).at(Points(fraction, ()))
    assert largest_peaks(inside, tuned.kp, tuned.kd).max() <= 1.6 * (1 + 1e-9)


def _peaks(kp, kd, wn, zeta, delay):
    """Largest of Ms and Mt of a mass of 0.7 kg, on a grid that is dense at the actuator's wn."""
    w = np.sort(np.append(np.geomspace(1e-2, 1e4, 6000), wn * np.linspace(0.9, 1.1, 6001)))
    s = 1j * w
    loop = (kp + kd * s) * np.exp(-s * delay) / (1 + 2 * zeta * s / wn + (s / wn) ** 2)
    sensitivity = 1.0 / np.abs(1.0 + loop / (0.7 * s * s))
    return max(sensitivity.max(), np.max(sensitivity * np.abs(loop / (0.7 * s * s))))


@pytest.mark.parametrize("zeta", [0.01, 0.004])
def test_gains_are_found_behind_a_servo_that_rings(zeta):
    """They are far softer than what its lag alone would allow."""
    tuned = tune(ensemble(0.7, 70.0, zeta, 3e-3), Goal(max_peak=2.5))
    assert tuned.certified and _peaks(tuned.kp, tuned.kd, 70.0, zeta, 3e-3) <= 2.5 * (1 + 1e-9)
    # With more damping the resonance, late by more than half a turn, exceeds 1 and is unstable.
    damping = np.geomspace(0.2 * tuned.kd, 2.0 * zeta * 70.0 * 0.7, 60)
    stiffer = [_peaks(1.02 * tuned.kp, kd, 70.0, zeta, 3e-3) for kd in damping]
    assert min(stiffer) > 2.5


def test_a_front_holds_inside_the_box_too():
    nominal, few = ensemble(0.7, 300.0, 0.05, 2e-3), {"starts": 2, "how": Descent(steps=30)}
    box = read_box("wn=0.6..1.3,delay=0..8e-3", FIELDS)
    tuned = tune(nominal, Goal(max_peak=2.0), box, number=2, **few)
    assert f"(2 samples, 4 corners, {len(tuned.members) - 6} interior point" in tuned.verdict
    plants = uncertain(nominal, box)
    points = front(tuned.members, Goal(), 2, plants=plants, **few)
    for one in (tuned, *points):
        peaks = [
            _peaks(one.kp, one.kd, 300.0 * wn, 0.05, delay)
            for wn in np.linspace(0.6, 1.3, 25)
            for delay in np.linspace(0.0, 8e-3, 25)
        ]
        assert one.certified and max(peaks) <= one.goal.max_peak * (1 + 1e-6)


def test_gains_of_brute_force_must_hold_for_the_box(monkeypatch):
    box = read_box("delay=0..5e-3", FIELDS)
    own = tune(STARLETH, Goal(max_peak=1.6), box, number=2)
    x = np.log([1.02 * own.kp, own.kd])
    monkeypatch.setattr(brute, "brute_force", lambda case: brute.Brute(x[0], x, 1))
    tuned = tune(STARLETH, Goal(max_peak=1.6), box, number=2, verify=True)
    assert tuned.certified and tuned.kp == own.kp
    assert tuned.certificate.gap == pytest.approx(0.02)


def test_factors_on_a_negative_stiffness_are_where_they_are():
    upright = ensemble(0.7, 110.0, 0.9, 1e-3, 0.0, -20.0)
    plants = uncertain(upright, read_box("joint_stiffness=0.5x..2x,wn=0.8..1.2", FIELDS))
    points = plants.box.sample(8, 0)
    np.testing.assert_allclose(fractions(plants, plants.at(points)), points.fraction, atol=1e-12)


@pytest.mark.exhaustive
def test_a_milder_risk_gives_stiffer_gains():
    box = read_box("wn=0.8..1.2,delay=0..5e-3", FIELDS)
    members = uncertain(STARLETH, box).at(box.sample(32, 0))
    cases = {risk: tune(members, Goal(max_peak=1.6, risk=risk)) for risk in
             ("worst", "cvar:0.75", "mean")}  # fmt: skip
    assert cases["worst"].kp < cases["cvar:0.75"].kp < cases["mean"].kp
    assert all(t.certified for t in cases.values())
    found = margins_of(members, cases["mean"].kp, cases["mean"].kd)
    assert np.mean(np.log(found.sensitivity_peak)) <= np.log(1.6) + 1e-9
    found = margins_of(members, cases["cvar:0.75"].kp, cases["cvar:0.75"].kd)
    worst = np.sort(np.log(found.sensitivity_peak))[-8:]
    assert worst.mean() <= np.log(1.6) + 1e-9


def test_tail_weights_are_the_mean_of_the_worst_share():
    values = np.array([3.0, 1.0, 2.0, 5.0])
    assert tail_weights(values, 0.5) @ values == pytest.approx(4.0)
    assert tail_weights(values, 1.0) @ values == pytest.approx(values.mean())
    assert tail_weights(values, 0.375) @ values == pytest.approx((5.0 + 0.5 * 3.0) / 1.5)


def test_the_front_rises_and_passes_through_the_single_optimum():
    points = front(STARLETH, Goal(), 5)
    kp = [point.kp for point in points]
    assert np.all(np.diff(kp) > 0) and all(point.certified for point in points)
    single = tune(STARLETH, Goal(max_peak=points[2].goal.max_peak))
    assert single.kp == pytest.approx(points[2].kp, rel=1e-6)


@pytest.mark.parametrize(
    ("goal", "said"),
    [
        (Goal(objective="speed"), "objective 'speed'"),
        (Goal(max_peak=1.0), "`max_peak` 1"),
        (Goal(min_kp=5.0, max_kp=4.0), "above"),
        (Goal(risk="cvar:2"), "risk 'cvar:2'"),
        (Goal(objective="disk-margin"), "`min_kp`"),
        (Goal(max_peak=math.inf), "nothing limits"),
        (Goal(min_delay_margin=math.nan), "`min_delay_margin`"),
    ],
)
def test_goals_that_make_no_sense(goal, said):
    with pytest.raises(UserError, match=said):
        tune(STARLETH, goal)


@pytest.mark.parametrize(
    "text",
    [
        "wn",
        "wn=1",
        "speed=1..2",
        "wn=2..1",
        "wn=a..b",
        "delay=-1..0",
        "wn=1..2,wn=1..2",
        "wn=0..1",
        "delay=0..2x",
        "payload=0..1",
    ],
)
def test_boxes_that_make_no_sense(text):
    with pytest.raises(UserError, match="uncertainty"):
        uncertain(STARLETH, read_box(text, FIELDS))


def test_factors_and_values_of_a_box():
    plants = uncertain(STARLETH, read_box("wn=0.5..2,mass=0.5..1,delay=1x..3x", FIELDS))
    corners = plants.at(plants.box.corners())
    assert set(corners.natural_frequency) == {55.0, 220.0} and set(corners.mass) == {0.5, 1.0}
    assert corners.delay.max() == pytest.approx(3e-3) and len(corners) == 8


def test_ranges_without_a_width_are_no_dimensions():
    plants = uncertain(STARLETH, read_box("mass=0.5..0.5,wn=1..1,delay=1e-3..2e-3", FIELDS))
    assert len(plants.box) == 1 and plants.nominal.mass == [0.5]
    points = plants.box.members(4, 0)
    assert points.names[4:] == ("corner delay-", "corner delay+")
    members = plants.at(points)
    assert set(members.mass) == {0.5} and set(members.natural_frequency) == {110.0}


def test_a_box_without_any_width_is_the_loop_alone():
    known = read_box("mass=0.5..0.5,delay=5e-3..5e-3", FIELDS)
    alone = tune(ensemble(0.5, 110.0, 0.9, 5e-3), Goal(max_peak=1.6))
    tuned = tune(STARLETH, Goal(max_peak=1.6), known)
    assert (tuned.kp, tuned.kd) == (alone.kp, alone.kd) and tuned.verdict == alone.verdict
    assert len(tuned.members) == 1 and tuned.certificate.corners == 0
    assert tuned.certificate.interior is None


def test_the_order_of_ranges_does_not_matter():
    texts = ("wn=0.8..1.2,delay=0..5e-3", "delay=0..5e-3,wn=0.8..1.2")
    assert read_box(texts[0], FIELDS) == read_box(texts[1], FIELDS)


def test_a_range_may_have_the_other_name_of_its_parameter():
    box = read_box("inertia=0.04..0.06", FIELDS)
    assert box == read_box("mass=0.04..0.06", FIELDS)
    with pytest.raises(UserError, match="mass is given twice"):
        read_box("inertia=1..2,mass=1..2", FIELDS)
