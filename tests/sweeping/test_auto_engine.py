"""Which engine `engine = "auto"` comes to: by the robot and the length of the sweep."""

import jax
import pytest
from robots import HOPPER, PENDULUM, QUADRUPED

from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.plants import mujoco, warp
from jaxact.plants.mjx import side_by_side
from jaxact.simulation import engines
from jaxact.sweeping import throughput

LIMITED = PENDULUM.replace('axis="0 1 0"', 'axis="0 1 0" limited="true" range="-170 170"')
_BOX = '<geom name="box" type="box" size="0.2 0.15 0.1" mass="8"/>'
_FEET = "".join(
    f'<geom size="0.02" pos="{x} {y} -0.08" mass="2"/>' for x in (-0.2, 0.2) for y in (-0.15, 0.15)
)
ON_FEET = HOPPER.replace(_BOX, _FEET).replace("<option", '<option iterations="4"')
MODELS = {
    "two hinges": PENDULUM,
    "two hinges with limits": LIMITED,
    "hopper": ON_FEET,
    "hopper on a box": HOPPER,
    "hopper, its solver not ended early": ON_FEET.replace('iterations="4"', ""),
    "hopper, elliptic cones": ON_FEET.replace("pyramidal", "elliptic"),
    "hopper, a floor that MJX refuses": HOPPER.replace(
        'type="plane" size="3 3 0.1"', 'type="cylinder" size="3 0.1" pos="0 0 -0.1"'
    ),
    "quadruped": QUADRUPED / "quadruped.xml",
    "quadruped, hung": QUADRUPED / "quadruped_hung.xml",
    "quadruped with an arm": QUADRUPED / "quadruped_arm.xml",
}
KEYFRAMES = {"quadruped": "stand", "quadruped, hung": "hang", "quadruped with an arm": "stand"}


@pytest.fixture(autouse=True)
def one_core(monkeypatch):
    """As many as the tests have devices at least."""
    monkeypatch.setattr(mujoco, "cores", lambda: 1)


def _chosen(name, seconds, folder, **options):
    """Engine of a sweep of 100 loops that are simulated for so long in all."""
    model = MODELS[name]
    if isinstance(model, str):
        path = folder / "model.xml"
        path.write_text(model)
        model = path
    lines = [f"{key} = {value!r}" for key, value in options.items()]
    keyframe = f"keyframe = {KEYFRAMES[name]!r}" if name in KEYFRAMES else ""
    text = "\n".join([
        'engine = "auto"', f"duration = {seconds / 100}", "physics_step = 0.001", *lines,
        "[plant]", f"model = '{model}'", keyframe,
        "[parameters]", "kp = 400", "kd = 20", "setpoint = 0.01", "initial_velocity = 0.01",
        "[axes]", "gain_scale = {min = 0.5, max = 1.0, num = 100}",
    ])  # fmt: skip
    asked = reading.parse(text, folder)
    return throughput.fastest(asked, expand(asked), say=None)


@pytest.mark.parametrize("name", ["two hinges", "two hinges with limits", "hopper", "quadruped"])
def test_it_is_c_mujoco_in_a_short_sweep_and_mjx_in_a_long_one(name, tmp_path):
    assert _chosen(name, 200.0, tmp_path) == "mujoco"
    found = _chosen(name, 20e3, tmp_path)
    # Robots with contacts or limits are computed side by side from JAX 0.11 on only.
    assert found == ("mujoco" if engines.old_jax() and name != "two hinges" else "mjx")


def test_the_lighter_a_robot_the_shorter_a_sweep_of_it_in_mjx(tmp_path):
    assert _chosen("two hinges", 2e3, tmp_path) == "mjx"
    assert _chosen("quadruped", 2e3, tmp_path) == "mujoco"


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("quadruped, hung", {}),
        ("quadruped with an arm", {}),
        ("hopper on a box", {}),
        ("hopper, its solver not ended early", {}),
        ("hopper, elliptic cones", {}),
        ("hopper, a floor that MJX refuses", {}),
        ("hopper", {"precision": "float64"}),
    ],
)
def test_it_stays_c_mujoco_where_mjx_computes_more_or_by_itself(name, options, tmp_path):
    assert _chosen(name, 1e6, tmp_path, **options) == "mujoco"


@pytest.mark.skipif(engines.old_jax(), reason="MJX is never taken for it")
def test_it_stays_c_mujoco_for_a_robot_with_too_many_constraints(monkeypatch, tmp_path):
    assert _chosen("hopper", 1e6, tmp_path) == "mjx"
    monkeypatch.setattr(side_by_side, "_PRODUCT", 100)  # of 112 that it has
    assert _chosen("hopper", 1e6, tmp_path) == "mujoco"


@pytest.mark.parametrize(
    ("name", "long"),
    [
        ("two hinges", "mjx"),
        ("hopper", "mjx"),
        ("hopper on a box", "mujoco"),  # as MJX simulates it otherwise
        ("hopper, a floor that MJX refuses", "mujoco"),
    ],
)
def test_on_a_gpu_it_is_c_mujoco_until_compiling_pays(name, long, monkeypatch, tmp_path):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(warp, "lacking", lambda: "not installed")
    assert _chosen(name, 2e3, tmp_path) == "mujoco", "two million steps on one core"
    assert _chosen(name, 20e3, tmp_path) == long


def test_it_stays_c_mujoco_where_mjx_would_use_fewer_cores(monkeypatch, tmp_path):
    monkeypatch.setattr(mujoco, "cores", lambda: 1000)
    assert _chosen("quadruped", 1e6, tmp_path) == "mujoco"
    assert _chosen("two hinges", 1e6, tmp_path) == "mjx", "nearly as light as on all of them"
