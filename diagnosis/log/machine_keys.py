"""Keys of a machine file against those that are read: an optional one that is misspelt must not count as 0."""

from collections.abc import Iterator, Mapping
from typing import Any

from diagnosis.log.findings import Finding
from diagnosis.log.nearest import did_you_mean
from machine.marker_sections import BoardSection, MarkerSection

DH_KEYS = ("a_m", "d_m", "alpha_deg", "theta_offset_deg")
VALVE_KEYS = ("velocity_gain_rad_s", "valve_frequency_hz", "valve_damping")
STEREO_CAMERA_KEYS = ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px", "baseline_m")
JOINT_LIMIT_KEYS = {False: ("q_min_deg", "q_max_deg"), True: ("q_min_m", "q_max_m")}  # by whether the joint slides
SPEED_LIMIT_KEYS = (
    "qd_max_deg_s",
    "qdd_max_deg_s2",
    "qd_max_m_s",
    "qdd_max_m_s2",
)  # of the reference; no stage needs them

JOINT_KEYS = (
    *(
        "name",
        "type",
        "dh_convention",
        *DH_KEYS,
        *JOINT_LIMIT_KEYS[False],
        *JOINT_LIMIT_KEYS[True],
        *SPEED_LIMIT_KEYS,
        *VALVE_KEYS,
    ),
    *("kp_frac_per_rad", "pt1_tau_s", "mass_kg", "com_m", "encoder_counts_rev", "park_deg"),
)
#: Sections that are one table, and their keys. Effects and remainders have readers of their own, which refuse.
TABLES: dict[str, tuple[str, ...]] = {
    "machine": ("name", "serial", "gravity_base_m_s2", "tcp_speed_max_m_s"),
    "urdf": ("file", "base_link", "tip_link"),
    "tool": ("T_flange_tcp", "T_tcp_tool"),
    "camera": (*STEREO_CAMERA_KEYS, "distortion", "rate_hz", "rectified", "T_tcp_cam_left"),
    "markers": ("dictionary", "marker", "board"),
    "plc": ("cycle_s", "log_cycle_s", "transport_delay_s"),
    "tracker": ("T_base_tracker",),
    "sensors": ("tracker_m", "static_m", "corners_px", "encoders_rad", "layout_m"),
}
SECTION_NAMES = (*TABLES, "joint", "points", "effect", "remainder")
POINT_KEYS = ("joint", "xyz_m")


def unknown_keys(tables: Mapping[str, Any]) -> list[Finding]:
    """Sections and keys that are not read, each once with all its places, and the known one that may be meant.

    A key of a user's own is a note; one that nearly has a known name may be that one, and is a problem.
    """
    found: dict[tuple[str, str], list[str]] = {}
    known_of: dict[tuple[str, str], tuple[str, ...]] = {}
    for section, place, table, known in _sections_with_known_keys(tables):
        for key in table:
            if key not in known:
                found.setdefault((section, key), []).append(place)
                known_of[section, key] = known
    return [
        _unknown_key_finding(section, key, places, known_of[section, key]) for (section, key), places in found.items()
    ]


def _unknown_key_finding(section: str, key: str, places: list[str], known: tuple[str, ...]) -> Finding:
    at = " ".join([section, ", ".join(place for place in places if place)]).strip()
    what = f"{at}: key {key!r}" if section else f"section [{key}]"
    meant = did_you_mean(key, known)
    severity = "problem" if meant else "note"
    return Finding("unknown_key", severity, "machine.toml", f"{what} is not known and was not read{meant}", len(places))


def _sections_with_known_keys(
    tables: Mapping[str, Any],
) -> Iterator[tuple[str, str, Mapping[str, Any], tuple[str, ...]]]:
    """Section, which one of it, its table, the keys that are read; what is not a table is reported where it is read."""
    yield "", "", tables, SECTION_NAMES
    for section, known in TABLES.items():
        if isinstance(table := tables.get(section), dict):
            yield f"[{section}]", "", table, known
    markers = tables.get("markers")
    lists = [("[[joint]]", tables.get("joint"), JOINT_KEYS)]
    if isinstance(markers, dict):
        lists += [
            ("[[markers.marker]]", markers.get("marker"), tuple(MarkerSection.model_fields)),
            ("[[markers.board]]", markers.get("board"), tuple(BoardSection.model_fields)),
        ]
    for section, several, known in lists:
        for number, table in enumerate(several if isinstance(several, list) else [], start=1):
            if isinstance(table, dict):
                yield section, str(number), table, known
    points = tables.get("points")
    for name, table in points.items() if isinstance(points, dict) else ():
        if isinstance(table, dict):
            yield "[points]", name, table, POINT_KEYS


def limits_of_other_kind(joints: list[dict[str, Any]], sliding: tuple[bool, ...]) -> list[Finding]:
    """Limits in deg of joints that slide, or in m of joints that turn: they are not read, and stand for none."""
    findings = []
    for number, (joint, slides) in enumerate(zip(joints, sliding, strict=False), start=1):
        odd = [key for key in JOINT_LIMIT_KEYS[not slides] if key in joint]
        if odd:
            does, wanted = ("slides", "m") if slides else ("turns", "deg")
            text = (
                f"joint {number} ({joint.get('name', '?')}) {does}: {', '.join(odd)} was not read; give it in {wanted}"
            )
            findings.append(Finding("unknown_key", "problem", "machine.toml", text, len(odd)))
    return findings
