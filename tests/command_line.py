"""The command line in this process: a command in, its exit code and what it said out."""

import contextlib
import io
from dataclasses import dataclass

from jaxact.cli.main import main


@dataclass
class Ran:
    """As `subprocess.run` has it."""

    returncode: int
    stdout: str
    stderr: str


def jaxact(*arguments, cwd="."):
    """Run a command in a folder."""
    out, said = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(said), contextlib.chdir(cwd):
        try:
            code = main([str(word) for word in arguments])
        except SystemExit as leaving:
            code = leaving.code or 0
    return Ran(code, out.getvalue(), said.getvalue())
