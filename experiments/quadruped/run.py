"""The study's section 4 on a quadruped: bare and with drives, nominal and tripled gains.

    python experiments/quadruped/run.py

Writes pictures, numbers, a page and a film to results/quadruped/.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import cases
import gains
import pictures
import report
import study
from motions import Runs, motions

from jaxact.errors import UserError
from jaxact.plotting import film, scene, theme, video, wording

OUT = cases.HERE.parent.parent / "results" / "quadruped"
COMMAND = "make quadruped"
# What the traces and the film show: the leg in the air, which shakes first.
SHOWN = ("three", "hyq", 0.001)
JOINT, WORDS = "LF_KFE", "knee of the leg in the air"
DURATION, TRACED = 1.2, 0.4  # of the film and of the traces [s]
FILM = scene.View(width=300, height=260, azimuth=150.0, elevation=-12.0, distance=2.1)
SPEED, FPS = 0.3, 12.5


def main() -> int:
    """Run the experiment; 0, or 2 after saying what is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the results")
    parser.add_argument("--quick", action="store_true", help="a small part, to see that it runs")
    parser.add_argument("--no-film", action="store_true", help="leave out what needs OpenGL")
    options = parser.parse_args()
    try:
        _run(options.out, quick=options.quick, filmed=not (options.no_film or options.quick))
    except UserError as error:
        print(f"run.py: {error}", file=sys.stderr)
        return 2
    return 0


def _run(out: Path, *, quick: bool, filmed: bool) -> None:
    size = study.QUICK if quick else study.FULL
    out.mkdir(parents=True, exist_ok=True)
    specifications = {name: cases.load(name, size.duration) for name in size.situations}
    began = time.monotonic()
    rule = gains.nominal(specifications, points=size.linear_points, rounds=size.linear_rounds)
    for name, one in specifications.items():
        if not quick and gains.differs(one, rule):
            raise UserError(f"{name}.toml: its gains are not those of gains.py; put them in")
    found = {}
    for name, one in specifications.items():
        print(f"{time.monotonic() - began:5.0f} s  {name}", flush=True)
        found[name] = study.situation(one, size)
    shown = {"stability_map.png": "Stability over gain scale and delay"}
    theme.write(
        pictures.stability_map(found, size.rollout), out / "stability_map.png",
        title="quadruped: stability map",
    )  # fmt: skip
    name, actuator, delay = SHOWN if not quick else (*size.situations[:1], *SHOWN[1:])
    print(f"{time.monotonic() - began:5.0f} s  motions", flush=True)
    runs = motions(specifications[name], actuator, delay, size.duration or DURATION)
    theme.write(
        pictures.traces(runs, JOINT, WORDS, TRACED),
        out / "traces.png",
        title="quadruped: joint traces",
    )
    shown["traces.png"] = f"Motion of the {WORDS}, with nominal and tripled gains"
    if filmed:
        shown["robots.gif"] = "The same tripled gains, bare and with the drive"
        _film(runs, out / "robots.gif")
    text = json.dumps(report.numbers(rule, found), indent=1)
    (out / "numbers.json").write_text(text + "\n", encoding="utf-8")
    page = report.page(rule, found, shown, COMMAND)
    (out / "README.md").write_text(page, encoding="utf-8")
    print(f"{time.monotonic() - began:5.0f} s  wrote {out}")


def _film(runs: Runs, path: Path) -> None:
    """The tripled gains, bare and with the drive."""
    from jaxact.robots import model

    robot = model.read(runs.specification.plant.model).model
    drive = f"{wording.display_name(runs.actuator)}, {wording.quantity(runs.delay, 's')}"
    labels = "tripled gains: bare", f"tripled gains: {drive}"
    paths = [
        film.Motion(label, pair[1].trajectory.time, pair[1].trajectory.configuration)
        for label, pair in zip(labels, (runs.bare, runs.drive), strict=True)
    ]
    frames = film.film(robot, *paths, module=scene.backend(), view=FILM, fps=FPS, speed=SPEED)
    video.write(frames, path, fps=FPS)


if __name__ == "__main__":
    sys.exit(main())
