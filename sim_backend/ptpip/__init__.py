"""Emulated cameras that speak PTP/IP, so that libgphoto2 and the real driver run with no camera plugged in.

``python -m sim_backend.ptpip`` runs one by itself. :func:`sim_backend.ptpip.process.emulate_camera` runs one whose
photographs come from the process that started it: there lives the world, here only the wire.

The emulator must be another process than the one that calls libgphoto2, because several of its calls keep Python's
interpreter lock while they wait for an answer.
"""
