"""The folder of a tuned joint or robot: its gains as TOML and MJCF, and the pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxact.plotting import theme, tuning
from jaxact.tuning.document import mjcf_text, toml_text
from jaxact.tuning.rollouts import motion
from jaxact.verbs import tuning_front, tuning_pictures
from jaxact.verbs.tuning_tables import Joint, Robot


def write(shown: Joint | Robot, folder: Path, document: Mapping[str, Any], command: str) -> None:
    """Write texts and pictures into a folder that is there.

    Args:
        shown: the result.
        folder: to write into.
        document: the result's report.
        command: that made it.
    """
    tuned = shown.tuned
    if isinstance(shown, Joint):
        nominal = document["margins"]["after"]
        texts = {"gains.toml": toml_text(tuned, command, nominal=nominal),
                 "gains.xml": mjcf_text(tuned, shown.name)}  # fmt: skip
        pictures = tuning_pictures.of_joint(tuned, shown.nominal)
    else:
        texts = {"gains.toml": toml_text(tuned, command, rollouts=shown.rollouts),
                 "gains.xml": mjcf_text(tuned)}  # fmt: skip
        if shown.rollouts is not None:
            texts["motion.csv"] = motion.csv_text(shown.rollouts.motions)
        assert tuned.robot is not None
        pictures = tuning_pictures.of_robot(tuned, tuned.robot)
    if tuned.front:
        found = tuning_front.front(tuned.front)
        drawn, words = tuning_pictures.drawn_front(found, tuned.goal.max_peak)
        texts["front.csv"] = tuning_front.csv_text(found)
        pictures["front"] = tuning.front(*drawn, **words)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    for name, figure in pictures.items():
        theme.write(figure, folder / f"{name}.png", title=f"jaxact tune: {name.replace('_', ' ')}")
