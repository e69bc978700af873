"""What one kind of camera needs, as data: where its photos go, which settings are frozen, which must have one value.

Names and values of settings are those of libgphoto2 (``gphoto2 --list-all-config`` prints them for a camera).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from drivers.errors import DeviceNotFoundError


@dataclass(frozen=True, slots=True)
class CameraProfile:
    """One kind of camera.

    Attributes
    ----------
    name
        What a configuration calls it.
    capture_target
        Value of ``capturetarget`` to set and read back; None where a camera has no such choice.
    deletes
        Whether a photo is deleted from the camera once the one after it is asked for. Photos that never were on a card
        are dropped so that memory does not fill.
    watched
        Settings that are recorded with every sweep, as far as this camera has them.
    required
        Settings that a sweep cannot do without, and the values that are right: a photo must not depend on what is in it.
    exposure_margin_s
        How much later than the command to expose, and the exposure's time, the shutter has closed for certain: mirror, shutter
        and the camera's own delay. None where nobody knows; then only the photo's file tells.
    advice
        For a required setting that is wrong: what a person does about it.
    """

    name: str
    capture_target: str | None
    deletes: bool
    watched: tuple[str, ...]
    required: Mapping[str, tuple[str, ...]]
    exposure_margin_s: float | None
    advice: Mapping[str, str] = field(default_factory=dict)


_ADVICE = {
    "focusmode": "set the switch of the lens to MF",
    "autoexposuremode": "turn the mode dial of the body to M",
    "autoexposuremodedial": "turn the mode dial of the body to M",
    "expprogram": "turn the mode dial of the body to M",
    "drivemode": "choose single shots on the body",
    "capturemode": "choose single shots on the body",
    "whitebalance": "choose a fixed white balance in [camera.settings]",
    "iso": "choose a fixed ISO in [camera.settings]",
}
# A mirror reflex camera with its focus set opens its shutter within 0.15 s of the command (release lag); twice that.
_REFLEX_MARGIN_S = 0.3
_FIXED = ("Auto", "Automatic", "Auto ISO")  # what white balance and ISO must not be
_CANON = (
    "autoexposuremode",
    "shutterspeed",
    "aperture",
    "iso",
    "whitebalance",
    "imageformat",
    "focusmode",
    "drivemode",
)

PROFILES: dict[str, CameraProfile] = {
    profile.name: profile
    for profile in (
        CameraProfile(
            name="generic",
            capture_target=None,
            deletes=False,
            watched=("expprogram", "shutterspeed", "f-number", "iso", "whitebalance", "imagequality", "focusmode"),
            required={"expprogram": ("M",), "focusmode": ("Manual", "MF")},
            exposure_margin_s=_REFLEX_MARGIN_S,
            advice=_ADVICE,
        ),
        CameraProfile(
            # EOS 40D, 450D, 1000D, 50D, ...: remote release in one command, photos straight to the host.
            name="canon-eos-40d",
            capture_target="Internal RAM",
            deletes=True,
            watched=_CANON,
            required={"autoexposuremode": ("Manual",), "focusmode": ("Manual",), "drivemode": ("Single",)},
            exposure_margin_s=_REFLEX_MARGIN_S,
            advice=_ADVICE,
        ),
        CameraProfile(
            # EOS from about 2010 on: half press, full press, release. The lens's switch decides about focus; what the
            # body reports is the mode it would use, so that only the values that start no autofocus are right.
            name="canon-eos",
            capture_target="Internal RAM",
            deletes=True,
            watched=(*_CANON, "autoexposuremodedial", "capturetarget"),
            required={
                "autoexposuremode": ("Manual",),
                "focusmode": ("Manual",),
                "drivemode": ("Single", "Single silent", "Single: Silent shooting"),
            },
            exposure_margin_s=_REFLEX_MARGIN_S,
            advice=_ADVICE,
        ),
        CameraProfile(
            name="nikon",
            capture_target="Internal RAM",
            deletes=True,
            watched=(
                "expprogram",
                "shutterspeed",
                "f-number",
                "iso",
                "autoiso",
                "whitebalance",
                "imagequality",
                "focusmode",
                "capturemode",
            ),
            required={
                "expprogram": ("M",),
                "focusmode": ("Manual", "Manual (fixed)", "MF (fixed)", "MF (selection)", "MF"),
                "autoiso": ("Off",),
            },
            exposure_margin_s=None,  # exposure delay and mirror-up modes of these bodies add seconds
            advice=_ADVICE,
        ),
    )
}
# Bodies that know RemoteRelease alone (0x910F) and not RemoteReleaseOn (0x9128).
_EARLY_EOS = (
    "40D",
    "50D",
    "450D",
    "1000D",
    "5D Mark II",
    "1D Mark III",
    "1Ds Mark III",
    "Rebel XSi",
    "Rebel XS",
    "Kiss X2",
)


def profile_named(name: str) -> CameraProfile:
    """Return a profile by its name; raises ``DeviceNotFoundError`` for one that does not exist."""
    if name not in PROFILES:
        raise DeviceNotFoundError(f"camera: profile {name!r} asked, there are {', '.join(PROFILES)}")
    return PROFILES[name]


def profile_of(model: str) -> CameraProfile:
    """Return the profile of a camera by the model that it reports."""
    words = model.lower()
    if "eos" in words:
        early = any(words.endswith(f" {body.lower()}") for body in _EARLY_EOS)
        return PROFILES["canon-eos-40d" if early else "canon-eos"]
    return PROFILES["nikon" if "nikon" in words else "generic"]


def wrong_setting(profile: CameraProfile, settings: Mapping[str, str]) -> str | None:
    """Say in a sentence which setting would spoil a sweep, or return None."""
    for name, right in profile.required.items():
        if name in settings and settings[name] not in right:
            advice = profile.advice.get(name, f"set {name}")
            return f"{name} is {settings[name]!r}, a sweep needs {' or '.join(right)}; {advice}"
    for name in ("whitebalance", "iso"):
        if settings.get(name) in _FIXED:
            return f"{name} is {settings[name]!r}, which changes from photo to photo; {profile.advice[name]}"
    return None
