"""Sweeps of more loops than a picture has points."""

import numpy as np
from matplotlib.collections import QuadMesh
from quickly import compiled_quickly as compiled_quickly
from synthetic_store import GRID, dataset, write

from jaxact.plotting import thinning
from jaxact.sweeping import opening
from jaxact.verbs import map_pictures


def test_axes_keep_every_nth_value_and_say_so(monkeypatch):
    maps = dataset(GRID)
    assert thinning.thinned(maps) is maps and thinning.left_out(maps) == ""
    monkeypatch.setattr(thinning, "MOST", 10)
    kept = thinning.thinned(maps)
    assert kept.sizes == {"actuator": 2, "delay": 2, "kp": 6, "kd": 10}
    np.testing.assert_array_equal(kept["kp"], maps["kp"][::2])
    np.testing.assert_array_equal(kept["growth_rate"], maps["growth_rate"][:, :, ::2])
    assert thinning.left_out(maps) == "Drawn: 1 in 2 values of kp."


def test_a_picture_of_many_draws_a_part_and_counts_them_all(monkeypatch):
    maps = dataset(GRID)
    monkeypatch.setattr(thinning, "MOST", 6)
    figure, said, _ = map_pictures.page(maps, select={"delay": 0.0})
    assert said.startswith("Shown: delay 0 ms. Drawn: 1 in 2 values of kp, 1 in 2 values of kd.")
    assert "240 loops. No verdict differs" in said
    meshes = [mesh for ax in figure.axes for mesh in ax.collections if isinstance(mesh, QuadMesh)]
    # and the colour bar's
    assert {mesh.get_array().size for mesh in meshes} == {6 * 5, 256}


def test_a_value_that_is_selected_is_not_left_out(monkeypatch):
    maps = dataset(GRID)
    monkeypatch.setattr(thinning, "MOST", 6)
    asked = float(maps["kp"][3])
    _, said, _ = map_pictures.page(maps, kind="lines", x="kd", y="delay", select={"kp": asked})
    assert f"Shown: kp {asked:.4g}"[:12] in said and "values of kp" not in said


def test_only_what_is_drawn_is_kept_in_memory(tmp_path):
    folder = write(tmp_path, GRID)
    whole = opening.load_result(folder)
    part = opening.load_result(folder, {"verdict", "growth_rate"})
    assert not part["overshoot"].variable._in_memory and part["verdict"].variable._in_memory
    assert part.load().identical(whole)
