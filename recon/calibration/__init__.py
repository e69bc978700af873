"""Measure where the camera looks and where the display stands, and say how well both are known.

::

    board ── detection ── intrinsics ──┐
                │         (coverage)   ├── display_poses ── wet_pose ── calibration_file ── validity
                └──────────────────────┘        └── fep_error, caliper ── assembly

Everything here takes arrays and returns arrays; photos are read, and devices moved, by others. All poses are in the camera's
frame (x right, y down, z forward, mm); rotations vary as exp(w) R with w in rad about the camera's axes.
"""
