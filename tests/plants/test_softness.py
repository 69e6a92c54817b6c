"""A model whose inertias are changed is the model that MuJoCo compiles with those inertias."""

import copy
import dataclasses
from typing import Any

import jax
import mujoco
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.plants import softness

WALKER = """<mujoco><option timestep="0.002" gravity="0 0 {gravity}"/><worldbody>
<geom type="plane" size="5 5 .1"/>
<body name="trunk" pos="0 0 {height}"><freejoint/><geom type="box" size=".2 .1 .05" mass="4"/>
{legs}
</body>{loose}</worldbody>{tendon}<actuator>{motors}</actuator></mujoco>"""
LEG = """<body name="thigh{n}" pos="{x} {y} 0"><joint name="hip{n}" axis="0 1 0" frictionloss=".1"
range="-1.7 1.7" armature="{armature}"/>
<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.18" mass="{thigh}" contype="0" conaffinity="0"/>
<body name="foot{n}" pos="0 0 -.36">
<geom type="capsule" size=".02" fromto="0 0 .18 0 0 0" mass="{shank}"/></body></body>"""
LOOSE = """<body pos="1 0 1"><joint type="ball" armature=".01"/>
<geom type="box" size=".1 .05 .02" mass=".7"/></body>
<body pos="2 0 1"><joint name="s" type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
<geom size=".05" mass=".4"/></body>"""
TENDON = """<tendon><fixed><joint joint="hip0" coef="1"/><joint joint="hip1" coef="-.5"/></fixed>
<fixed><joint joint="s" coef="2"/></fixed></tendon>"""


def walker(scale=1.0, armature=0.0, gravity=-9.81, *, whole=False):
    """Legs `scale` times as heavy, feet included, which have no joints of their own."""
    places = [(x, y) for x in (-0.2, 0.2) for y in (-0.1, 0.1)]
    values = {"thigh": 0.5 * scale, "shank": 0.2 * scale, "armature": armature}
    legs = "".join(LEG.format(n=n, x=x, y=y, **values) for n, (x, y) in enumerate(places))
    motors = "".join(f'<position joint="hip{n}" kp="80" kv="3"/>' for n in range(4))
    loose, tendon = (LOOSE, TENDON) if whole else ("", "")
    return WALKER.format(
        height=0.36 if gravity else 1.0,
        legs=legs,
        motors=motors,
        loose=loose,
        tendon=tendon,
        gravity=gravity,
    )


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Inertias:
    """What is read of a model, as arrays."""

    body_mass: Any
    body_inertia: Any
    dof_armature: Any
    body_invweight0: Any
    dof_invweight0: Any
    tendon_invweight0: Any

    @classmethod
    def of(cls, model):
        return cls(**{item.name: getattr(model, item.name) for item in dataclasses.fields(cls)})


def test_inverse_inertias_are_those_of_a_compiled_model():
    """Bodies, degrees of freedom and tendons: free, ball, hinge and sliding joints, armature."""
    spec = mujoco.MjSpec.from_string(walker(whole=True))
    model, generator = spec.compile(), np.random.default_rng(4)
    factors, armature = (
        generator.uniform(0.5, 3.0, model.nbody),
        generator.uniform(0, 0.1, model.njnt),
    )
    for body in spec.bodies[1:]:
        body.explicitinertial = True
        body.mass = model.body_mass[body.id] * factors[body.id]
        body.inertia = model.body_inertia[body.id] * factors[body.id]
        body.ipos, body.iquat = model.body_ipos[body.id], model.body_iquat[body.id]
    for joint in spec.joints:
        joint.armature = model.dof_armature[model.jnt_dofadr[joint.id]] + armature[joint.id]
    fresh = spec.compile()
    changed = copy.copy(model)
    fields = {name: getattr(fresh, name) for name in softness.DEPENDS}
    for name, value in fields.items():
        getattr(changed, name)[:] = value
    with jax.enable_x64(True):
        found = jax.jit(softness.of(model).changed)(Inertias.of(model), fields)
    in_c = softness.compiled(model, changed)
    for name in softness.FIELDS:
        expected = getattr(fresh, name)
        assert np.abs(expected - getattr(model, name)).max() > 0.1
        np.testing.assert_allclose(found[name], expected, rtol=1e-9, err_msg=name)
        np.testing.assert_allclose(in_c[name], expected, rtol=1e-9, err_msg=name)
    np.testing.assert_allclose(in_c["dof_M0"], fresh.dof_M0)


def _both(tmp_path, told, has):
    """The robot that is told to be heavier, and the one that is."""
    loops = []
    for name, text, given in (("told", walker(gravity=has.get("gravity", -9.81)), told),
                              ("has", walker(**has), {})):  # fmt: skip
        path = tmp_path / f"{name}.xml"
        path.write_text(text)
        loops.append(jx.robot(path, delay=2e-3, **given))
    return loops


@pytest.mark.exhaustive
def test_armature_makes_contacts_as_soft_as_those_of_a_model_that_has_it(tmp_path):
    one, other = map(jx.margins, _both(tmp_path, {"joint_armature": 0.3}, {"armature": 0.3}))
    for name in ("growth_rate", "gain_margin", "delay_margin"):
        found, expected = (float(getattr(each, name)) for each in (one, other))
        assert found == pytest.approx(expected, rel=1e-4)


@pytest.mark.exhaustive
@pytest.mark.parametrize("engine", ["mujoco", "mjx"])
@pytest.mark.filterwarnings("ignore::jaxact.InexactWarning")
def test_heavier_legs_move_as_those_of_a_model_that_has_them(tmp_path, engine):
    """Feet without joints of their own included, against limits and dry friction."""
    weightless = {"gravity": 0.0}
    one, other = (
        jx.simulate(
            loop, setpoint=0.05, duration=0.2, engine=engine, precision="float64"
        ).position.values
        for loop in _both(tmp_path, {"inertia_scale": 3.0}, {"scale": 3.0, **weightless})
    )
    assert other.max() > 0.028
    np.testing.assert_allclose(one, other, atol=1e-7)
