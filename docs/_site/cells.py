"""Code blocks and commands of a page become cells that run when the site is built.

A page is Markdown with fenced blocks. On the site

    ```python                    is a cell, whose output stands below it and has every line that
                                 its code announces with `# prints LINE`,
    ```sh                        too: its commands run one after the other,
    <!-- picture: NAME.png -->   shows a picture that a command above has made,

and other blocks (```toml, ```text, ```bash, and `make`) are only shown. Every page runs in a folder
of its own with `experiments/` in it: relative paths are those of the repository, and nothing in the
repository is written to.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
FRONT = """---
file_format: mystnb
kernelspec:
  name: python3
  display_name: Python 3
  language: python
---

"""
BLOCK = re.compile(r"^```(python|sh)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
# Pages of the repository that are not of the site, such as results: to be read as they are.
OUTSIDE = re.compile(r"\]\((?=(?:\.\./)+(?:README\.md|(?:results|experiments)/[^)#]*\.md))")
ANNOUNCED = re.compile(r"# prints (.*)$", flags=re.MULTILINE)
PICTURE = re.compile(r"^<!-- picture: (\S+) -->$", flags=re.MULTILINE)
BEGIN = """```{{code-cell}} ipython3
:tags: [remove-cell]
import contextlib, io, os
os.chdir({folder!r})
for name in ("FORCE_COLOR", "CLICOLOR_FORCE", "CLICOLOR"):  # which the kernel sets
    os.environ.pop(name, None)
os.environ["TERM"] = "dumb"
get_ipython().ast_node_interactivity = "none"  # only what is printed or drawn
with contextlib.redirect_stdout(None):  # what it says of Warp when it is imported
    import mujoco.mjx
printed = []
def print(*values, print=print, **options):
    text = io.StringIO()
    print(*values, file=text)
    printed.extend(text.getvalue().splitlines())
    print(*values, **options)
```

"""


def notebook(text: str, folder: Path) -> str:
    """The text of a page as a notebook that runs in a folder."""
    text = OUTSIDE.sub("](path:", text)
    if not (BLOCK.search(text) or PICTURE.search(text)):
        return text
    cells = PICTURE.sub(_picture, BLOCK.sub(_cell, text))
    return FRONT + BEGIN.format(folder=str(folder)) + cells


def _cell(match: re.Match[str]) -> str:
    """A block of Python, or of commands, the first of which that fails fails the cell."""
    kind, code = match.groups()
    if re.search(r"^make ", code, flags=re.MULTILINE):
        return match[0]
    head = "%%sh -e\n" if kind == "sh" else ""
    return f"```{{code-cell}} ipython3\n{head}{code}```{_checked(ANNOUNCED.findall(code))}"


def _checked(lines: list[str]) -> str:
    """A cell that fails unless these lines were printed, in this order, others between them."""
    if not lines:
        return ""
    check = (
        "lines, printed[:] = iter(list(printed)), []\n"
        f"for line in {lines!r}:\n"
        "    assert line in lines, f'not printed: {line}'\n"
    )
    return f"\n\n```{{code-cell}} ipython3\n:tags: [remove-cell]\n{check}```"


def _picture(match: re.Match[str]) -> str:
    """A picture, without the code that shows it."""
    show = f"from IPython.display import Image\nImage({match[1]!r})"
    return f"```{{code-cell}} ipython3\n:tags: [remove-input]\n{show}\n```"


def _read(app: Any, page: str, source: list[str]) -> None:
    """Sphinx has read a page."""
    folder = Path(app.jaxact_pages) / page.replace("/", "_")
    folder.mkdir(exist_ok=True)
    if not (folder / "experiments").exists():
        shutil.copytree(ROOT / "experiments", folder / "experiments")
    source[0] = notebook(source[0], folder)


def _done(app: Any, _error: Exception | None) -> None:
    shutil.rmtree(app.jaxact_pages, ignore_errors=True)


def setup(app: Any) -> dict[str, bool]:
    """Sphinx's entry point."""
    app.jaxact_pages = tempfile.mkdtemp(prefix="jaxact-docs-")
    app.connect("source-read", _read)
    app.connect("build-finished", _done)
    return {"parallel_read_safe": True}
