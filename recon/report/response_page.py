"""Write the report page of a display's response: verdict first, then one panel a measurement."""

from pathlib import Path

from recon.calibration.errors import CalibrationError
from recon.calibration.response_record import ResponseRecord
from recon.metrics import Verdict
from recon.report.numbers import NOTHING, number
from recon.report.page import render_page
from recon.report.panel import Banner, Panel, Section, Table
from recon.report.response_section import response_section
from recon.sessions.disk import write_fault

RESPONSE_PAGE_NAME = "response.html"


def response_verdict(response: ResponseRecord) -> Verdict:
    """Return pass where all was measured and nothing needs a remedy, fail where there is not even a response, else check."""
    if response.levels is None:
        return Verdict(
            grade="fail",
            reasons=(f"No response was measured: {response.left_out.get('levels', 'no levels were photographed')}",),
            next_action="mend what is named and measure again with `rig calibrate response`.",
        )
    missing = tuple(f"Not measured: {name}. {why}" for name, why in response.left_out.items())
    reasons = (*response.warnings, *missing)
    if not reasons:
        return Verdict(grade="pass", reasons=(), next_action="capture; nothing about the display stands in the way.")
    action = (
        "follow the remedies above, then measure again." if response.warnings else "capture, knowing what is not known."
    )
    return Verdict(grade="check", reasons=reasons, next_action=action)


def response_tiles(response: ResponseRecord) -> tuple[tuple[str, str, str], ...]:
    """Return the few numbers that an operator looks for first."""
    levels, latency, flicker, drift = response.levels, response.latency, response.flicker, response.drift
    flickers = flicker is not None and flicker.frequency_hz is not None
    return (
        ("Gamma", number(levels.gamma) if levels else NOTHING, f"± {number(levels.gamma_sd, 2)}" if levels else ""),
        (
            "Latency",
            f"{number(1000 * latency.latency_s)} ms" if latency else NOTHING,
            f"± {number(1000 * latency.latency_sd_s, 2)} ms, from the command" if latency else "",
        ),
        (
            "Flicker",
            f"{number(flicker.frequency_hz)} Hz" if flicker and flickers else ("none" if flicker else NOTHING),
            f"± {number(flicker.frequency_sd_hz, 2)} Hz, {number(100 * flicker.depth)} % deep"
            if flicker and flickers
            else "",
        ),
        (
            "Drift",
            f"{number(100 * drift.per_min, 2)} %" if drift else NOTHING,
            f"± {number(100 * drift.per_min_sd, 2)} % a minute" if drift else "",
        ),
    )


def provenance_section(response: ResponseRecord) -> Section:
    """Return which devices, settings, versions and photos the numbers come from."""
    rows = [
        (f"Device: {name}", f"{each.model} ({each.kind}) {each.address}".strip())
        for name, each in response.devices.items()
    ]
    rows += [(f"Setting: {name}", value) for name, value in response.settings.items()]
    rows += [(f"Version: {name}", value) for name, value in response.software.items()]
    rows.append(("Photos", f"{len(response.photos)}, with their hashes in response.json"))
    panel = Panel(
        "provenance",
        "Devices, settings and photos",
        "table.html.j2",
        {"table": Table(("What", "Which"), tuple(rows))},
        "A response belongs to these devices and settings; after a change of any of them it is measured again.",
        "The devices and settings of the captures that it is used for.",
        "Another brightness, picture mode or aperture than the captures have.",
    )
    return Section("provenance", "Where it comes from", (panel,))


def write_response_page(path: Path, response: ResponseRecord) -> None:
    """Write the page; raises ``CalibrationError`` where that cannot be done."""
    simulated = sorted({each.kind for each in response.devices.values()} - {"real"})
    banners: tuple[Banner, ...] = ()
    if simulated:
        banners = (Banner("Not a real rig.", f"Devices were {' and '.join(simulated)}.", True),)
    page = render_page(
        response.name,
        kind="Display response",
        subtitle=f"measured {response.created[:16].replace('T', ', ')} UTC",
        sections=(response_section(response), provenance_section(response)),
        banners=banners,
        verdict=response_verdict(response),
        tiles=response_tiles(response),
    )
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise CalibrationError(write_fault(path, error)) from error
