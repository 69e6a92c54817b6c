"""Drives exported for mjlab and Isaac Lab, run with torch, against the same drives in JAX."""

import ast
import json
import math
import os
import subprocess
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import jaxact
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.errors import UserError
from jaxact.gains import reading

ROOT = Path(__file__).resolve().parents[2]
PYTHON = ROOT / ".torch" / "bin" / "python"
STUBS = Path(__file__).parent / "torch_stubs"
FRAMEWORKS = ("mjlab", "isaaclab")
KEYS = ("position", "velocity", "setpoint", "setpoint_velocity", "effort")
JOINTS = ("hip", "thigh", "knee", "foot")
ENVIRONMENTS, STEPS = 3, 1000
RESETS = {300: [1], 640: [0, 2]}
needs_torch = pytest.mark.skipif(
    not PYTHON.exists(), reason="needs .torch, which `make test` builds where torch can be had"
)
MODEL = "".join(
    f'<body pos="{i} 0 0"><joint name="{name}"/><geom size="0.1"/></body>'
    for i, name in enumerate(JOINTS)
)
MODEL = (
    f"<mujoco><worldbody>{MODEL}</worldbody><actuator>"
    + "".join(f'<motor joint="{name}"/>' for name in JOINTS)
    + "</actuator></mujoco>"
)
WN = (math.inf, 800.0, 110.0, 60.0)  # ideal, HyQ, StarlETH, and one that is overdamped
ZETA = (1.0, 0.45, 0.9, 2.5)
# By case: physics steps in a control period, parameters of all joints, and the kind of velocity.
CASES = {
    "delays": (4, {
        "wn": WN, "zeta": ZETA, "delay": (0.0, 0.0037, 0.008, 0.0012), "output_delay": 0.0009,
        "measurement_delay": (0.0017, 0.0, 0.004, 0.0051), "setpoint_delay": 0.0066,
        "feedforward": 0.5,
    }, "sampled"),
    "limits": (1, {
        "wn": WN, "zeta": (1.0, 0.45, 1.0, 2.5), "delay": 0.0023, "position_resolution": 1e-3,
        "command_resolution": 0.25, "force_limit": (9.0, 12.0, math.inf, 9.0),
        "force_rate_limit": (math.inf, 900.0, 900.0, math.inf), "stall_force": 14.0,
        "no_load_speed": 9.0, "velocity_filter": 300.0, "position_bias": 0.0101,
    }, "differenced"),
    "counts": (2, {
        "wn": WN[::-1], "zeta": ZETA[::-1], "measurement_delay": 0.0031, "velocity_bias": 0.03,
        "velocity_resolution": 0.02, "position_resolution": (0.0, 1e-3, 2e-3, 1e-2),
    }, "sampled"),
    "ranges": (2, {
        "wn": 300.0, "zeta": 0.7, "delay": (0.0, 0.009), "measurement_delay": (0.001, 0.006),
        "setpoint_delay": (0.0, 0.01), "gain_scale": (0.5, 1.5),
    }, "sampled"),
}  # fmt: skip
RANGES = CASES["ranges"][1]
CONTROL_RATE = 500.0
KP, KD = (32.0, 24.0, 40.0, 16.0), (0.5, 0.75, 1.0, 0.25)


def motions():
    """Joint motions that no drive moves, and setpoints; shape (steps, environments, joints)."""
    rng = np.random.default_rng(4)
    time = np.arange(STEPS)[:, None, None, None] * 1e-3
    shape = (1, ENVIRONMENTS, len(JOINTS), 5)
    rate, phase = rng.uniform(3, 120, shape), rng.uniform(0, 6, shape)
    size = rng.uniform(0, 1, shape) / rate
    position = (size * np.sin(rate * time + phase)).sum(-1)
    velocity = (size * rate * np.cos(rate * time + phase)).sum(-1)
    held = np.repeat(rng.normal(0, 0.3, (3, STEPS // 20, ENVIRONMENTS, len(JOINTS))), 20, axis=1)
    return dict(zip(KEYS, (position, velocity, *held), strict=True))


def in_jax(case, drawn):
    """Forces of the same drives, stepped by `jaxact.drive_around`, begun anew at each reset."""
    substeps, parameters, velocity = CASES[case]
    signals = {name: jnp.asarray(value.reshape(STEPS, -1)) for name, value in motions().items()}
    joints = signals["position"].shape[1]

    def spread(value):
        return jnp.asarray(np.broadcast_to(value, (ENVIRONMENTS, len(JOINTS))).ravel())

    # ranges are replaced by what torch drew
    named = {name: spread(v) for name, v in parameters.items() if not drawn or name not in drawn[0]}
    longest = {name: spread(np.max(parameters[name])) for name in drawn[0]}
    step = 1 / (CONTROL_RATE * substeps)
    given = {"kp": spread(KP), "kd": spread(KD), "control_rate": CONTROL_RATE, "unit": "rad",
             "velocity": velocity, **named}  # fmt: skip
    static = jx.joint(**given, **longest)

    def advance(state, force):
        index, forces = state
        return index + 1, forces.at[index].set(force)

    def measure(state):
        index = jnp.minimum(state[0], STEPS - 1)
        return signals["position"][index], signals["velocity"][index]

    def run(start, values):
        drive = jx.drive_around(advance, jx.joint(**given, **values), measure=measure,
                                physics_step=step, joints=joints, longest=static)  # fmt: skip

        def target(index):
            rows = (signals[key][jnp.minimum(index, STEPS - 1)] for key in KEYS[2:])
            return jx.Setpoint(*rows)

        state = start, jnp.zeros((STEPS, joints))
        first, (position, rate) = target(start), measure(state)
        controller = drive.prepared.drive.drive.controller
        command = controller.kp * (first.position - position)
        command += controller.kd * (first.velocity - rate) + first.force + controller.feedforward

        def period(state, _):
            return drive.step(state, target(state.simulator[0]))[0], None

        begun = drive.init(state, command=command, setpoint=first)
        return jax.lax.scan(period, begun, None, length=STEPS // substeps)[0].simulator[1]

    run = jax.jit(run)
    found = np.zeros((STEPS, ENVIRONMENTS, len(JOINTS)))
    for start, values in zip((0, *RESETS), drawn, strict=True):
        which = RESETS.get(start, range(ENVIRONMENTS))
        own = {name: spread(value) for name, value in values.items()}
        forces = np.asarray(run(jnp.asarray(start), own)).reshape(found.shape)
        found[start:, which] = forces[start:, which]
    return found


def exported(case, framework, folder):
    """Write the file of a case as a user does; its path."""
    _, parameters, velocity = CASES[case]
    model, file = folder / "legs.xml", folder / f"{case}_{framework}.py"
    model.write_text(MODEL)
    each = {n: v for n, v in parameters.items() if isinstance(v, tuple) and case != "ranges"}
    tables = {n: dict(zip(JOINTS, v, strict=True)) for n, v in each.items()}
    loop = jx.robot(model, velocity=velocity, control_rate=CONTROL_RATE, posture="keyframe",
                    kp=dict(zip(JOINTS, KP, strict=True)),
                    kd=dict(zip(JOINTS, KD, strict=True)))  # fmt: skip
    jx.export(loop, framework, file, parameters={**parameters, **tables})
    return file


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    """What torch gives in every case and framework, from one process."""
    folder = tmp_path_factory.mktemp("torch")
    np.savez(folder / "motions.npz", **motions())
    files = []
    for case, (substeps, _, _) in CASES.items():
        for framework in FRAMEWORKS:
            file = exported(case, framework, folder)
            files.append(folder / f"{case}_{framework}.json")
            files[-1].write_text(json.dumps({
                "file": str(file), "framework": framework, "names": JOINTS, "dtype": "float64",
                "physics_step": 1 / (CONTROL_RATE * substeps), "resets": list(RESETS.items()),
                "motions": str(folder / "motions.npz"), "out": f"{files[-1]}.npz",
                "shared": [*RANGES] if case == "ranges" else [],
            }))  # fmt: skip
    ran = subprocess.run(
        [PYTHON, STUBS / "replay.py", *files], capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": str(STUBS), "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    return {file.stem: dict(np.load(f"{file}.npz")) for file in files}


@needs_torch
@pytest.mark.parametrize("case", CASES)
def test_torques_in_torch_are_those_in_jax(replayed, case):
    """Over 1,000 steps with partial resets: delays, presets, limits, quantisation, ranges."""
    found = [replayed[f"{case}_{framework}"] for framework in FRAMEWORKS]
    ranged = [n for n in RANGES if np.ptp(found[0][f"0:{n}"]) > 0] if case == "ranges" else []
    drawn = [{n: found[0][f"{step}:{n}"] for n in ranged} for step in (0, *RESETS)]
    with jax.enable_x64(True), jax.numpy_rank_promotion("allow"):
        expected = in_jax(case, drawn)
    assert np.abs(expected).max() > 5.0 and (np.abs(np.diff(expected, axis=0)) > 0).any()
    for one in found:
        np.testing.assert_allclose(one["force"], expected, atol=1e-5 * np.abs(expected).max())
    assert len(ranged) == (4 if case == "ranges" else 0)


@needs_torch
def test_ranges_are_drawn_anew_at_a_reset_and_shared_by_all_joints(replayed):
    for framework in FRAMEWORKS:
        one = replayed[f"ranges_{framework}"]
        assert one["shared"]
        for name in ("delay", "measurement_delay", "setpoint_delay", "gain_scale"):
            first, second, third = (one[f"{step}:{name}"].ravel() for step in (0, *RESETS))
            low, high = RANGES[name]
            assert len({*first}) == 3 and (low <= first).all() and (first <= high).all()
            assert ((first != second) == [False, True, False]).all()
            assert ((second != third) == [True, False, True]).all()


@pytest.mark.parametrize("framework", FRAMEWORKS)
def test_a_file_is_self_contained_and_its_gains_are_read_back(tmp_path, framework):
    file = exported("limits", framework, tmp_path)
    tree = ast.parse(file.read_text())
    imported = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not [name for name in imported if "jaxact" in name]
    again = jx.export(jx.robot(tmp_path / "legs.xml", gains=file), "toml").joints
    assert (again.kp, again.kd) == (KP, KD)
    assert again.force_limit == (9.0, 12.0, math.inf, 9.0)
    # Its drive is not, which is said.
    assert any("its drive (delays" in note for note in reading.read(file).notes)
    lost = jx.export(file, "mjlab", model=tmp_path / "legs.xml").lost
    assert any("its drive (delays" in one for one in lost)


def test_gains_alone_stay_a_configuration(tmp_path):
    (tmp_path / "legs.xml").write_text(MODEL)
    plain = jx.export(tmp_path / "legs.xml", "mjlab", parameters={"kp": 3.0, "kd": 0.5})
    assert "IdealPdActuatorCfg(" in plain.text and "torch" not in plain.text


def test_the_command_line_exports_drives(tmp_path):
    (tmp_path / "joint.toml").write_text(
        "[axes]\nkp = [30]\n[parameters]\nkd = 1\nactuator = 'starleth'\njoint_damping = 0.2\n"
    )
    done = jaxact("export", "joint.toml", "--to", "isaaclab", "--set", "delay=0.002..0.008",
                  "--out", "drive.py", cwd=tmp_path)  # fmt: skip
    assert "drives of" in done.stdout and "joint_damping 0.2" in done.stderr
    text = (tmp_path / "drive.py").read_text()
    assert "joint_names_expr=['.*']" in text and "joint_damping 0.2" in text
    assert all(row in text for row in ("wn=110.0,\n", "zeta=0.9,\n", "delay=(0.002, 0.008),\n"))
    for words, said in (
        (("--set", "delay=0.1..0.0"), "ends below"),
        (("--set", "mass=3"), "not a parameter of a drive"),
        (("--set", "kp=1..2"), "gain_scale"),
        (("--set", "delay"), "key=value"),
        (("--to", "deploy-yaml"), "--model"),
    ):
        ran = jaxact("export", "joint.toml", "--to", "mjlab", *words, cwd=tmp_path)
        assert ran.returncode == 2 and said in ran.stderr and ran.stderr.count("\n") == 1


def test_what_is_for_files_is_refused_beside_a_loop(tmp_path):
    (tmp_path / "legs.xml").write_text(MODEL)
    loop = jx.robot(tmp_path / "legs.xml", kp=KP[0], kd=KD[0])
    for options in ({"model": tmp_path / "legs.xml"}, {"joints": "hip"}, {"keyfram": "home"}):
        with pytest.raises(UserError, match=f"`{next(iter(options))}`: is for a file, and this is"):
            jx.export(loop, "toml", **options)
    (lost,) = jx.export(loop.replace(policy_rate=50.0), "mjlab").lost
    assert lost.endswith("holds an action: policy_rate 50 Hz")
    with pytest.raises(UserError, match="`velocity_filter`: filters differenced positions"):
        jx.export(loop, "mjlab", parameters={"velocity_filter": 100.0})
    with pytest.raises(UserError, match="`parameters`: a value of type int; give a table"):
        jx.export(loop, "mjlab", parameters=3)


def test_an_identified_drive_is_exported_with_gains_that_it_has_not(tmp_path):
    """Of a torque loop neither gains nor a joint are known."""
    file = tmp_path / "drive.toml"
    file.write_text(
        'plant = "none"\nunit = "rad"\nestimates = {}\n'
        "loop = [{wn = 200.0, zeta = 0.5, delay = 0.003, gain_scale = 0.5}]\n"
    )
    with pytest.raises(UserError, match="`kp` and `kd`: not in the source"):
        jx.export(file, "mjlab")
    text = jx.export(file, "mjlab", parameters={"kp": 30.0, "kd": 1.0}).text
    # the drive gives half of its command
    assert "stiffness=15.0" in text and "delay=0.003,\n" in text
    (tmp_path / "legs.xml").write_text(MODEL)
    whole = jx.export(file, "isaaclab", model=tmp_path / "legs.xml", joints="knee",
                      parameters={"kp": 30.0, "kd": 1.0})  # fmt: skip
    assert "joint_names_expr=['knee']" in whole.text and whole.joints.names == ("knee",)
