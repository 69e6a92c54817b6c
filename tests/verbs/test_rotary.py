"""Rotary joints: whatever is written of one says N m, rad and kg m^2."""

import json
import re

import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.cli.main import main
from jaxact.errors import UserError
from jaxact.loops import reading
from jaxact.units import turned

MOTOR = {"kp": 80.0, "kd": 1.0, "actuator": "hyq"}
# Units of a joint that slides, as words of their own.
_SLIDES = re.compile(r"(?<![\w/^])(N/m|N s/m|kg(?! m\^2)|N(?! m)|m/s|m)(?![\w/^])")


def _said(text):
    """The units of a slide that a text names in brackets or behind numbers."""
    words = re.findall(r"\[([^\]]*)\]|\d ([^\d\s,;\[\]]+(?: s?/?m?(?:/rad)?)?)", text)
    return [word for pair in words for word in pair if word and _SLIDES.fullmatch(word)]


@pytest.mark.parametrize(
    ("slide", "hinge"),
    [("N", "N m"), ("N/m", "N m/rad"), ("N s/m", "N m s/rad"), ("kg", "kg m^2"), ("m", "rad"),
     ("m/s", "rad/s"), ("m/s^0.5", "rad/s^0.5"), ("N/s", "N m/s"), ("N^2 s", "(N m)^2 s"),
     ("m^2 s", "rad^2 s"), ("s", "s"), ("Hz", "Hz"), ("rad/s", "rad/s"), ("1", "1")],
)  # fmt: skip
def test_units_of_a_rotary_joint(slide, hinge):
    assert turned(slide) == hinge


def test_an_inertia_or_the_unit_says_that_a_joint_is_rotary():
    one, other = jx.joint(inertia=0.02, **MOTOR), jx.joint(mass=0.02, unit="rad", **MOTOR)
    assert one == other and one.kind.unit == "rad" and one.mass == one.inertia == 0.02
    assert "inertia 0.02 kg m^2" in repr(one) and "kp 80 N m/rad" in repr(one)
    assert jx.joint(mass=0.02).replace(inertia=0.03).kind.unit == "rad"
    assert one.replace(kp=90).kind.unit == "rad"
    np.testing.assert_array_equal(
        jx.margins(one).delay_margin, jx.margins(jx.joint(mass=0.02, **MOTOR)).delay_margin
    )


@pytest.mark.parametrize(
    ("given", "said"),
    [({"inertia": 1.0, "mass": 1.0}, "give one of the two"), ({"unit": "deg"}, "`unit` = 'deg'"),
     ({"inertia": 1.0, "unit": "m"}, "is that of a rotary joint")],
)  # fmt: skip
def test_what_contradicts_itself_is_refused(given, said):
    with pytest.raises(UserError, match=said):
        jx.joint(**given)


@pytest.mark.parametrize(
    "text",
    ['unit = "rad"\n[parameters]\nmass = 0.02\n[axes]\nkp = [1, 2]',
     "[parameters]\ninertia = 0.02\n[axes]\nkp = [1, 2]"],
)  # fmt: skip
def test_specifications_say_it_too_and_read_back(text):
    found = reading.parse(text)
    assert found.unit == "rad" and found.parameters["mass"] == 0.02
    assert reading.parse(found.text) == found
    assert "unit" not in reading.parse("[axes]\nkp = [1, 2]").document
    with pytest.raises(UserError, match="rotary"):
        reading.parse('unit = "m"\n[parameters]\ninertia = 1.0\n[axes]\nkp = [1, 2]')


@pytest.mark.exhaustive
def test_datasets_have_its_units():
    loop = jx.joint(inertia=0.02, **MOTOR)
    run = jx.simulate(loop, setpoint=0.1, duration=0.05)
    maps = jx.sweep(loop, kp=[50.0, 80.0], joint_stiffness=[-5.0, 5.0], duration=0.02)
    units = {name: run[name].attrs["units"] for name in ("position", "velocity", "force")}
    assert units == {"position": "rad", "velocity": "rad/s", "force": "N m"}
    assert maps.kp.attrs["units"] == maps.joint_stiffness.attrs["units"] == "N m/rad"
    for found in (run, maps):
        for variable in (*found.data_vars.values(), *found.coords.values()):
            assert not _SLIDES.fullmatch(variable.attrs.get("units", "1")), variable.name
    assert maps.peak_force.attrs["units"] == "N m"
    axes = jx.plot.boundary(loop)
    assert axes.get_xlabel() == "kp [N m/rad]" and axes.get_ylabel() == "kd [N m s/rad]"


def _run(capsys, *arguments):
    code = main(list(arguments))
    out = capsys.readouterr().out
    assert not code
    return out


@pytest.mark.exhaustive
def test_the_command_line_says_its_units(capsys, tmp_path):
    motor = ("--inertia", "0.02", "--kp", "80", "--kd", "1", "--actuator", "hyq")
    table = _run(capsys, "simulate", *motor, "--duration", "0.05", "--csv", f"{tmp_path}/run.csv",
                 "--out", f"{tmp_path}/run.svg")  # fmt: skip
    assert "N m" in table and not _said(table)
    header = (tmp_path / "run.csv").read_text().splitlines()[0]
    assert "position [rad]" in header and "force [N m]" in header and not _said(header)
    picture = (tmp_path / "run.svg").read_text()
    assert "kp 80 N m/rad" in picture and "inertia 0.02 kg m^2" in picture
    row = json.loads(_run(capsys, "margins", *motor, "--json").splitlines()[0])
    assert row["loop"]["inertia"] == 0.02 and row["loop"]["unit"] == "rad"
    assert "mass" not in row["loop"]
    several = _run(capsys, "margins", "--unit", "rad", "--mass", "0.02", "0.03", "--kp", "80")
    assert "mass 0.02 kg m^2" in several
    document = json.loads(
        _run(capsys, "tune", *motor, "--delay", "1e-3", "--max-peak", "1.6", "--json")
    )
    assert document["units"] == ["N m/rad", "N m s/rad"]
