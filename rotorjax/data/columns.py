"""Columns of a measurement table in other units or under other names: what to do about them. Nothing is converted."""

import re
from collections.abc import Sequence

from rotorjax.data.measurement import Row

_LENGTHS = (
    (r"_mils?_", "is in mils: multiply it by 25.4 (1 mil = 25.4 µm)"),
    (r"_(in|inch|inches)_", "is in inches: multiply it by 25400"),
    (r"_mm_", "is in millimetres: multiply it by 1000"),
    (r"_nm_", "is in nanometres: divide it by 1000"),
    (r"_(m|metres?|meters?)_", "is in metres: multiply it by 1e6"),
)
_VELOCITY = "is a velocity: divide it by order × 2π × speed_rpm / 60 for the displacement, and bring it to µm"
_ACCELERATION = (
    "is an acceleration: divide it by (order × 2π × speed_rpm / 60)² for the displacement, and bring it to µm"
)
_MOTIONS = (
    (r"_(mm|in|um|m|µm)_(per_)?s(ec)?_|_vel(ocity)?_|_ips_", _VELOCITY),
    (r"_g_|_accel(eration)?_|_(m|mm)_(per_)?s2_", _ACCELERATION),
)
_PEAKS = (
    (
        r"_(pp|pkpk|ptp|p2p|pk_pk|p_p|peak_(to_)?peak|peak2peak)_",
        'is peak-to-peak: write [convention] amplitude = "peak-to-peak" in the rig file',
    ),
    (r"_rms_", 'is an rms value: write [convention] amplitude = "rms" in the rig file'),
    (r"_(0p|0pk|op|0_pk|zero_(to_)?peak|pk|peak)_", "is zero-to-peak, as it is read"),
)
_PHASES = (
    (r"_rad(ians?)?_", "is in radians: multiply it by 57.29578"),
    (r"_(lag|lagging)_", 'lags: write [convention] phase = "lag" in the rig file'),
    (r"_deg(rees?)?_", "is in degrees, as it is read"),
)
_SPEEDS = (
    (r"_rad_(per_)?s(ec)?_|_omega_", "is in rad/s: multiply it by 9.549297"),
    (r"_(hz|rps|rev_(per_)?s(ec)?|cps)_", "is in turns per second: multiply it by 60 (1 Hz = 60 rpm)"),
    (r"_krpm_", "is in thousands of rpm: multiply it by 1000"),
    (r"_rpm_", "is in rpm, as it is read"),
)
_QUANTITIES = (
    ("phase_deg", r"phase|_phi_|angle", (_PHASES,)),
    ("speed_rpm", r"speed|rpm|freq|omega|_hz_|_rev_", (_SPEEDS,)),
    ("sigma_um", r"sigma|_std|error|uncert", (_LENGTHS, _PEAKS)),
    ("amplitude_um", r"amp|disp|vib|magn|_vel|_acc|_mils?_|_ips_", (_MOTIONS, _LENGTHS, _PEAKS)),
)
"""Column -> what its name looks like otherwise, and groups of units of which each may add a sentence."""
_OTHER_NAMES = (
    ("probe", r"_(sensor|transducer|channel|pickup|location|measuring_point)_"),
    ("order", r"_(harmonic|multiple|nx|component)_"),
    ("run", r"_(case|test|trial|condition|measurement|record)_"),
)
SMALL_UM = 1e-2
"""Amplitude below which no probe in micrometres reads."""
SLOW_RPM = 200.0
"""Speed below which vectors are seldom taken."""
FEW = 4
"""Rows from which small phases look like radians."""
TURN = 6.2832


def hint(name: str, absent: Sequence[str]) -> tuple[str, str] | None:
    """The absent column that a name in the header stands for, and what to do; none where nothing is known of it."""
    plain = f"_{re.sub(r'[^a-z0-9µ]+', '_', name.lower().replace('μ', 'µ')).strip('_')}_"
    for column, looks, groups in _QUANTITIES:
        if column in absent and re.search(looks, plain):
            told = [next((cure for unit, cure in group if re.search(unit, plain)), "") for group in groups]
            # A velocity in mm/s is no length in mm.
            told = told[:1] if column == "amplitude_um" and told[0] else told
            if cures := [cure for cure in told if cure]:
                return column, f"{', and '.join(cures)}; then call the column {column!r}"
    for column, looks in _OTHER_NAMES:
        if column in absent and re.search(looks, plain):
            return column, f"is not a name that is read; call it {column!r}"
    return None


def suspicious(rows: Sequence[Row]) -> list[str]:
    """Notes on values that look like other units. They are read as they are."""
    notes = []
    amplitudes, speeds = [row.amplitude_um for row in rows], [row.speed_rpm for row in rows]
    if 0.0 < max(amplitudes, default=0.0) < SMALL_UM:
        notes.append(
            f"every amplitude_um is below {SMALL_UM:g} µm: if they are in mm multiply them by 1000, if in m by 1e6; "
            "read as µm"
        )
    if 0.0 < max(speeds, default=0.0) < SLOW_RPM:
        notes.append(
            f"every speed_rpm is below {SLOW_RPM:g} rpm: if they are in Hz multiply them by 60, if in rad/s by 9.549; "
            "read as rpm"
        )
    noise = sorted(row.sigma_um for row in rows if row.sigma_um is not None)
    if noise and 0.0 < max(amplitudes) < noise[len(noise) // 2]:
        notes.append(
            f"most of sigma_um is larger than the largest amplitude_um, {max(amplitudes):g} µm, so that nothing can be "
            "told from noise: check its unit; read as µm"
        )
    read: dict[tuple[str, str], list[float]] = {}
    for row in rows:
        read.setdefault((row.run, row.probe), []).append(row.amplitude_um)
    dead = [f"{probe} in run {run}" for (run, probe), sizes in read.items() if len(sizes) > 1 and not any(sizes)]
    if dead and max(amplitudes) > 0.0:
        notes.append(
            f"every amplitude_um is zero of probe {', '.join(dead)}: if it delivered nothing, leave those rows out; "
            "read as no vibration"
        )
    phases = {row.phase_deg for row in rows}
    if len(phases) > FEW and all(abs(p) <= TURN for p in phases) and any(p % 1.0 for p in phases):
        notes.append(
            "every phase_deg is between -2π and 2π: if they are in radians multiply them by 57.29578; read as degrees"
        )
    return notes
