"""Reports that one can click: one HTML file, whose page computes by itself."""
