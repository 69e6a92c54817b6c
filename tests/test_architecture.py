"""The shape of the code: layers, no cycles, documented public names, a README that is true."""

import ast
import importlib
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from quickly import ENVIRONMENT

import jaxact
from jaxact.cli.main import VERBS
from jaxact.engines import ENGINES

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "jaxact"

# Folders are layers, from low to high; a module imports only from its own layer and lower ones.
LAYERS = (
    "errors", "status", "files", "reportable", "units", "parameters", "engines",
    "matrix_exponential", "compilation", "drive", "robots", "gains", "plants", "analysis", "loops",
    "simulation", "robot_margins", "sweeping", "tuning", "identification", "environments",
    "plotting", "reports", "verbs", "cli", "__main__",
)  # fmt: skip
MOST_AT_ROOT = 10
# Theory and simulation are written independently, so that each can catch the other's mistakes.
THEORY, SIMULATION = "analysis", ("drive", "plants", "loops", "simulation")


def _modules():
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


MODULES = dict(_modules())


def _imports(path):
    """Modules of jaxact that a file imports anywhere; and those it imports when it is loaded."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    anywhere = {name for node in ast.walk(tree) for name in _named(node)}
    return anywhere, {name for node in _executed(tree) for name in _named(node)}


def _executed(tree):
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            continue
        yield node
        yield from _executed(node)


def _named(node):
    if isinstance(node, ast.Import):
        names = [alias.name for alias in node.names]
    elif isinstance(node, ast.ImportFrom) and node.level == 0:
        whole = [f"{node.module}.{alias.name}" for alias in node.names]
        names = [name if name in MODULES else node.module for name in whole]
    else:
        return []
    return [name for name in names if name in MODULES and name != "jaxact"]


def _part(module):
    return module.partition("jaxact.")[2].partition(".")[0]


def _layer(module):
    assert _part(module) in LAYERS, f"{module} is in no layer; give its folder one in LAYERS"
    return LAYERS.index(_part(module))


def test_the_root_of_the_package_has_few_modules():
    assert len(list(PACKAGE.glob("*.py"))) <= MOST_AT_ROOT


def test_nobody_tells_engines_apart_by_name():
    """What is so of one engine and not of others is an attribute in `jaxact.engines`."""
    names, found = {engine.name for engine in ENGINES}, []
    for module, path in MODULES.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            text = ast.unparse(node) if isinstance(node, ast.Compare) else ""
            values = {one.value for one in ast.walk(node) if isinstance(one, ast.Constant)}
            if "engine" in text and names & values:
                found.append(f"{module}: {text}")
    assert not found


@pytest.mark.parametrize("module", [name for name in MODULES if name != "jaxact"])
def test_imports_only_point_down_the_layers(module):
    anywhere, _ = _imports(MODULES[module])
    up = [name for name in anywhere if _layer(name) > _layer(module)]
    assert not up, f"{module} imports {up} from a higher layer"


def test_there_is_no_circular_import():
    graph = {name: _imports(path)[1] - {name} for name, path in MODULES.items()}
    done, path = set(), []

    def visit(name):
        assert name not in path, f"circular import: {' -> '.join([*path, name])}"
        if name not in done:
            path.append(name)
            for other in sorted(graph[name]):
                visit(other)
            done.add(path.pop())

    for name in graph:
        visit(name)


@pytest.mark.parametrize("module", [name for name in MODULES if _part(name) == THEORY])
def test_theory_does_not_import_simulation(module):
    anywhere, _ = _imports(MODULES[module])
    assert not [name for name in anywhere if _part(name) in SIMULATION]


def test_no_module_is_a_drawer_of_odds_and_ends():
    words = {"utils", "util", "helpers", "helper", "misc", "common", "tools"}
    assert not [name for name in MODULES if words & set(name.lower().replace("_", ".").split("."))]


@pytest.mark.parametrize("module", MODULES)
def test_every_module_and_public_name_is_documented(module):
    tree = ast.parse(MODULES[module].read_text(encoding="utf-8"))
    assert ast.get_docstring(tree), f"{module} has no docstring"
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            assert ast.get_docstring(node), f"{module}.{node.name} has no docstring"


@pytest.mark.parametrize("name", sorted(jaxact._PUBLIC))
def test_public_names_exist_and_are_documented(name):
    value = getattr(jaxact, name)
    assert value.__doc__ and name in dir(jaxact)
    itself = jaxact._PUBLIC[name] == f"jaxact.{name}"  # it is a module
    assert itself or f"jaxact.{name}" not in MODULES, "a module of that name would hide it"


def test_an_unknown_public_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = jaxact.nonsense


def _python(code, **environment):
    others = "ignore:JAXopt is no longer maintained"  # what Playground's brax imports
    return subprocess.run(
        [sys.executable, "-W", "error", "-W", others, "-c", code],
        capture_output=True, text=True, cwd=ROOT, env=os.environ | environment,
    )  # fmt: skip


def test_importing_the_package_loads_nothing_heavy():
    code = "import jaxact, jaxact.cli.main, sys; print(*sys.modules)"
    loaded = _python(code).stdout
    assert not {"jax", "numpy", "xarray", "mujoco", "matplotlib"} & set(loaded.split())


def test_every_verb_is_a_module_with_a_documented_main():
    for verb in VERBS:
        main = importlib.import_module(f"jaxact.cli.{verb}").main
        assert main.__doc__ and "examples:" in main.__doc__


PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
    if not {"reference", "_build"}.intersection(path.parts)  # written when the site is built
}
README = PAGES["README.md"]
LONGEST_README = 10_000  # characters; the rest is in docs/


def _blocks(page, kind):
    """Code of a kind in a page."""
    fences = re.findall(r"^```(\w*)\n(.*?)^```", PAGES[page], flags=re.MULTILINE | re.DOTALL)
    return [block for name, block in fences if name == kind]


def test_readme_is_short_and_opens_with_the_map_and_the_two_commands():
    head = README[: README.index("\n## ")]
    picture = re.search(r"!\[[^\]]+\]\((results/paper_gain_map/\S+\.png)\)", head)
    assert picture and head.index("make demo") < head.index("make test")
    assert (ROOT / picture[1]).is_file()
    assert len(README) <= LONGEST_README


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_to_files(page):
    for target in re.findall(r"\]\(([^)#]+)[)#]", PAGES[page]):
        if "://" not in target:
            assert ((ROOT / page).parent / target).exists(), f"{page}: {target} is not there"


def test_the_readme_says_what_every_folder_is_for():
    table = README[README.index("| folder of `jaxact/` |") :]
    folders = [path.parent.name for path in PACKAGE.glob("*/__init__.py")]
    assert folders and not [name for name in folders if f"`{name}`" not in table]


def test_every_page_is_linked_from_the_readme_or_the_sites_contents():
    site = re.findall(r"^[\w/-]+$", PAGES["docs/index.md"], flags=re.MULTILINE)
    linked = re.findall(r"\((docs/[^)#]+)", README) + [f"docs/{name}.md" for name in site]
    assert [name for name in PAGES if name not in linked] == ["README.md"]


@pytest.mark.parametrize("page", PAGES)
def test_every_page_has_an_example_that_runs(page):
    assert re.search(r"^```(python|sh)$", PAGES[page], flags=re.MULTILINE)


def test_commands_of_the_pages_exist():
    made = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE))
    blocks = [block for page in PAGES for block in _blocks(page, "sh")]
    lines = [line for block in blocks for line in block.splitlines()]
    assert lines
    for line in lines:
        words = shlex.split(line, comments=True)
        if not words:
            continue
        assert words[0] in ("make", "jaxact", "git", "cd", ".venv/bin/jaxact"), line
        if words[0] == "make":
            assert words[1] in made, line
        if words[0].endswith("jaxact"):
            assert words[1] in VERBS, line
            assert words[1] != "sweep" or (ROOT / words[2]).is_file(), line


# The commands and the code of the other pages run when the site is built.


@pytest.mark.exhaustive
def test_commands_of_the_readme_run(tmp_path):
    shutil.copytree(ROOT / "experiments", tmp_path / "experiments")
    environment = os.environ | ENVIRONMENT | {"PYTHONPATH": str(ROOT)}
    sh = "".join(_blocks("README.md", "sh"))
    lines = [shlex.split(line, comments=True) for line in sh.splitlines()]
    commands = [words[1:] for words in lines if words[:1] == ["jaxact"]]
    assert commands
    for words in commands:
        program = [sys.executable, "-m", "jaxact", *words]
        ran = subprocess.run(program, capture_output=True, text=True, cwd=tmp_path, env=environment)
        assert ran.returncode == 0, f"{words}: {ran.stderr}"


@pytest.mark.exhaustive
def test_code_of_the_readme_runs(tmp_path):
    code = "".join(_blocks("README.md", "python"))
    # mujoco.mjx relies on broadcasting of ranks
    own = {"JAX_NUMPY_RANK_PROMOTION": "allow", "JAXACT_PROGRAMS": str(tmp_path)}
    ran = _python(code, **ENVIRONMENT | own)
    assert ran.returncode == 0, ran.stderr
    said = [line for line in code.splitlines() if "# prints " in line]
    # What mujoco.mjx says of Warp when somebody imports it themselves.
    printed = [line for line in ran.stdout.splitlines() if not line.startswith("Failed to import")]
    rest = iter(printed)  # tables and the like stand in between
    for line in said:
        assert line.split("# prints ")[1] in rest, f"{line}: {printed}"
