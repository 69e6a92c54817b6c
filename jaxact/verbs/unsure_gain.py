"""The gain of an identified drive where it is uncertain, and the inertia is not the drive's."""

from __future__ import annotations

import warnings

from jaxact.errors import InexactWarning, UserError
from jaxact.loops.drives import ROBOT, IdentifiedDrive

KNOWN = (1.0, 1.0)


def demand_force(drive: IdentifiedDrive) -> None:
    """Raise UserError for a drive that may give no force, for which no gains of a joint hold."""
    weak, strong = drive.strength
    if not weak > 0.0:
        raise UserError(
            f"`uncertainty`: the 95 % interval of the gain of {drive.name} holds 0 (up to "
            f"{strong:.3g} times what it is taken for), and no gains hold for a drive without "
            "force; identify it better, or give a range of `mass` or inertia, 0.8x..1.2x"
        )


def as_inertia(drive: IdentifiedDrive) -> str:
    """The range of a joint's inertia, as factors, that moves as one behind an uncertain gain.

        inertia q'' = gain f   is   (inertia / gain) q'' = f

    Args:
        drive: what is known of its gain.

    Returns:
        As the command line writes it; "" where the gain is known.
    """
    weak, strong = drive.strength
    return "" if (weak, strong) == KNOWN else f"{1.0 / strong!r}x..{1.0 / weak!r}x"


def tell_left_out(drive: IdentifiedDrive) -> None:
    """Warn of an uncertain gain in front of a robot, whose box has no range for it."""
    weak, strong = drive.strength
    if drive.plant == ROBOT or (weak, strong) == KNOWN:
        return
    said = (
        f"{drive.name}: the 95 % interval of its gain, {weak:.3g} to {strong:.3g} times what it is"
        " taken for, is left out of a robot's box; `min_disk_margin` is a bound against it"
    )
    warnings.warn(said, InexactWarning, stacklevel=4)
