"""Write the lock files: every dependency exactly pinned, for all Pythons in one file.

`requirements-lock.txt` has what `.[dev]` needs, `requirements-docs-lock.txt` what the site of the
documentation needs beside it (`.[docs]`). For each interpreter a fresh environment resolves them
without installing; where the interpreters agree a package gets one line, where they differ one line
each with a marker. Only names, versions and markers are written, never where a package came from.

    python tools/lock.py [python3.11 python3.12 python3.13]

Interpreters are given in ascending order, or found on the PATH and among pyenv's. The last one's
versions also serve newer Pythons.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LOCK = ROOT / "requirements-lock.txt"
DOCS_LOCK = ROOT / "requirements-docs-lock.txt"
SUPPORTED = ("3.11", "3.12", "3.13")
HEADER = """\
# Every dependency of {what}, exactly pinned.
# Written by `make lock` from pyproject.toml; do not edit.
"""


def find(version: str) -> str:
    """An interpreter of this "major.minor" that really runs."""
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    candidates = [f"python{version}", *map(str, pyenv.glob(f"versions/{version}.*/bin/python"))]
    for candidate in candidates:
        with contextlib.suppress(OSError):
            if (
                subprocess.run([candidate, "-c", "import venv"], capture_output=True).returncode
                == 0
            ):
                return candidate
    raise SystemExit(f"tools/lock.py: found no Python {version} that runs")


def resolve(interpreter: str, constraints: Path | None, extra: str) -> tuple[str, dict[str, str]]:
    """The interpreter's "major.minor" and the name -> version that pip chooses for an extra."""
    ask = "import sys; print('%d.%d' % sys.version_info[:2])"
    version = subprocess.check_output([interpreter, "-c", ask], text=True).strip()
    with tempfile.TemporaryDirectory() as scratch:
        environment = Path(scratch) / "venv"
        report = Path(scratch) / "report.json"
        subprocess.run([interpreter, "-m", "venv", environment], check=True)
        pip = [str(environment / "bin" / "python"), "-m", "pip", "--quiet", "install"]
        subprocess.run([*pip, "--upgrade", "pip"], check=True)
        choose = ["--dry-run", "--ignore-installed", "--report", str(report)]
        if constraints is not None:
            choose += ["--constraint", str(constraints)]
        subprocess.run([*pip, *choose, f"{ROOT}[{extra}]"], check=True)
        chosen = json.loads(report.read_text())["install"]
    names = {
        re.sub(r"[-_.]+", "-", item["metadata"]["name"]).lower(): item["metadata"]["version"]
        for item in chosen
    }
    del names["jaxact"]
    return version, names


def marker(pythons: list[str], holders: list[str]) -> str:
    """The marker that holds for the Pythons `holders`, a run of the ascending `pythons`."""
    if holders == pythons:
        return ""
    first, last = pythons.index(holders[0]), pythons.index(holders[-1])
    if pythons[first : last + 1] != holders:
        raise SystemExit(f"tools/lock.py: {holders} is not a run of {pythons}")
    bounds = [f'python_version >= "{holders[0]}"'] if first else []
    if last + 1 < len(pythons):
        bounds.append(f'python_version < "{pythons[last + 1]}"')
    return " ; " + " and ".join(bounds)


def lines(resolved: dict[str, dict[str, str]]) -> list[str]:
    """The lines of the lock file from Python -> name -> version."""
    pythons = list(resolved)
    result = []
    for name in sorted(set().union(*resolved.values())):
        holders: dict[str, list[str]] = {}
        for python in pythons:
            if name in resolved[python]:
                holders.setdefault(resolved[python][name], []).append(python)
        result += [f"{name}=={pin}{marker(pythons, who)}" for pin, who in holders.items()]
    return result


def main(interpreters: list[str]) -> None:
    """Resolve for every interpreter and replace the lock files."""
    chosen = interpreters or [find(version) for version in SUPPORTED]
    resolved = dict(resolve(each, None, "dev") for each in chosen)
    _write(LOCK, "jaxact and of its development environment", resolved)
    with_site = dict(resolve(each, LOCK, "docs") for each in chosen)
    beside = {
        python: {name: pin for name, pin in names.items() if name not in resolved[python]}
        for python, names in with_site.items()
    }
    _write(DOCS_LOCK, "the site of the documentation, beside the others", beside)


def _write(target: Path, what: str, resolved: dict[str, dict[str, str]]) -> None:
    pins = lines(resolved)
    target.write_text(HEADER.format(what=what) + "\n".join(pins) + "\n")
    print(f"{target.name}: {len(pins)} pins for Python {', '.join(resolved)}")


if __name__ == "__main__":
    main(sys.argv[1:])
