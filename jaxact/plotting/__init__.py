"""Pictures: one file each. Plotting never computes, and computing never plots."""
