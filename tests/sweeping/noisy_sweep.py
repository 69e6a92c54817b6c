"""A small sweep of a sliding mass with noise, counts and a limit, and how it is run."""

import tempfile
from pathlib import Path

from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.simulation import execute

NOISY = """
engine = "mass"
duration = 0.2
tile = 16
[parameters]
actuator = "starleth"
position_noise = 1e-4
position_resolution = 1e-4
force_limit = 60
[axes]
delay = [0.0, 0.0013]
kp = { min = 10, max = 2000, num = 9, spacing = "log" }
kd = { min = 1, max = 100, num = 5, spacing = "log" }
"""


def _asked(text, *changes):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sweep.toml"
        path.write_text(text)
        return reading.load(path, changes)


def run(text, *changes):
    asked = _asked(text, *changes)
    return execute.run(asked, expand(asked))
