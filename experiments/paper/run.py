"""The study's figures 2, 3 and 4 and its claims, exact and as simulated.

    python experiments/paper/run.py

Steps, gain, phase and delay margin, and sensitivity against the actuator's natural frequency
[rad/s], for two damping ratios and three delays: exact in continuous time, exact when sampled at
1 kHz, and as simulated. claims.md says of every claim first whether it holds, then what is exactly
true. Writes results/paper/; takes about two minutes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from claims import claims
from pictures import PICTURES
from report import report

from jaxact.plotting import theme
from results import Results, compute

OUT = Path(__file__).resolve().parent.parent.parent / "results" / "paper"
CLAIMS = "claims.md"


def main(arguments: list[str] | None = None) -> None:
    """Compute and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the results")
    parser.add_argument("--format", choices=theme.FORMATS, default="png", help="of the pictures")
    options = parser.parse_args(arguments)
    write(compute(), options.out, options.format)


def write(results: Results, folder: Path, kind: str = "png") -> None:
    """Write the pictures and the page, and say which claims hold."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, picture in PICTURES.items():
        theme.write(picture(results), folder / f"{name}.{kind}", title=name.replace("_", " "))
    (folder / CLAIMS).write_text(report(results), encoding="utf-8")
    for claim in claims(results):
        print(f"{claim.verdict}: {claim.section}: {claim.quote}")
    print(f"wrote {folder}")


if __name__ == "__main__":
    main()
