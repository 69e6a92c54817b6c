"""From a log to certified gains: identify the drive, read its margins, tune for what is known.

python experiments/identification/gains.py
"""

from __future__ import annotations

from pathlib import Path

import jaxact as jx

HERE = Path(__file__).resolve().parent


def main() -> None:
    """Print each stage."""
    found = jx.identify(
        HERE / "logs" / "ak80_fit.npz",
        validate=HERE / "logs" / "ak80_validate.npz",
        columns=HERE / "ak80.toml",
        joint="elbow",
    )
    print(found)
    # The drive in front of a knee of 0.05 kg m^2, first with gains somebody chose.
    loop = jx.joint(drive=found, inertia=0.05, kp=20.0, kd=0.6)
    print(f"\nwith kp 20, kd 0.6:\n{jx.margins(loop)}")
    best = jx.tune(loop, max_peak=1.6, uncertainty=found)
    gains = f"kp {best.loop.kp:.3g}, kd {best.loop.kd:.3g}"
    print(f"\ncertified for all that the log leaves open: {gains}")
    print(jx.margins(best.loop))


if __name__ == "__main__":
    main()
