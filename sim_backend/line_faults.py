"""What can go wrong on a wire between a host and an emulated device: switches that a test turns."""

import threading
import time
from collections import deque


class LineFaults:
    """The faults of one line; a fresh one has none. Every method may be called from any thread.

    ``silent``: what the device says never reaches the host. ``deaf``: what the host says never reaches the device.
    ``delay_s``: real seconds that pass before the host hears what the device says.
    """

    def __init__(self) -> None:
        self.silent = False
        self.deaf = False
        self.delay_s = 0.0
        self._lock = threading.Lock()
        self._drop_to_host = 0
        self._drop_to_device = 0
        self._noise = bytearray()
        self._strange = bytearray()
        self._late: deque[tuple[float, bytes]] = deque()

    def drop_to_host(self, count: int) -> None:
        """Lose the next ``count`` bytes that the device says."""
        with self._lock:
            self._drop_to_host += count

    def drop_to_device(self, count: int) -> None:
        """Lose the next ``count`` bytes that the host says."""
        with self._lock:
            self._drop_to_device += count

    def inject(self, noise: bytes) -> None:
        """Let the host hear ``noise`` before anything else."""
        with self._lock:
            self._noise += noise

    def interfere(self, data: bytes) -> None:
        """Let the device hear ``data`` that the host never said, such as another program's command."""
        with self._lock:
            self._strange += data

    def to_device(self, data: bytes) -> bytes:
        """Return what reaches the device when the host says ``data``."""
        with self._lock:
            kept = data[self._drop_to_device :]
            self._drop_to_device -= len(data) - len(kept)
            heard = bytes(self._strange) + (b"" if self.deaf else kept)
            self._strange.clear()
            return heard

    def to_host(self, data: bytes) -> bytes:
        """Return what the host hears now, when the device says ``data``."""
        with self._lock:
            kept = data[self._drop_to_host :]
            self._drop_to_host -= len(data) - len(kept)
            now_s = time.monotonic()
            if kept and not self.silent:
                self._late.append((now_s + self.delay_s, kept))
            heard = bytes(self._noise)
            self._noise.clear()
            while self._late and self._late[0][0] <= now_s:
                heard += self._late.popleft()[1]
            return heard
