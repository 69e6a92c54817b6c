"""The pages of the reference, written from the code when the site is built.

`reference/parameters.md` from the table of parameters, `reference/commands.md` from every command's
help, `reference/json.md` from what the commands print, `reference/python.md` from the public names,
whose docstrings Sphinx reads.
"""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import schemas

import jaxact
from jaxact.cli.main import VERBS
from jaxact.parameters import PARAMETERS, PRESETS

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "reference"


def parameters() -> str:
    """The page of the parameters."""
    rows = [
        f"| `{p.name}` | {p.unit} | {p.default:g} | {p.bounds} | {p.description} |"
        for p in PARAMETERS.values()
    ]
    presets = [f"| `{name}` | {wn:g} | {zeta:g} |" for name, (wn, zeta) in PRESETS.items()]
    return "\n".join([
        "# Parameters", "",
        "Of a loop, in specifications, as options (`--joint-damping`), and as arguments of",
        "`jaxact.joint` and `jaxact.robot`.", "",
        "| name | unit | default | allowed | meaning |", "|---|---|---|---|---|", *rows, "",
        "`actuator` sets two of them:", "",
        "| preset | wn [rad/s] | zeta |", "|---|---|---|", *presets, "",
        "The same as a table in a terminal:", "", "```sh", "jaxact parameters", "```", "",
    ])  # fmt: skip


def commands() -> str:
    """The page of the commands: what `--help` prints."""
    environment = os.environ | {"COLUMNS": "100"}
    parts = ["# Commands", "", "What `jaxact COMMAND --help` prints.", ""]
    for verb, meaning in VERBS.items():
        help_of = [sys.executable, "-m", "jaxact", verb, "--help"]
        ran = subprocess.run(help_of, env=environment, capture_output=True, text=True, check=True)
        parts += [f"## {verb}", "", f"{meaning}.".capitalize(), ""]
        parts += ["```text", ran.stdout.rstrip(), "```", ""]
    parts += ["The first lines of all of them:", "", "```sh", "jaxact --help", "```", ""]
    return "\n".join(parts)


def python() -> str:
    """The page of the public names."""
    names = {name: getattr(jaxact, name) for name in jaxact.__all__ if name != "__version__"}
    parts = ["# Python", "", "```python", "import jaxact as jx", "print(jx.__all__)", "```", ""]
    for name, value in names.items():
        if isinstance(value, ModuleType):
            continue
        parts += [f"## {name}", "", *_directive(f"jaxact.{name}", value)]
    for name, module in names.items():
        if not isinstance(module, ModuleType):
            continue
        parts += [f"## {name}", "", *_eval(f".. automodule:: {module.__name__}", [":no-index:"])]
        for inner in _public(module):
            parts += [f"### {name}.{inner}", ""]
            parts += _directive(f"{module.__name__}.{inner}", getattr(module, inner))
    return "\n".join(parts)


def _public(module: ModuleType) -> list[str]:
    return list(getattr(module, "__all__", ())) or [
        name for name, value in vars(module).items()
        if inspect.isfunction(value) and value.__module__ == module.__name__ and name[0] != "_"
    ]  # fmt: skip


def _directive(path: str, value: Any) -> list[str]:
    if inspect.isclass(value):
        return _eval(f".. autoclass:: {path}", [":members:"])
    return _eval(f".. autofunction:: {path}", [])


def _eval(directive: str, options: list[str]) -> list[str]:
    return ["```{eval-rst}", directive, *(f"   {option}" for option in options), "```", ""]


def _write(_app: Any) -> None:
    FOLDER.mkdir(exist_ok=True)
    pages = {"parameters": parameters, "commands": commands, "python": python, "json": schemas.page}
    for name, page in pages.items():
        (FOLDER / f"{name}.md").write_text(page(), encoding="utf-8")


def _escaped(_app: Any, _what: str, _name: str, _value: Any, _how: Any, lines: list[str]) -> None:
    """A docstring as reStructuredText, where |S| would be a substitution."""
    lines[:] = [line.replace("|", "\\|") for line in lines]


def setup(app: Any) -> dict[str, bool]:
    """Sphinx's entry point."""
    app.connect("builder-inited", _write)
    app.connect("autodoc-process-docstring", _escaped)
    return {"parallel_read_safe": True}
