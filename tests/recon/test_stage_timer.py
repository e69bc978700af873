"""Peak memory, by a process that holds known numbers of bytes for a moment."""

import subprocess
import sys

HOLD = """
from recon.stage_timer import peak_memory_mb
peaks = []
for size in (200_000_000, 600_000_000):
    held = bytearray(b"1") * size
    del held
    peaks.append(peak_memory_mb())
print(peaks[1] - peaks[0])
"""


def test_the_peak_is_told_in_millions_of_bytes() -> None:
    # Whoever starts the process may be larger.
    larger = bytearray(b"1") * 700_000_000
    told = subprocess.run([sys.executable, "-c", HOLD], check=True, capture_output=True, text=True, timeout=60)
    del larger
    # By thousands of kibibytes it would be 2.4 % less.
    assert abs(float(told.stdout) - 400) < 4
