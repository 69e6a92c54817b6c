"""The result store: what is in it, and that others can read it."""

import json
import math
import warnings

import numpy as np
import pytest
import synthetic_store
import xarray as xr

from jaxact.errors import UserError
from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.status import Verdict
from jaxact.sweeping import atomic_store, opening, store
from jaxact.sweeping.summary import summary
from jaxact.units import joint_units

TEXT = """
description = "three actuators"
seed = 7
[parameters]
kp = 300
[axes]
actuator = ["ideal", "hyq"]
delay = [0.0, 0.001]
kd = { min = 1, max = 100, num = 3, spacing = "log" }
"""


@pytest.fixture
def results():
    return _results(TEXT)


def _made(text):
    specification = reading.parse(text)
    samples = expand(specification)
    numbers = np.arange(len(samples), dtype=float)
    return specification, samples, {"growth_rate": -numbers, "verdict": numbers % 4}


def _results(text):
    return synthetic_store.dataset_of(*_made(text))


def _write(results, path, **options):
    with atomic_store.destination(path, **options) as folder:
        atomic_store.write(results, folder)


@pytest.mark.parametrize("loops", [1, 4, 100])
def test_plain_xarray_opens_it_without_warnings_however_it_is_cut_up(loops, tmp_path):
    specification, samples, results = _made(TEXT)
    synthetic_store.run(tmp_path, specification, samples, results, loops=loops)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        back = xr.open_zarr(tmp_path / "sweep.zarr").load()
    for name, values in results.items():
        np.testing.assert_array_equal(back[name].values.ravel(), values)
    assert back.sizes == {"actuator": 2, "delay": 2, "kd": 3}
    assert np.isnan(back["overshoot"]).all()
    assert json.loads((tmp_path / "sweep.zarr/zarr.json").read_text())["zarr_format"] == 3


def test_dimensions_coordinates_and_units(results):
    assert results.sizes == {"actuator": 2, "delay": 2, "kd": 3}
    assert list(results["actuator"].values) == ["ideal", "hyq"]
    np.testing.assert_array_equal(results["wn"], [math.inf, 800.0])
    assert results["delay"].attrs["units"] == "s"
    assert results["growth_rate"].attrs["units"] == "1/s"
    assert results["growth_rate"].dtype == np.float32
    assert results["growth_rate"].sel(actuator="hyq", delay=0.001, kd=100.0) == -11.0


def test_verdict_explains_its_codes(results):
    verdict = results["verdict"]
    assert verdict.dtype == np.int8
    meanings = verdict.attrs["flag_meanings"].split()
    named = dict(zip(verdict.attrs["flag_values"], meanings, strict=True))
    assert named == {kind.value: kind.label.replace(" ", "_") for kind in Verdict}


def test_attributes_are_enough_to_run_it_again(results):
    specification = reading.parse(TEXT)
    assert reading.parse(results.attrs["specification_toml"]) == specification
    assert json.loads(results.attrs["specification"])["axes"]["delay"] == [0.0, 0.001]
    versions = json.loads(results.attrs["versions"])
    assert {"jaxact", "python", "jax", "jaxlib", "mujoco", "mujoco-mjx", "numpy"} <= set(versions)
    assert results.attrs["seed"] == 7
    assert {"device", "command", "created", "title"} <= set(results.attrs)


def test_a_title_names_the_robot_where_nobody_described_the_sweep(tmp_path):
    (tmp_path / "arm.xml").write_text("<mujoco/>")
    plant = '[plant]\nmodel = "arm.xml"\nkeyframe = "home"\n[axes]\nkp = [1]'
    named = store.provenance(reading.parse(plant, tmp_path), "cpu")["title"]
    assert named == "sweep of arm.xml, keyframe home"
    joint = reading.parse("[axes]\nkp = [1]")
    assert store.provenance(joint, "cpu")["title"] == "sweep of a joint's closed loop"


def test_nominal_and_parameters_are_read_back(results):
    assert store.nominal(results)["kp"] == 300.0 and store.nominal(results)["wn"] == math.inf
    assert store.parameter(results, "kp") == 300.0
    assert store.parameter(results, "mass").attrs["units"] == "kg"
    assert store.parameter(results, "wn").dims == ("actuator",)


def test_double_precision_is_kept():
    assert _results('precision="float64"\n' + TEXT)["growth_rate"].dtype == np.float64


def test_sampled_results_round_trip(tmp_path):
    results = _results(
        "[axes]\nkp={min=1,max=9}\nkd={min=1,max=9}\n[sampling]\nmethod='sobol'\nsamples=8"
    )
    _write(results, tmp_path / "sweep.zarr")
    back = opening.open_result(tmp_path)
    assert back.sizes == {"sample": 8} and back["kd"].dims == ("sample",)
    xr.testing.assert_identical(back.load(), results)


def test_netcdf_has_the_same_content(results, tmp_path):
    path = tmp_path / "map.nc"
    opening.to_netcdf(results, path)
    back = xr.open_dataset(path, engine="h5netcdf").load()
    xr.testing.assert_equal(back, results)
    assert back.attrs["specification"] == results.attrs["specification"]
    assert back["delay"].attrs["units"] == "s"
    assert back["verdict"].attrs["flag_meanings"] == results["verdict"].attrs["flag_meanings"]
    back.close()
    with pytest.raises(UserError, match="`overwrite`"):
        opening.to_netcdf(results, path)
    opening.to_netcdf(results, path, overwrite=True)
    with pytest.raises(UserError, match="does not exist"):
        opening.to_netcdf(results, tmp_path / "absent" / "map.nc")
    assert sorted(item.name for item in tmp_path.iterdir()) == ["map.nc"]


def test_an_existing_store_is_replaced_only_when_asked(results, tmp_path):
    path = tmp_path / "out" / "sweep.zarr"
    _write(results, path)
    with pytest.raises(UserError, match="`overwrite`"):
        _write(results, path)
    _write(results.isel(kd=[0]), path, overwrite=True)
    assert opening.open_result(tmp_path / "out").sizes["kd"] == 1
    assert [item.name for item in path.parent.iterdir()] == ["sweep.zarr"]


def test_nothing_but_a_store_of_ours_is_ever_replaced(results, tmp_path):
    _write(results, tmp_path / "ours")
    folder, file, link = (tmp_path / name for name in ("folder", "file", "link"))
    folder.mkdir()
    (folder / "thesis.txt").write_text("years of work")
    file.write_text("more work")
    link.symlink_to(tmp_path / "ours")
    foreign = tmp_path / "foreign.zarr"
    xr.Dataset({"a": 1}).to_zarr(foreign, zarr_format=2)
    for path in (folder, file, link, foreign):
        with pytest.raises(UserError, match="stays"):
            _write(results, path, overwrite=True)
    assert (folder / "thesis.txt").read_text() == "years of work"
    assert opening.open_result(tmp_path / "ours").sizes["kd"] == 3


def test_failure_leaves_nothing_behind_and_the_old_store_whole(results, tmp_path):
    path = tmp_path / "deep" / "er" / "sweep.zarr"
    with pytest.raises(KeyboardInterrupt), atomic_store.destination(path) as folder:
        (folder / "half").write_text("half")
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []
    _write(results, path)
    with pytest.raises(ZeroDivisionError), atomic_store.destination(path, overwrite=True) as folder:
        atomic_store.write(results.isel(kd=[0]), folder)
        raise ZeroDivisionError
    assert opening.open_result(path).sizes["kd"] == 3
    assert [item.name for item in path.parent.iterdir()] == ["sweep.zarr"]


def test_a_place_that_cannot_be_written_is_refused_before_the_work(tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file" / "sweep.zarr", tmp_path / ("x" * 300) / "sweep.zarr"):
        with pytest.raises(UserError, match="cannot be written"), atomic_store.destination(path):
            raise AssertionError("the work must not begin")
    assert [item.name for item in tmp_path.iterdir()] == ["file"]


def test_a_full_disk_is_one_line_and_leaves_nothing(results, tmp_path):
    with (
        pytest.raises(UserError, match="No space left"),
        atomic_store.destination(tmp_path / "s") as out,
    ):
        assert out.is_dir()
        raise OSError(28, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_result_is_refused(results, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("")
    for name in ("absent", "empty", "file"):
        with pytest.raises(UserError, match=name):
            opening.open_result(tmp_path / name)
    _write(results, tmp_path / "sweep.zarr")
    (tmp_path / "sweep.zarr" / "zarr.json").write_text("{")
    with pytest.raises(UserError, match="not a result"):
        opening.open_result(tmp_path)


def test_summary_counts_verdicts_and_the_stable_share_of_every_case(results):
    lines = summary(results).splitlines()
    assert lines[0].startswith("12 loops: 25.0 % stable, 25.0 % limit cycle, 25.0 % unstable")
    assert lines[1].split() == "actuator = ideal, delay = 0 s 33.3 % stable".split()
    assert lines[4].split() == "actuator = hyq, delay = 0.001 s 0.0 % stable".split()
    assert len(lines) == 5


def test_summary_of_a_sample_is_its_totals():
    sampled = "[axes]\nkp={min=1,max=9}\n[sampling]\nmethod='sobol'\nsamples=8"
    assert len(summary(_results(sampled)).splitlines()) == 1


@pytest.mark.parametrize(
    ("units", "hinge"),
    [
        ("m s", "rad s"),
        ("m^2 s", "rad^2 s"),
        ("m", "rad"),
        ("N", "N m"),
        ("N^2 s", "(N m)^2 s"),
        ("rad/s", "rad/s"),
        ("1/s", "1/s"),
        ("s", "s"),
    ],
)
def test_units_are_those_of_the_joints(units, hinge):
    assert joint_units(units, [False, False]) == units
    assert joint_units(units, [True, True]) == hinge
    mixed = units if hinge == units else f"{hinge} or {units}"
    assert joint_units(units, [True, False]) == mixed
