"""What the emulated GRBL says: its greeting, and the status report that it gives to ``?`` (``doc/markdown/interface.md``)."""

from sim_backend.grbl_axes import Place
from sim_backend.grbl_gcode import MM_PER_INCH
from sim_backend.grbl_settings import GrblSettings

# How many reports pass before the offset and the overrides are told again: while busy, and while idle.
OFFSET_REPORTS, OVERRIDE_REPORTS = (30, 10), (20, 10)
LOCKED = "[MSG:'$H'|'$X' to unlock]\r\n"
HELP = "[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]\r\n"


def greeting(version: str, *, locked: bool) -> str:
    """Return the banner of a controller that has just started; it bears the version without its date."""
    number = ".".join(version.split(".")[:2])
    return f"\r\nGrbl {number} ['$' for help]\r\n" + (LOCKED if locked else "")


class GrblReporter:
    """Puts reports together and remembers when offset and overrides are due again."""

    def __init__(self, settings: GrblSettings) -> None:
        self._settings = settings
        self.forget()

    def forget(self) -> None:
        """Tell offset and overrides with the next reports, as after a reset or a change."""
        self._offset_due = self._override_due = 0

    def report(
        self, state: str, *, machine_mm: Place, offset_mm: Place, feed: float, at_switch: bool, room: tuple[int, int]
    ) -> str:
        """Return one report; ``room`` is what is free in the planner (blocks) and in the input (bytes)."""
        if int(self._settings[10]) & 1:
            fields = [state, f"MPos:{self.triple(machine_mm)}"]
        else:
            x_mm, y_mm, z_mm = (a - b for a, b in zip(machine_mm, offset_mm, strict=True))
            fields = [state, f"WPos:{self.triple((x_mm, y_mm, z_mm))}"]
        if int(self._settings[10]) & 2:
            fields.append(f"Bf:{room[0]},{room[1]}")
        fields.append(f"FS:{feed:.0f},0")
        if at_switch:
            fields.append("Pn:X")
        idle = state in ("Idle", "Alarm")
        if self._offset_due <= 0:
            self._offset_due = OFFSET_REPORTS[idle]
            fields.append(f"WCO:{self.triple(offset_mm)}")
        elif self._override_due <= 0:
            self._override_due = OVERRIDE_REPORTS[idle]
            fields.append("Ov:100,100,100")
        self._offset_due -= 1
        self._override_due -= 1
        return "<" + "|".join(fields) + ">\r\n"

    def triple(self, place_mm: Place) -> str:
        """Return three coordinates in the unit that ``$13`` asks for."""
        scale, decimals = (1 / MM_PER_INCH, 4) if self._settings[13] else (1.0, 3)
        # + 0.0 turns a negative zero, which no controller prints, into a plain one.
        return ",".join(f"{round(value_mm * scale, decimals) + 0.0:.{decimals}f}" for value_mm in place_mm)
