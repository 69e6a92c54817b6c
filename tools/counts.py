"""Counts that say how the package is put together: sizes, layers, and where names are written.

    python tools/counts.py

Lines of the package, the largest files and functions (docstrings apart), modules at the root,
imports of `sweeping` by `tuning`, and in how many files each parameter's name stands as a string.
The exit code is 1 where a bound is not kept.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent / "jaxact"
MOST_LINES_OF_A_FILE, MOST_LINES_OF_A_FUNCTION, MOST_AT_THE_ROOT = 400, 60, 10
MOST_FILES_WITH_A_NAME = 3


def functions(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Name and lines of every function, without its docstring."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.end_lineno:
            said = ast.get_docstring(node, clean=False)
            words = 0 if said is None else said.count("\n") + 1
            yield node.name, node.end_lineno - node.lineno + 1 - words


def strings(tree: ast.AST) -> set[str]:
    """Every string in a module that is not a docstring."""
    texts = (node.value for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return {text for text in texts if isinstance(text, str)}


def main() -> int:
    """Print the counts; 1 where a bound is not kept."""
    from jaxact.parameters import PARAMETERS

    files = {path: path.read_text(encoding="utf-8") for path in sorted(PACKAGE.rglob("*.py"))}
    trees = {path: ast.parse(text) for path, text in files.items()}
    names = {path: str(path.relative_to(PACKAGE)) for path in files}
    long_files = [
        f"{names[path]} {count}"
        for path, text in files.items()
        if (count := text.count("\n")) > MOST_LINES_OF_A_FILE
    ]
    long_functions = [
        f"{names[path]}: {name} {count}"
        for path, tree in trees.items()
        for name, count in functions(tree)
        if count > MOST_LINES_OF_A_FUNCTION
    ]
    root = len(list(PACKAGE.glob("*.py")))
    mixed = [
        names[path] for path, text in files.items()
        if names[path].startswith("tuning") and "jaxact.sweeping" in text
    ]  # fmt: skip
    # The sources of exported files import nothing of the package, so they write names themselves.
    written = {
        path: strings(tree) for path, tree in trees.items() if "torch_sources" not in path.parts
    }
    spread = {name: sum(name in found for found in written.values()) for name in PARAMETERS}
    wide = [f"{name} {n}" for name, n in spread.items() if n > MOST_FILES_WITH_A_NAME]
    print(f"lines of the package: {sum(text.count(chr(10)) for text in files.values()):,}")
    print(f"modules: {len(files)}, of them at the root: {root}")
    for words, found in (
        (f"files over {MOST_LINES_OF_A_FILE} lines", long_files),
        (f"functions over {MOST_LINES_OF_A_FUNCTION} lines", long_functions),
        ("modules of tuning that import sweeping", mixed),
        (f"parameters whose name is a string in more than {MOST_FILES_WITH_A_NAME} files", wide),
    ):
        print(f"{words}: {len(found)}{': ' if found else ''}{', '.join(found)}")
    return int(bool(long_files or long_functions or mixed or wide) or root > MOST_AT_THE_ROOT)


if __name__ == "__main__":
    sys.exit(main())
