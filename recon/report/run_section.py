"""How the numbers came about: warnings, devices, parameters, times, versions and hashes."""

from collections.abc import Mapping

from recon.metrics import Metrics
from recon.report.numbers import duration, memory, number
from recon.report.panel import Banner, Panel, Section, Table
from recon.sessions.manifest import Manifest

KINDS = {
    "real": "real",
    "simulated": "simulated in the program",
    "emulated": "emulated: the real driver spoke to a program",
    "unknown": "not recorded",
}


def device_banners(manifest: Manifest) -> tuple[Banner, ...]:
    """Return the line that tells a simulation from a laboratory; none where every device was real."""
    devices = manifest.provenance.devices
    pretended = {name: device.kind for name, device in devices.items() if device.kind in ("simulated", "emulated")}
    unknown = [name for name, device in devices.items() if device.kind == "unknown"]
    if pretended:
        every = len(pretended) == len(devices)
        kinds = sorted(set(pretended.values()))
        names = "; ".join(f"{kind}: {', '.join(n for n, k in pretended.items() if k == kind)}" for kind in kinds)
        return (
            Banner(
                "Simulated session." if every else "Partly simulated session.",
                f"{'No device was real' if every else 'Not every device was real'} ({names}). "
                "These results describe a simulation, not an object in a laboratory.",
                True,
            ),
        )
    if unknown or not devices:
        named = " and ".join(unknown) or "devices"
        return (Banner("Origin not recorded.", f"The session does not say whether its {named} were real.", False),)
    return ()


def devices_panel(manifest: Manifest) -> Panel:
    """Return which devices took part and which of them were real."""
    rows = tuple(
        (name, KINDS[device.kind], device.model, device.version, device.address)
        for name, device in manifest.provenance.devices.items()
    )
    return Panel(
        "devices",
        "Devices",
        "table.html.j2",
        {"table": Table(("Device", "Was", "Model", "Version", "Address"), rows)},
        "What the session says of the devices that took it.",
        "Every device real, with model and version.",
        "Simulated or emulated devices in a session that claims to show a real object.",
        missing="" if rows else "The session names no devices. " + (manifest.provenance.note or ""),
    )


def value_text(value: object) -> str:
    """Write a setting: numbers with six significant digits, lists with commas.

    Examples
    --------
    >>> value_text(0.017453292519943295), value_text(["x", "y"]), value_text(None)
    ('0.0174533', 'x, y', 'none')
    """
    if value is None:
        return "none"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return ", ".join(value_text(part) for part in value)
    return str(value)


def flatten(values: Mapping[str, object], prefix: str = "") -> list[tuple[str, str]]:
    """Return nested settings as rows of a dotted name and a value.

    Examples
    --------
    >>> flatten({"gap": {"limit_mm": 0.5}, "axes": ["x", "y"]})
    [('gap.limit_mm', '0.5'), ('axes', 'x, y')]
    """
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        if isinstance(value, Mapping) and value:
            rows += flatten(value, f"{prefix}{key}.")
        else:
            rows.append((f"{prefix}{key}", value_text(value)))
    return rows


def parameters_panel(metrics: Metrics) -> Panel:
    """Return every parameter: a list, and a table for each kind of settings that comes more than once."""
    alike: dict[tuple[str, ...], list[str]] = {}
    for name, value in metrics.parameters.items():
        if isinstance(value, Mapping) and value and not any(isinstance(part, Mapping) for part in value.values()):
            alike.setdefault(tuple(value), []).append(name)
    repeated = {keys: names for keys, names in alike.items() if len(names) > 1}
    tables = []
    for keys, names in repeated.items():
        rows = []
        for name in names:
            values = metrics.parameters[name]
            assert isinstance(values, Mapping)
            rows.append((name, *(value_text(values[key]) for key in keys)))
        tables.append(Table(("", *keys), tuple(rows), tuple(range(1, len(keys) + 1))))
    in_tables = {name for names in repeated.values() for name in names}
    single = {name: value for name, value in metrics.parameters.items() if name not in in_tables}
    first = Table(("Parameter", "Value"), tuple(flatten({"method": metrics.method} | single)))
    return Panel("parameters", "Parameters", "tables.html.j2", {"tables": (first, *tables)})


def _table_panel(id: str, title: str, headings: tuple[str, ...], rows: list[tuple[str, str]], none: str) -> Panel:
    """Return a plain table of names and values."""
    data = {"table": Table(headings, tuple(rows))}
    return Panel(id, title, "table.html.j2", data, missing="" if rows else none, wide=False)


def stages_panel(metrics: Metrics) -> Panel:
    """Return time and peak memory of each stage as bars."""
    total_s = sum(stage.wall_s for stage in metrics.stages)
    longest_s = max((stage.wall_s for stage in metrics.stages), default=0.0) or 1.0
    largest_mb = max((stage.peak_mb for stage in metrics.stages), default=0.0)
    bars = [
        {
            "name": f"{stage.name} (kept)" if stage.kept else stage.name,
            "time": duration(stage.wall_s),
            "memory": memory(stage.peak_mb),
            "width": 100 * stage.wall_s / longest_s,
            "memory_width": 100 * stage.peak_mb / (largest_mb or 1.0),
        }
        for stage in metrics.stages
    ]
    return Panel(
        "stages",
        "Time and memory",
        "stages.html.j2",
        {"bars": bars, "total": duration(total_s), "largest": memory(largest_mb)},
        f"{number(len(bars))} stages took {duration(total_s)} in all; peak memory is that of the whole program.",
        missing="" if bars else "The run recorded no times.",
    )


def run_section(metrics: Metrics, manifest: Manifest) -> Section:
    """Return the section that lets another person repeat the run."""
    return Section(
        "run",
        "How it was made",
        (
            devices_panel(manifest),
            stages_panel(metrics),
            parameters_panel(metrics),
            _table_panel(
                "versions",
                "Versions",
                ("Software", "Version"),
                [*metrics.versions.items(), *((f"{k} (capture)", v) for k, v in manifest.provenance.software.items())],
                "The run recorded no versions.",
            ),
            _table_panel(
                "hashes",
                "Hashes of inputs",
                ("Input", "Hash"),
                list(metrics.hashes.items()),
                "The run recorded no hashes.",
            ),
        ),
        "Enough to repeat the run and to check that the same files went in.",
    )


def warnings_section(metrics: Metrics) -> Section:
    """Return what the run warned of; it comes right after the verdict."""
    return Section(
        "warnings",
        f"Warnings ({len(metrics.warnings)})",
        (
            Panel(
                "warnings",
                "",
                "warnings.html.j2",
                {"warnings": metrics.warnings},
            ),
        ),
    )
