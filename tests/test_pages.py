"""What the pages' Python imports and looks up exists; `make docs` runs the code itself."""

from __future__ import annotations

import ast
import importlib
import re
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(r"^```python\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
PAGES = {
    str(page.relative_to(ROOT)): [ast.parse(code) for code in BLOCK.findall(page.read_text())]
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    if not {"reference", "_build"}.intersection(page.parts)  # written when the site is built
}


def imported(tree: ast.Module) -> dict[str, object]:
    """What a block imports of jaxact, by the names that it gives them."""
    names: dict[str, object] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "jaxact":
                    module = importlib.import_module(alias.name)
                    names[alias.asname or "jaxact"] = (
                        module if alias.asname else importlib.import_module("jaxact")
                    )
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "jaxact":
            for alias in node.names:
                names[alias.asname or alias.name] = member(node.module or "", alias.name)
    return names


def member(module: str, name: str) -> object:
    """An attribute of a module, or a module in a package, as `from module import name` finds it."""
    package = importlib.import_module(module)
    return (
        getattr(package, name)
        if hasattr(package, name)
        else importlib.import_module(f"{module}.{name}")
    )


def missing(tree: ast.Module) -> list[str]:
    """The attributes of imported modules that a block names and that are not there."""
    names = imported(tree)
    absent = []

    def found(node: ast.AST) -> object:
        if isinstance(node, ast.Name):
            return names.get(node.id)
        owner = found(node.value) if isinstance(node, ast.Attribute) else None
        return getattr(owner, node.attr, None) if isinstance(owner, ModuleType) else None

    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            owner = found(node.value)
            if isinstance(owner, ModuleType) and not hasattr(owner, node.attr):
                absent.append(ast.unparse(node))
    return absent


@pytest.mark.parametrize("page", [page for page, blocks in PAGES.items() if blocks])
def test_what_a_page_names_exists(page):
    """A function that was moved or renamed is found here, long before the pages run."""
    absent = [name for block in PAGES[page] for name in missing(block)]
    assert not absent, f"{page} names {', '.join(absent)}"


def test_a_name_that_is_gone_is_found():
    block = "import jaxact as jx\nfrom jaxact.simulation import rollout\n"
    tree = ast.parse(block + "jx.margins, rollout.gone, jx.plot.bode, jx.plot.lost(1).x")
    assert sorted(missing(tree)) == ["jx.plot.lost", "rollout.gone"]
