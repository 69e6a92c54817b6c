"""Files that a command reads once."""

import robots as models

from jaxact import files
from jaxact.loops import reading, robots

TEXT = '[plant]\nmodel = "arm.xml"\n[parameters]\nkp = 60\n[axes]\nkd = [2.0]\n'


def test_a_command_reads_a_robot_once_and_a_notebook_always(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(models.PENDULUM)
    plant = reading.parse(TEXT, tmp_path).plant
    heavier = models.PENDULUM.replace('mass="1.2"', 'mass="2.4"')

    def mass():
        return robots.scene(plant).robot.model.body_mass[1]

    with files.read_once():
        first = mass()
        path.write_text(heavier)
        assert mass() == first
    assert mass() == 2.0 * first
    path.write_text(models.PENDULUM)
    assert mass() == first
