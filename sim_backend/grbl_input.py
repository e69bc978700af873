"""The receive buffer of an emulated GRBL: bytes in, whole lines out, in their order."""

RX_BUFFER = 128


class GrblInput:
    """Bytes that no realtime command claimed. ``lost`` counts those for which there was no room."""

    def __init__(self) -> None:
        self.lost = 0
        self._bytes = bytearray()
        self._line = bytearray()

    def clear(self) -> None:
        """Forget what has not been read, as a reset does."""
        self._bytes.clear()
        self._line.clear()

    def room(self) -> int:
        """Return how many bytes are free."""
        return RX_BUFFER - len(self._bytes)

    def take(self, byte: int) -> None:
        """Buffer one byte, or lose it."""
        if self.room():
            self._bytes.append(byte)
        else:
            self.lost += 1

    def next_line(self) -> str | None:
        """Return the next whole line; what has come of one that is not whole yet leaves the buffer as well."""
        while self._bytes:
            byte = self._bytes.pop(0)
            if byte in b"\r\n":
                line = self._line.decode("ascii")
                self._line.clear()
                return line
            self._line.append(byte)
        return None
