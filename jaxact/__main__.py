"""`python -m jaxact`: the command line of this interpreter, where `jaxact` is not on the path."""

from jaxact.cli.main import entry

if __name__ == "__main__":
    entry()
