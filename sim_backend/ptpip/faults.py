"""What can be made to go wrong with an emulated camera while it runs."""

from dataclasses import dataclass, fields


@dataclass(slots=True)
class Faults:
    """Each number counts down as its fault happens; each switch stays until it is set back.

    Attributes
    ----------
    busy
        Captures refused with DeviceBusy (0x2019).
    stale
        Photos whose file holds the bytes of the photo before.
    truncated
        Downloads that end half way; for a photo that goes straight to the host, photos.
    stray
        Photos that somebody takes by hand, at once.
    stray_in_capture
        Photos that somebody takes by hand during the next captures, one each.
    lost
        Captures that the camera accepts and forgets: no photo comes.
    dropped_link
        Requests for a capture at which the connection breaks.
    dial_turned
        Photos for which somebody turns the dial of the shutter's time one step to the longer, and back again.
    hidden_settings
        Settings that the body accepts and does not take over.
    silent
        The camera reads and never answers, on old connections and on new ones.
    no_shots_left
        The camera reports room for no shot at all, for which libgphoto2 waits without end (EOS alone).
    card_full
        Captures are refused with StoreFull (0x200C).
    """

    busy: int = 0
    stale: int = 0
    truncated: int = 0
    stray: int = 0
    stray_in_capture: int = 0
    lost: int = 0
    dropped_link: int = 0
    dial_turned: int = 0
    hidden_settings: int = 0
    silent: bool = False
    card_full: bool = False
    no_shots_left: bool = False

    def update(self, changes: dict[str, int]) -> None:
        """Set the faults named in ``changes``; raises ``ValueError`` for a name that is none."""
        names = [field.name for field in fields(self)]
        for name, value in changes.items():
            if name not in names:
                raise ValueError(f"no fault {name!r}; there are {', '.join(names)}")
            setattr(self, name, value)

    def happens(self, name: str) -> bool:
        """Tell whether the counted fault ``name`` happens now, and count it."""
        left = getattr(self, name)
        if left > 0:
            setattr(self, name, left - 1)
        return left > 0
