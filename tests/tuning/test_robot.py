"""Gains of whole robots, held against SVD on a fine grid, brute force, and a single joint."""

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
import robots
from quickly import optimised_little

from jaxact.errors import UserError
from jaxact.loops import reading
from jaxact.loops import robots as sweep_robots
from jaxact.loops.samples import explicit
from jaxact.simulation import mujoco_batch, plans
from jaxact.tuning.box import Points, read_box
from jaxact.tuning.goal import Goal
from jaxact.tuning.groups import group
from jaxact.tuning.joint import spectrum
from jaxact.tuning.joint.ensemble import Sampling, ensemble
from jaxact.tuning.robot import cores, peaks, rows
from jaxact.tuning.robot import search as robot
from jaxact.tuning.robot.loops import VARIED, situation
from jaxact.tuning.robot.open_loops import open_loops
from jaxact.tuning.robot.rows import RobotCase
from jaxact.tuning.rollouts import tracking as robot_tracking
from jaxact.tuning.rollouts import validation
from jaxact.tuning.rollouts.exposure import exposed

SLIDER = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body name="block">
<joint name="slide" type="slide" axis="1 0 0"/><geom size="0.05" mass="0.7"/></body></worldbody>
<actuator><motor joint="slide"/></actuator></mujoco>"""
SPANS = "wn=0.8..1.2,delay=0.001..0.003"
# The same for all that are tuned: compiled once for as many loops and gains.
QUICK = {"starts": 2, "steps": 30}


def _specification(path, keyframe=None, extra="", joints=".*"):
    key = "" if keyframe is None else f'keyframe = "{keyframe}"'
    text = f"""
engine = "mujoco"
[plant]
model = '{path}'
joints = ['{joints}']
{key}
[parameters]
actuator = "hyq"
delay = 0.002
{extra}
[axes]
feedforward = [0.0]
"""
    return reading.parse(text)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("robots")
    keys = '<key name="straight" qpos="0 0" ctrl="0 0"/></keyframe>'
    (path / "arm.xml").write_text(robots.PENDULUM.replace("</keyframe>", keys))
    (path / "slider.xml").write_text(SLIDER)
    (path / "hopper.xml").write_text(robots.HOPPER)
    return path


@pytest.fixture(scope="module")
def arm(folder):
    """The arm in two postures, and what is uncertain of its drives."""
    box = read_box(SPANS, VARIED)
    names = ("home", "straight")
    return [situation(_specification(folder / "arm.xml", n), n, box) for n in names], box


@pytest.fixture(scope="module")
def known(folder):
    """The same with nothing uncertain."""
    return [situation(_specification(folder / "arm.xml", n), n) for n in ("home", "straight")]


@pytest.fixture(scope="module")
def tuned(arm):
    """The arm's gains, of each joint, over the box."""
    situations, _ = arm
    groups = group([], situations[0].names)
    start = situations[0].kp, situations[0].kd
    return robot.tune(
        situations, Goal(max_peak=1.8), groups, number=4, start=start, verify=True, **QUICK
    )


def _fine(loops, index, kp, kd, points=4000):
    """Largest singular values of S and T on a fine grid, by dense solves of the closed loop."""
    M, N, C = loops.closed(index, kp, kd)
    z = np.exp(1j * np.pi * np.geomspace(1e-4, 1.0, points))[:, None, None]
    S = np.eye(len(kp)) + C @ np.linalg.solve(z * np.eye(len(M)) - M, N[None].astype(complex))
    assert np.abs(np.linalg.eigvals(M)).max() < 1.0
    return np.linalg.norm(S, 2, axis=(1, 2)), np.linalg.norm(np.eye(len(kp)) - S, 2, axis=(1, 2))


@pytest.mark.exhaustive
def test_every_loop_meets_its_bounds_on_a_fine_grid_and_some_reach_them(tuned):
    assert tuned.certified and tuned.feasible
    highest = np.array(
        [[values.max() for values in _fine(tuned.members, i, tuned.kp, tuned.kd)]
         for i in range(len(tuned.members))]
    )  # fmt: skip
    assert np.all(highest <= 1.8 * (1.0 + 1e-9))
    assert highest.max() == pytest.approx(1.8, rel=1e-5)
    assert tuned.certificate.corners == 8 and len(tuned.members) >= 16


@pytest.mark.exhaustive
def test_brute_force_finds_no_better(tuned):
    assert tuned.certificate.gap < 2e-3
    assert tuned.value == pytest.approx(np.sqrt(tuned.kp[0] * tuned.kp[1]))


@pytest.mark.exhaustive
def test_random_points_of_the_box_meet_the_bounds_too(arm, tuned):
    situations, box = arm
    fraction = np.random.default_rng(0).uniform(size=(12, len(box)))
    members = Points(fraction, tuple(map(str, range(12))))
    loops = open_loops(situations, members)
    for index in range(len(loops)):
        S, T = _fine(loops, index, tuned.kp, tuned.kd, 800)
        assert max(S.max(), T.max()) <= 1.8 * (1.0 + 1e-7)


@pytest.mark.exhaustive
def test_exact_peaks_have_the_slopes_of_differences(arm):
    situations, _ = arm
    loops = open_loops(situations[:1], read_box(SPANS, VARIED).corners())
    table = peaks.tabulate(loops)
    kp, kd = np.array([90.0, 60.0]), np.array([5.0, 1.2])
    names = tuple(peaks.SHIFTS)
    found = peaks.peaks(table, kp, kd, names)
    fine = [_fine(loops, i, kp, kd) for i in range(len(loops))]
    highest = {name: np.exp(found[name].highest) for name in names}
    # Only the highest are refined.
    worst = int(np.argmax(highest["sensitivity_peak"]))
    assert highest["sensitivity_peak"][worst] == pytest.approx(fine[worst][0].max(), rel=1e-5)
    for name in names:
        top = int(np.argmax(found[name].highest))
        row = int(np.argmax(found[name].log[top]))
        for joint in range(2):
            for kind in range(2):
                ends = []
                for sign in (1.0, -1.0):
                    gains = [kp.copy(), kd.copy()]
                    gains[kind][joint] *= 1.0 + sign * 1e-5
                    ends.append(peaks.peaks(table, *gains, [name])[name].highest[top])
                step = 2e-5 * (kp, kd)[kind][joint]
                slope = found[name].slope[top, row, joint, kind]
                assert slope == pytest.approx((ends[0] - ends[1]) / step, rel=3e-3, abs=1e-7)


@pytest.mark.exhaustive
def test_one_joint_gets_the_gains_of_the_single_joint(folder):
    """A block on a rail is the mass loop, but for MuJoCo's steps: extrapolated to none."""
    found = []
    for step in (2e-4, 1e-4):
        path = folder / f"steps_{step:g}.xml"
        path.write_text(SLIDER.replace('timestep="0.001"', f'timestep="{step}"'))
        rail = situation(_specification(path), "rail")
        assert rail.kp is None  # a motor brings none
        tuned = robot.tune([rail], Goal(max_peak=1.6), group([], rail.names), **QUICK)
        assert tuned.certified
        found.append(np.log([tuned.kp[0], tuned.kd[0]]))
    kp, kd = np.exp(2.0 * found[1] - found[0])
    # The stiffest of a grid whose peaks are allowed, by the pulse transfer function of the joint.
    single = ensemble(0.7, 800.0, 0.45, 0.002, sampling=Sampling(1e-3))
    table = spectrum.tabulate(single, np.array([5e-3]), 4000)
    position, velocity = (part[0, 0] + 1j * part[0, 1] for part in (table.position, table.velocity))
    stiff, damped = kp * np.linspace(0.99, 1.01, 41), kd * np.linspace(0.98, 1.02, 81)
    peak = np.array([
        [max(abs(1.0 / (1.0 + loop)).max(), abs(loop / (1.0 + loop)).max())
         for loop in (p * position + d * velocity for d in damped)] for p in stiff
    ])  # fmt: skip
    allowed = peak <= 1.6
    best = np.flatnonzero(allowed.any(axis=1)).max()
    assert stiff[best] == pytest.approx(kp, rel=1.5e-3)
    assert damped[np.argmin(peak[best])] == pytest.approx(kd, rel=2e-3)


@pytest.mark.exhaustive
def test_gains_are_never_worse_than_the_start(arm, tuned):
    situations, _ = arm
    again = robot.tune(
        situations, Goal(max_peak=1.8), tuned.robot.case.groups, number=4,
        start=(tuned.kp, tuned.kd), **QUICK,
    )  # fmt: skip
    assert again.certified and again.value >= tuned.value * (1.0 - 1e-12)


@pytest.mark.exhaustive
def test_what_cannot_be_met_is_said_with_the_closest_value(known):
    situations = known
    one = situations[:1]
    groups = group(["shoulder", "elbow"], one[0].names)
    tuned = robot.tune(one, Goal(max_peak=1.3, min_kp=300.0), groups, **QUICK)
    assert not tuned.feasible and not tuned.certified and "infeasible" in tuned.verdict
    closest = max(check.value for check in tuned.closest)
    assert closest > 1.3 and f"{closest:.4g}"[:4] in tuned.verdict and tuned.kp.min() >= 300.0
    # No gains nearby are closer.
    random = np.random.default_rng(1)
    for _ in range(40):
        kp = np.maximum(tuned.kp * np.exp(random.uniform(0.0, 0.3, 2)), 300.0)
        kd = tuned.kd * np.exp(random.uniform(-0.3, 0.3, 2))
        M = tuned.members.closed(0, kp, kd)[0]
        if np.abs(np.linalg.eigvals(M)).max() < 1.0:
            assert max(v.max() for v in _fine(tuned.members, 0, kp, kd, 400)) > closest * 0.999


@pytest.mark.exhaustive
@pytest.mark.exhaustive
def test_other_processes_that_help_change_nothing(arm, tuned, monkeypatch):
    situations, _ = arm
    monkeypatch.setattr(rows, "_LONG", 0)
    monkeypatch.setattr(cores, "number", lambda: 2)
    again = robot.tune(
        situations, Goal(max_peak=1.8), tuned.robot.case.groups, number=4, verify=True,
        start=(situations[0].kp, situations[0].kd), **QUICK,
    )  # fmt: skip
    np.testing.assert_array_equal([again.kp, again.kd], [tuned.kp, tuned.kd])
    assert again.certified and again.value == tuned.value


def test_an_unstable_start_is_rescued(arm):
    situations, box = arm
    groups = group([], situations[0].names)
    far = np.array([4e3, 3e3]), np.array([1.0, 0.02])
    loops = open_loops(situations, box.corners())
    assert peaks.growth_rates(loops, *far).max() > 0.0
    tuned = robot.tune(situations, Goal(max_peak=1.8), groups, number=4, start=far, **QUICK)
    assert tuned.certified and tuned.improved and np.isnan(tuned.value_before)


@pytest.mark.exhaustive
def test_the_disk_margin_is_made_large(known):
    situations = known
    groups = group([], situations[0].names)
    goal = Goal(objective="disk-margin", max_peak=np.inf, min_kp=60.0)
    tuned = robot.tune(situations, goal, groups, **QUICK)
    assert tuned.certified and tuned.kp.min() >= 60.0
    from jaxact.analysis.robot.disk import largest_bound
    from jaxact.analysis.robot.multiloop import grid, multiloop, sensitivity

    def margin(kp, kd):
        worst = []
        for index in range(len(tuned.members)):
            loop = multiloop(*tuned.members.closed(index, kp, kd), 1e-3)
            angle = grid(loop)
            worst.append(1.0 / largest_bound(loop, angle, sensitivity(loop, angle))[0])
        return min(worst)

    assert tuned.value == pytest.approx(margin(tuned.kp, tuned.kd), rel=1e-6)
    random = np.random.default_rng(2)
    for _ in range(12):
        kp = np.maximum(tuned.kp * np.exp(random.uniform(-0.2, 0.2, 2)), 60.0)
        kd = tuned.kd * np.exp(random.uniform(-0.2, 0.2, 2))
        assert margin(kp, kd) <= tuned.value * (1.0 + 2e-3)


@pytest.mark.exhaustive
def test_a_group_of_all_shares_its_gains(known):
    situations = known
    groups = group(["."], situations[0].names)
    tuned = robot.tune(situations, Goal(max_peak=2.5), groups, verify=True, **QUICK)
    assert tuned.certified and tuned.kp[0] == tuned.kp[1] and tuned.certificate.gap < 2e-3


@pytest.mark.exhaustive
def test_smooth_peaks_become_the_exact_ones(arm, tuned):
    """In float32, and where no peak lies between two frequencies of the table."""
    from jaxact.tuning.robot import smooth

    table, groups = tuned.robot.case.table, tuned.robot.case.groups
    goal = Goal(max_peak=2.0)
    x = groups.log_gains(tuned.kp, tuned.kd)
    low, high = x - 5.0, x + 5.0
    case = RobotCase(table, groups, goal, low, high)
    data = smooth.data(table, groups, goal, low, high, table.angle.shape[1])
    surrogate = smooth.RobotSurrogate(goal, *table.angle.shape)
    seen_at = jax.jit(lambda x, sharpness: surrogate(x, data, sharpness))
    seen = seen_at(np.float32(x), np.float32(1e4))
    over = rows.excess(case, x).max()
    assert float(seen.violation) == pytest.approx(over, abs=3e-3)
    assert float(seen.value) == pytest.approx(np.log(tuned.value), rel=1e-5)
    # Its slope is that of the exact rows' mean.
    slope = jax.jit(jax.jacfwd(lambda x: seen_at(x, np.float32(60.0)).violation))(np.float32(x))
    ends = [
        seen_at(np.float32(x + side), np.float32(60.0)).violation
        for side in 5e-3 * np.concatenate([np.eye(4), -np.eye(4)])
    ]
    numeric = (np.array(ends[:4]) - np.array(ends[4:])) / 1e-2
    np.testing.assert_allclose(slope, numeric, atol=0.03)


@pytest.mark.exhaustive
def test_simulated_tracking_is_traded_for_stiffness_where_that_is_asked_for(known):
    """Held against MuJoCo's own rollouts in C; the bounds hold as before."""
    one, groups = known[:1], group([], known[0].names)
    plain = robot.tune(one, Goal(max_peak=1.8), groups, **QUICK)
    idle = robot.tune(one, Goal(max_peak=1.8), groups, tracking_weight=0.0, **QUICK)
    assert idle.robot.tracked is None
    np.testing.assert_array_equal([idle.kp, idle.kd], [plain.kp, plain.kd])
    with optimised_little():
        traded = robot.tune(one, Goal(max_peak=1.8), groups, tracking_weight=2.0, **QUICK)
    assert traded.certified and traded.value < plain.value
    S, T = _fine(traded.members, 0, traded.kp, traded.kd)
    assert max(S.max(), T.max()) <= 1.8 * (1.0 + 1e-9)
    # Better by the objective that was asked for, and in simulation by what is said.
    errors = [_simulated(one[0].specification, *gains)
              for gains in ((plain.kp, plain.kd), (traded.kp, traded.kd))]  # fmt: skip
    assert errors[1] < 0.95 * errors[0]
    said = traded.robot.tracked
    assert said.mode == "forward" and said.rms / said.aside == pytest.approx(
        errors[1] / errors[0], rel=0.02
    )
    assert np.log(traded.value / plain.value) - 2.0 * np.log(said.rms / said.aside) > 1e-3


def _simulated(specification, kp, kd):
    """Rms error of a rollout in C after the usual push."""
    asked = exposed(specification, duration=robot_tracking.SECONDS)
    scene = sweep_robots.scene(asked.plant)
    asked = validation.with_gains(asked, scene, scene.labels, kp, kd, {})
    asked = replace(asked, engine="mujoco", precision="float64")
    samples = explicit(asked, {"feedforward": np.zeros(1)})
    (plan,) = plans.groups(asked, samples)
    squares = []

    def watch(simulations, _coefficients):
        def observe(place, state, _force):
            if place == 0:
                off = simulations.measure()[:, 0] - np.asarray(state.setpoint.position)
                squares.append(off**2)

        return observe

    one = np.arange(1)
    with jax.enable_x64(True):
        mujoco_batch.metrics(
            plan.case, asked.setting, samples.take(one), np.zeros(1), asked.seed, one, watch=watch
        )
    return float(np.sqrt(np.mean(squares)))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"tracking_weight": -1.0}, "`tracking_weight`"),
        ({"tracking_weight": 1.0, "derivative": "sideways"}, "`derivative`"),
    ],
)
def test_weights_that_make_no_sense(known, given, said):
    with pytest.raises(UserError, match=said):
        robot.tune(known, Goal(), group([], known[0].names), **given)


@pytest.mark.parametrize(
    ("goal", "said"),
    [
        (Goal(objective="bandwidth"), "of a robot stiffness or disk-margin"),
        (Goal(min_delay_margin=1e-3), "`min_delay_margin`: .* `uncertainty` output_delay=0..0.001"),
        # (2 + 2/3) / (2 - 2/3) = 2
        (Goal(min_gain_margin=2.0), "`min_gain_margin`: .* `min_disk_margin` 0.6667 leaves"),
        (Goal(max_noise_gain=2.0), "`max_noise_gain`: .* `max_kp` and `max_peak`"),
        (Goal(risk="mean"), "`risk` mean: .* narrower `uncertainty`"),
        (Goal(max_peak=np.inf), "nothing limits"),
    ],
)
def test_goals_that_a_robot_cannot_be_asked_for(arm, goal, said):
    situations, _ = arm
    with pytest.raises(UserError, match=said):
        robot.tune(situations, goal, group([], situations[0].names))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("speed=1..2", "'speed'"), ("wn", "NAME=LOW..HIGH"), ("wn=2..1", "above"),
        ("mass=0.5..1", "vary payload"), ("wn=1..2,wn=1..2", "twice"),
        ("delay=a..b", "not a number"),
        ("delay=-1..1", "out of range"), ("delay=1x..2", "both ends"),
    ],
)  # fmt: skip
def test_boxes_that_make_no_sense(text, said):
    with pytest.raises(UserError, match=said):
        read_box(text, VARIED)


def test_what_is_ideal_does_not_vary_by_a_factor(folder):
    specification = _specification(Path(folder / "arm.xml"), "home", "")
    ideal = specification.parameters | {"actuator": "ideal"}
    with pytest.raises(UserError, match="the actuator is ideal"):
        situation(replace(specification, parameters=ideal), "home", read_box("wn=0.8..1.2", VARIED))


@pytest.mark.exhaustive
def test_a_joint_that_its_limit_holds_is_refused_and_the_other_gets_what_it_gets_alone(folder):
    """No force moves it, so that it would bear any."""
    body = '<body pos="{0} 0 0"><joint name="j{0}" axis="0 1 0" armature="0.1" {1}/>{2}</body>'
    sphere = '<geom size="0.05" mass="1" contype="0" conaffinity="0"/>'
    found = []
    for bodies in ([""], ["", 'range="0.2 1" limited="true"']):
        joints = "".join(body.format(n, more, sphere) for n, more in enumerate(bodies))
        motors = "".join(f'<motor joint="j{n}"/>' for n in range(len(bodies)))
        path = folder / f"held_{len(bodies)}.xml"
        path.write_text(
            '<mujoco><option gravity="0 0 0" timestep="0.001"/>'
            f"<worldbody>{joints}</worldbody><actuator>{motors}</actuator></mujoco>"
        )
        one = situation(_specification(path, joints="j0"), "arm")
        found.append(robot.tune([one], Goal(max_peak=1.6), group([], one.names), **QUICK))
    alone, beside = found
    assert beside.certified
    np.testing.assert_allclose([beside.kp, beside.kd], [alone.kp, alone.kd], rtol=1e-3)
    both = situation(_specification(path), "arm")
    with pytest.raises(UserError, match="^j1 .* held there by its limit"):
        robot.tune([both], Goal(max_peak=1.6), group([], both.names), **QUICK)
