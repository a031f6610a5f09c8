"""Calibration of the nodes: what is measured at the stand, fitted, and written to their pages."""
