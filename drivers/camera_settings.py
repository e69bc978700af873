"""Settings of an opened camera through libgphoto2: read, checked before anything is set, set, and read back."""

import time
from collections.abc import Callable, Mapping
from typing import Any

READ_BACK_S = 2.0


class RefusedError(Exception):
    """The camera cannot do what is asked."""


def find_setting(gp: Any, camera: Any, name: str) -> Any:
    """Return libgphoto2's widget of a setting, or None where the camera has none of this name."""
    try:
        return camera.get_single_config(name)  # None on an EOS, an error on others
    except gp.GPhoto2Error as error:
        if error.code == gp.GP_ERROR_BAD_PARAMETERS:
            return None
        raise


def read_setting(gp: Any, camera: Any, name: str) -> str | None:
    """Return the value of a setting, or None where the camera has none of this name."""
    widget = find_setting(gp, camera, name)
    return None if widget is None else str(widget.get_value()).strip()


def read_choices(gp: Any, camera: Any, name: str) -> tuple[str, ...]:
    """Return the values that a setting may take; empty where it has no list of them, or only the body can change it."""
    widget = find_setting(gp, camera, name)
    if widget is None or widget.get_readonly() or widget.get_type() not in (gp.GP_WIDGET_RADIO, gp.GP_WIDGET_MENU):
        return ()
    return tuple(str(choice) for choice in widget.get_choices())


def apply_settings(
    gp: Any, camera: Any, settings: Mapping[str, str], *, patiently: Callable[[Callable[[], Any]], None]
) -> dict[str, str]:
    """Set and read back; nothing is set unless every name and value is one that the camera has.

    ``patiently`` carries out an action again while the camera is busy. Raises :class:`RefusedError`.
    """
    wanted = {name: _checked(gp, camera, name, value) for name, value in settings.items()}
    for name, value in wanted.items():
        if read_setting(gp, camera, name) != str(value):
            _set(gp, camera, name, value, patiently)
    return {name: _read_back(gp, camera, name, str(value)) for name, value in wanted.items()}


def _set(gp: Any, camera: Any, name: str, value: Any, patiently: Callable[[Callable[[], Any]], None]) -> None:
    widget = find_setting(gp, camera, name)
    widget.set_value(value)
    patiently(lambda: camera.set_single_config(name, widget))


def _checked(gp: Any, camera: Any, name: str, value: str) -> Any:
    """Return ``value`` as the setting takes it."""
    widget = find_setting(gp, camera, name)
    if widget is None:
        raise RefusedError(
            f"setting {name!r} asked, this camera has none of that name; `gphoto2 --list-config` lists them"
        )
    kind, now = widget.get_type(), str(widget.get_value()).strip()
    if kind in (gp.GP_WIDGET_RADIO, gp.GP_WIDGET_MENU):
        choices = list(widget.get_choices())
        if value not in choices:
            raise RefusedError(f"{name} {value!r} asked, this camera has {', '.join(choices)}; choose one of them")
    if widget.get_readonly() and now != value:
        raise RefusedError(f"{name} {value!r} asked, it is {now!r} and only the body can change it; set it there")
    try:
        return float(value) if kind == gp.GP_WIDGET_RANGE else int(value) if kind == gp.GP_WIDGET_TOGGLE else value
    except ValueError:
        raise RefusedError(f"{name} {value!r} asked, it takes a number; correct it in [camera.settings]") from None


def _read_back(gp: Any, camera: Any, name: str, wanted: str) -> str:
    """Return the value once the camera reports it; some do so only a moment later."""
    end_s = time.monotonic() + READ_BACK_S
    while (found := read_setting(gp, camera, name)) != wanted:
        if time.monotonic() > end_s:
            raise RefusedError(
                f"{name} {wanted!r} was set, the camera reports {found!r}; set it on the body, and try again"
            )
        time.sleep(0.1)
    return wanted
