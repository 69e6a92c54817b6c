"""Robots without meshes: what is drawn in their place, and that it is said."""

import mujoco
import numpy as np
import pytest
from PIL import Image

from jaxact.cli.main import main
from jaxact.errors import UserError
from jaxact.plotting import scene
from jaxact.plotting.split_screen import Side, side_by_side
from jaxact.plotting.stand_ins import add, half_edges, stand_ins
from jaxact.robots.model import read

# Two links whose shapes are meshes that are not there, a frame without mass, and a loose ball.
ROBOT = """
<mujoco>
  <asset><mesh name="trunk" file="trunk.stl"/><mesh name="leg" file="leg.stl"/></asset>
  <worldbody>
    <light pos="0 0 3"/>
    <geom type="plane" size="0 0 1" rgba="0.9 0.9 0.9 1"/>
    <body name="trunk" pos="0 0 0.6">
      <inertial pos="0 0 0.1" mass="4" diaginertia="0.05 0.08 0.06"/>
      <joint name="hip" axis="0 1 0"/>
      <geom type="mesh" mesh="trunk" contype="0" conaffinity="0"/>
      <body name="frame"/>
      <body name="leg" pos="0.1 0 -0.2">
        <inertial pos="0 0 -0.1" mass="1" diaginertia="0.006 0.006 0.001"/>
        <joint name="knee" axis="0 1 0"/>
        <geom type="mesh" mesh="leg" contype="0" conaffinity="0"/>
        <geom type="sphere" size="0.02" group="3" contype="0" conaffinity="0"/>
      </body>
    </body>
    <body name="ball" pos="0.2 0.3 0.1"><freejoint/><geom size="0.05"/></body>
  </worldbody>
  <actuator><motor joint="hip"/><motor joint="knee"/></actuator>
</mujoco>
"""


@pytest.fixture
def path(tmp_path):
    (tmp_path / "robot.xml").write_text(ROBOT)
    return tmp_path / "robot.xml"


def test_the_box_of_an_inertia_is_the_one_mujoco_computes_it_from():
    sizes = np.array([0.3, 0.1, 0.05])
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><body><freejoint/><geom type="box" size="{sizes[0]} {sizes[1]} '
        f'{sizes[2]}"/></body></worldbody></mujoco>'
    )
    found = half_edges(model.body_mass[1], model.body_inertia[1])
    np.testing.assert_allclose(np.sort(found), np.sort(sizes), rtol=1e-9)
    assert half_edges(1.0, np.array([1.0, 0.1, 0.1])).min() == 0.0, "of no rigid body"


def test_links_without_a_shape_get_boxes_and_others_do_not(path):
    model = read(path).model
    own = stand_ins(model)
    names = [model.body(int(body)).name for body in own.bodies]
    assert names == ["trunk", "leg"] and own.links == 3
    assert [tuple(pair) for pair in own.joined] == [(1, model.body("leg").id)]
    assert (own.sizes > 0.0).all()


def test_boxes_are_where_the_links_are(path):
    model = read(path).model
    data = mujoco.MjData(model)
    data.qpos[0] = 0.7
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    drawn = mujoco.MjvScene(model, maxgeom=10)
    own = stand_ins(model)
    add(drawn, model, data, own)
    assert drawn.ngeom == 3  # two boxes and a bar between their joints
    for geom, body, size in zip(drawn.geoms[:2], own.bodies, own.sizes, strict=True):
        np.testing.assert_allclose(geom.pos, data.xipos[body], atol=1e-6)
        np.testing.assert_allclose(geom.size, size, rtol=1e-6)
        assert geom.type == mujoco.mjtGeom.mjGEOM_BOX
    np.testing.assert_allclose(drawn.geoms[2].pos, data.xpos[own.joined[0]].mean(axis=0), atol=1e-6)
    full = mujoco.MjvScene(model, maxgeom=1)
    add(full, model, data, own)
    assert full.ngeom == 1, "a full scene takes no more"


def test_a_model_with_shapes_is_left_alone():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint/><geom size="0.1"/></body></worldbody></mujoco>'
    )
    assert len(stand_ins(model).bodies) == 0


def test_a_caption_has_room_of_its_own_and_fits():
    images = [np.full((160, 320, 3), 200, np.uint8)]

    def shape(caption):
        sides = (Side(images, "", np.zeros(1)), Side(images, "", np.zeros(1)))
        return next(side_by_side(*sides, times=[0.0], speed=1.0, caption=caption))

    plain, said = shape(""), shape("all links drawn as the boxes that have their inertia " * 2)
    assert said.shape[0] > plain.shape[0] and said.shape[1] == plain.shape[1]
    below = said[plain.shape[0] :]
    assert (below < 200).any() and (below[:, :2] > 200).all() and (below[:, -2:] > 200).all()


def test_joints_that_stand_still_draw_a_flat_line():
    images = [np.full((90, 120, 3), 255, np.uint8)] * 4
    dust = np.array([0.0, 4e-7, 4e-7, 3e-7])
    left, right = Side(images, "", dust), Side(images, "", dust)
    last = list(side_by_side(left, right, times=range(4), speed=1.0))[-1]
    strip = last[90:].astype(int)
    blue = np.argwhere((strip[:, :, 2] - strip[:, :, 0] > 100) & (strip.sum(2) < 500))
    assert np.ptp(blue[:, 0]) <= 3


def test_a_film_of_a_robot_without_meshes_shows_it_and_says_so(path, monkeypatch, capsys):
    try:
        scene.backend()
    except UserError as error:
        pytest.skip(str(error))
    monkeypatch.chdir(path.parent)
    time = np.linspace(0.0, 0.1, 11)
    qpos = np.tile(mujoco.MjModel.from_xml_string(_without_meshes()).qpos0, (11, 1))
    np.savez("still.npz", time=time, qpos=qpos)
    files = "--model robot.xml --bare still.npz --drive still.npz --size 96 96 --out film.gif"
    assert main(["render", *files.split()]) == 0
    said = capsys.readouterr()
    assert said.out == "wrote film.gif\n"
    assert said.err == (
        "jaxact: warning: 2 of 3 links drawn as the boxes that have their inertia (files are "
        "missing: trunk.stl and 1 more)\n"
    )
    with Image.open("film.gif") as film:
        seen = np.asarray(film.convert("RGB")).astype(int)[10:100, :96]
    blue = seen[:, :, 2] - seen[:, :, 0] > 30
    assert blue.mean() > 0.01, "the robot is seen"


def _without_meshes():
    lines = ROBOT.splitlines()
    return "\n".join(line for line in lines if "mesh" not in line)
