"""What is written and drawn of a tuned joint is of the loops that its certificate is of."""

from types import SimpleNamespace

import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.loops import toml
from jaxact.tuning.document import _of_joint, _of_member
from jaxact.verbs import report_tuned, tuning_pictures, tuning_tables
from jaxact.verbs.plants import nominal_of

LOOP = jx.joint(mass=0.7, actuator="hyq", delay=2e-3)
DIFFERENCED = LOOP.replace(velocity="differenced", control_rate=200.0)
FILTERED = DIFFERENCED.replace(velocity_filter=150.0)


def _tuned(loop, sampled):
    """As far as files and pictures look at a result."""
    members = nominal_of(loop, sampled)
    return SimpleNamespace(kp=400.0, kd=20.0, before=None, loop=loop, members=members,
                           continuous=not sampled)  # fmt: skip


@pytest.mark.parametrize("loop", (LOOP.replace(control_rate=500.0), DIFFERENCED, FILTERED))
def test_written_loops_see_the_velocity_that_they_were_tuned_with(loop, tmp_path):
    tuned = _tuned(loop, sampled=True)
    row = {"name": "nominal", **_of_member(tuned, tuned.members, 0)}
    (tmp_path / "gains.toml").write_text(toml.dumps({"loop": [row]}))
    read = jx.loop_of(tmp_path / "gains.toml")
    assert read.kind.velocity == loop.kind.velocity
    for name in ("mass", "wn", "zeta", "delay", "control_rate", "velocity_filter"):
        assert np.ravel(getattr(read, name)) == pytest.approx(np.ravel(getattr(loop, name)))


@pytest.mark.parametrize("sampled", (True, False))
def test_a_report_has_the_velocity_filter_too(sampled):
    tuned = _tuned(FILTERED, sampled)
    row = {"name": "nominal", **_of_member(tuned, tuned.members, 0)}
    gains = {"kp": tuned.kp, "kd": tuned.kd}
    shown = report_tuned._loops({"gains": gains, "assumed": _of_joint(tuned), "loop": [row]})
    assert shown.kind.velocity == "differenced" and float(shown.velocity_filter[0]) == 150.0


@pytest.mark.parametrize("given", ({}, {"control_rate": 500.0}))
@pytest.mark.parametrize("sampled", (True, False))
def test_pictures_are_of_the_loop_that_is_certified(given, sampled):
    """Whether it is sampled, whatever control rate the loop was given."""
    loop = LOOP.replace(**given)
    drawn = tuning_pictures.before_and_after(_tuned(loop, sampled), loop)
    rates = [one.nyquist_frequency / np.pi for one in drawn if np.isfinite(one.nyquist_frequency)]
    assert rates == ([pytest.approx(given.get("control_rate", 1000.0))] if sampled else [])


@pytest.mark.exhaustive
@pytest.mark.parametrize("sampled", (True, False))
def test_tables_are_of_the_loop_that_is_certified(sampled):
    loop = LOOP if sampled else LOOP.replace(control_rate=200.0)
    best = jx.tune(loop, max_peak=1.6, sampled=sampled, starts=1, steps=20)
    after = tuning_tables.Joint(best, best.loop, "joint").report()["margins"]["after"]
    for check in best.certificate.checks:
        assert after[check.metric] == pytest.approx(check.value, rel=1e-6)
