"""`jaxact identify --design`: which excitation would identify what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

from jaxact.cli._arguments import option
from jaxact.errors import UserError, shown
from jaxact.parameters import DELAY, KD, KP, MASS, WN, ZETA


@dataclass(frozen=True)
class Bench:
    """Options of a bench that does not exist yet."""

    wn: Annotated[str, option("LOW..HIGH", "With --design: natural frequency [rad/s].")] = (
        "100..1000"
    )
    zeta: Annotated[str, option("LOW..HIGH", "With --design: damping ratio.")] = "0.7"
    delay: Annotated[str, option("LOW..HIGH", "With --design: delay [s].")] = "0..0.005"
    duration: Annotated[float, option("SECONDS", "With --design: length of the log [s].")] = 20.0
    rate: Annotated[float, option("HZ", "With --design: rate of the log [Hz].")] = 1000.0
    amplitude: Annotated[
        float, option("SIZE", "With --design: largest excitation [N], with --plant mass [m].")
    ] = 1.0
    noise: Annotated[
        float, option("SIZE", "With --design: standard deviation of what is measured, same unit.")
    ] = 1e-3
    mass: Annotated[float, option("KG", "With --design and --plant mass [kg].")] = 0.7
    kp: Annotated[float, option("GAIN", "With --design and --plant mass [N/m].")] = 400.0
    kd: Annotated[float, option("GAIN", "With --design and --plant mass [N s/m].")] = 20.0


def run(bench: Bench, plant: str, out: Path) -> None:
    """Print what each excitation promises, and write the most telling one as CSV.

    Args:
        bench: the options.
        plant: "none" or "mass".
        out: the CSV.

    Raises:
        UserError: ranges or numbers that make no sense, or that this plant has not.
    """
    import numpy as np

    from jaxact import files
    from jaxact.identification import design

    if plant == "none":
        _demand_usual(bench, (MASS, KP, KD), 'is of `plant="mass"`; leave it out, or give that')
    asked = design.Bench(
        plant=plant, wn=_range(WN, bench.wn), zeta=_range(ZETA, bench.zeta),
        delay=_range(DELAY, bench.delay), duration=bench.duration, rate=bench.rate,
        amplitude=bench.amplitude, noise=bench.noise, mass=bench.mass, kp=bench.kp, kd=bench.kd,
    )  # fmt: skip
    found = design.design(asked)
    width = max(len(one.name) for one in found)
    print("standard deviations at best, at the worst drive of these ranges:")
    print(f"  {'excitation':{width}}  wn [%]    zeta      delay [ms]  delay + 2 zeta/wn [ms]")
    for one in found:
        print(
            f"  {one.name:{width}}  {100.0 * one.wn:<8.3g}  {one.zeta:<8.3g}  "
            f"{1e3 * one.delay:<10.3g}  {1e3 * one.lag:.3g}"
        )
    best = found[0]
    time = np.arange(len(best.signal)) / asked.rate
    head = "time,command" if plant == "none" else "time,setpoint"
    with files.output(out) as partial:
        np.savetxt(
            partial, np.stack([time, best.signal], axis=1), delimiter=",", header=head,
            comments="", fmt="%.9g",
        )  # fmt: skip
    print("real logs have residuals that hang together: expect several times these")
    print(f"wrote {out}: {best.name}")


def refuse(bench: Bench) -> None:
    """Raise UserError where an option of a bench is given without `--design`."""
    names = [item.name for item in fields(bench)]
    _demand_usual(bench, names, "is for `design`; logs say it themselves")


def _demand_usual(bench: Bench, names: Sequence[str], why: str) -> None:
    """Raise UserError where one of these options is not as by default."""
    usual = Bench()
    for name in names:
        if getattr(bench, name) != getattr(usual, name):
            raise UserError(f"`{name}` {why}")


def _range(name: str, text: str) -> tuple[float, float]:
    """`0.5` or `0.5..2` as two numbers."""
    parts = text.split("..")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 2):
        raise UserError(f"`{name}` = {shown(text)} is not a range; write 0.5 or 0.5..2")
    return numbers[0], numbers[-1]
