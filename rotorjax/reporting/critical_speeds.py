"""What people read of critical speeds, separation margins and stability."""

from typing import Any

from rotorjax.diagnosis.critical_speeds import CriticalSpeed, whirl_in_words
from rotorjax.diagnosis.lateral import BEYOND, STABLE, Lateral, SeparationMargin, SpeedRange
from rotorjax.discovery.story import Story
from rotorjax.reporting.tables import Table, number
from rotorjax.reporting.wording import opening

HEADERS = ["model", "rpm", "damping ratio %", "log. decrement", "amplification factor", "from", "whirl"]
MARGIN = {"operating": "separation margin", "measured": "from the speeds measured"}
"""Head of the column of distances, by what they are counted from."""
FAR = 100.0
"""Separation in percent, above the speeds, from which on it is told as a ratio."""


def critical_speeds_lines(story: Story, *, explains: bool = True) -> list[str]:
    """Critical speeds with what was added, and as declared where they differ; then stability, where it is at stake.

    **Arguments:** ``explains``: whether what was added leaves no more than the noise.
    """
    after, before = story.lateral, story.lateral_declared
    differs = story.changed and _sentence(after) != _sentence(before)
    lines = [
        f"Critical speeds: {_sentence(after)}{f'; as declared {_sentence(before, short=True)}' if differs else ''}."
    ]
    if line := _stability_line(after):
        lines.append(line if explains else f"{line[:-1]}, with what was added, which does not explain the data.")
    return lines


def _sentence(found: Lateral, *, short: bool = False) -> str:
    """Critical speeds in a sentence. **Arguments:** ``short``: with the damping ratio alone."""
    if found.critical_speeds is None:
        return "not computed, as the model has an effect that mass, damping and stiffness matrices cannot express"
    if not found.critical_speeds:
        return "none, for the damping is too strong for a peak (damping ratio above 71 %)"
    told = [
        f"{one.speed_rpm:.0f} rpm ({', '.join(_facts(one, found)[: 1 if short else None])})"
        for one in found.critical_speeds
    ]
    return " and ".join([", ".join(told[:-1]), told[-1]] if len(told) > 1 else told)


def _facts(one: CriticalSpeed, found: Lateral) -> list[str]:
    """Damping, and the distance from the speeds where it is outside, or where they are operating speeds."""
    known = found.damping_known(one)
    facts = [f"damping ratio {number(100.0 * one.damping_ratio)} %" if known else "damping ratio not determined"]
    if known and one.damping_ratio < 0.0:
        return ["it grows there: no critical speed to pass"]
    if known and one.amplification is not None:
        facts.append(f"amplification factor {number(one.amplification)}")
    margin, kind = found.margin(one), found.speeds.kind
    if margin.side != "inside":
        needed = f", {margin.needed_percent:.0f} % needed" if kind == "operating" else ""
        facts.append(f"{_apart(margin)} the {kind} speeds{needed}")
    elif kind == "operating":
        facts.append("inside the operating speeds")
    return facts


def _apart(margin: SeparationMargin) -> str:
    """How far outside."""
    if margin.percent < FAR:
        return f"{number(margin.percent, 2)} % {margin.side}"
    return f"{number(1.0 + margin.percent / 100.0, 2)} times"


def _range(speeds: SpeedRange) -> str:
    highest = f" to {speeds.high_rpm:.0f}" if speeds.high_rpm > speeds.low_rpm else ""
    return f"the {speeds.kind} {speeds.low_rpm:.0f}{highest} rpm"


def _stability_line(found: Lateral) -> str:
    """The stability margin where something drives whirl, and where the rotor is unstable."""
    least, speeds = found.stability, found.speeds
    if least is None or (least.onset_rpm is None and not found.self_excited):
        return ""
    if found.open_axes:
        return f"Stability: {_least(found)}."
    decrement = f"logarithmic decrement {number(least.log_decrement)} at {least.speed_rpm:.0f} rpm"
    if least.onset_rpm is None:
        low = speeds.kind == "operating" and least.log_decrement < STABLE
        asked = f"; API 617 asks for {STABLE:g}" if low else ""
        return f"Least {decrement} in {_range(speeds)}{asked}."
    if least.onset_rpm <= speeds.low_rpm:
        return f"Unstable from the lowest of {_range(speeds)} on: {decrement}."
    beyond = f", above {_range(speeds)}, if what was found grows on as there"
    where = "" if least.onset_rpm <= speeds.high_rpm else beyond
    return f"Unstable from {least.onset_rpm:.0f} rpm on{where}: {decrement}."


def critical_speeds_table(story: Story) -> Table | None:
    """Every critical speed, as declared and with what was added; none where there are none."""
    models = [("as declared", story.lateral_declared)]
    models += [("with what was added", story.lateral)] if story.changed else []
    every = [(name, found, one) for name, found in models for one in found.critical_speeds or ()]
    if not every:
        return None
    probes = next((list(one.amplitude_um) for *_, one in every if one.amplitude_um), [])
    rows = [[name, *_row(one, found, probes)] for name, found, one in every]
    apart = any(found.margin(one).side != "inside" for _, found, one in every)
    notes = [
        *(f"Stability {name}: {_least(m)}." for name, m in models if m.stability is not None),
        _margin_note(story.lateral.speeds) if apart else "",
        "Amplification factor from the half-power width; where another mode is near, from the damping ratio: 1/(2ζ).",
        "Amplitudes at 1X, zero-to-peak, with nothing installed." if probes else "",
        "Nonlinear and time-periodic forces are left out." if story.lateral.linearised else "",
    ]
    margin = MARGIN[story.lateral.speeds.kind]
    headers = [*HEADERS, *(f"{probe} µm" for probe in probes), margin]
    spare = ["from", "log. decrement", "whirl", margin, "amplification factor"]
    return Table("Critical speeds", headers, rows, "\n".join(filter(None, notes)), spare=spare)


def _margin_note(speeds: SpeedRange) -> str:
    asked = "; in brackets what API 617 asks for" if speeds.kind == "operating" else ""
    return f"{opening(MARGIN[speeds.kind])}: distance from {_range(speeds)}{asked}."


def _row(one: CriticalSpeed, found: Lateral, probes: list[str]) -> list[str]:
    margin = found.margin(one)
    known = found.damping_known(one)
    operating = found.speeds.kind == "operating"
    needed = f" ({margin.needed_percent:.0f} %)" if known and operating else ""
    apart = "inside" if margin.side == "inside" else f"{_apart(margin)}{needed}"
    sizes = one.amplitude_um or {}
    damping = [
        number(100.0 * one.damping_ratio),
        number(one.log_decrement),
        number(one.amplification),
        "" if one.amplification is None else "width" if one.from_width else "ζ",
    ]
    return [
        f"{one.speed_rpm:.0f}",
        *(damping if known else ["not determined", "-", "-", ""]),
        whirl_in_words(one.direction_deg, one.axis_ratio),
        *(number(sizes.get(probe)) if known else "-" for probe in probes),
        "grows" if known and one.damping_ratio < 0.0 else apart,
    ]


def _least(found: Lateral) -> str:
    least, speeds = found.stability, found.speeds
    if least is None or found.open_axes:
        return "not determined, as the data leave the damping open"
    onset = (
        f"unstable from {least.onset_rpm:.0f} rpm on"
        if least.onset_rpm is not None
        else f"no mode grows up to {BEYOND * speeds.high_rpm:.0f} rpm, where the search ends"
    )
    return f"least logarithmic decrement {number(least.log_decrement)} at {least.speed_rpm:.0f} rpm, {onset}"


def critical_speeds_json(story: Story) -> dict[str, list[dict[str, Any]] | None]:
    """Critical speeds as declared and with what was added; null where they are not known."""
    return {"before": _speeds_json(story.lateral_declared), "after": _speeds_json(story.lateral)}


def _speeds_json(found: Lateral) -> list[dict[str, Any]]:
    return [
        {
            "speed_rpm": one.speed_rpm,
            "amplification_factor": one.amplification,
            "amplification_from": "half-power width" if one.from_width else "damping ratio",
            "damping_ratio": one.damping_ratio,
            "damping_determined": found.damping_known(one),
            "log_decrement": one.log_decrement,
            "whirl": one.whirl,
            "direction_deg": one.direction_deg,
            "amplitude_um": one.amplitude_um,
            "separation_margin": (margin := found.margin(one)).side,
            "separation_margin_percent": margin.percent,
            "separation_margin_needed_percent": margin.needed_percent,
        }
        for one in found.critical_speeds or ()
    ]


def stability_json(story: Story) -> dict[str, Any]:
    """The least stable mode as declared and with what was added, and the speeds looked at."""
    speeds = story.lateral.speeds
    least = {"before": story.lateral_declared.stability, "after": story.lateral.stability}
    return {
        "speeds": speeds.kind,
        "speed_range_rpm": [speeds.low_rpm, speeds.high_rpm],
        **{when: None if one is None else one._asdict() for when, one in least.items()},
    }
