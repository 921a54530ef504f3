"""What the field calls the effects of the catalogue: nearest names by meaning. Needs no JAX."""

import re
from collections.abc import Iterable

from rotorjax.data.section import close_to, nearest

SYNONYMS: dict[str, tuple[str, ...]] = {
    "residual_unbalance": (
        "unbalance", "imbalance", "out of balance", "mass eccentricity", "heavy spot", "lost blade", "thrown blade",
        "deposit", "fouling", "loss of balance weight", "balancing", "inherent unbalance", "initial unbalance",
    ),
    "residual_bow": ("bow", "bent shaft", "bent rotor", "permanent bow", "initial bow", "warped rotor"),
    "thermal_bow": (
        "hot spot", "thermal bend", "thermal unbalance", "thermally induced bow", "temporary bow", "hot bow",
    ),
    "misalignment": (
        "coupling misalignment", "angular misalignment", "parallel offset", "shaft alignment", "coupling offset",
        "alignment error", "coupling lock-up",
    ),
    "plane_participation": ("mode shape", "plane sensitivity", "weight at the wrong plane", "balancing plane", "lever"),
    "sweep_rate": (
        "run-up rate", "coast-down", "startup", "shutdown", "acceleration", "transient", "beat after resonance", "ramp",
    ),
    "stiffness_error": (
        "wrong stiffness", "critical speed", "critical speed off", "natural frequency off", "resonance off",
        "bearing stiffness", "soft bearing", "stiff bearing", "Young's modulus", "shaft too soft", "worn bearing",
    ),
    "mass_error": ("wrong mass", "modal mass", "effective mass", "added mass", "disk mass", "fluid inertia"),
    "damping_error": ("wrong damping", "damping ratio", "amplification factor off", "Q factor", "log decrement"),
    "stiffness_axes": (
        "principal axes", "split resonance axes", "coupled axes", "tilted bearing axes", "stiffness cross terms",
    ),
    "cross_coupling": (
        "oil whirl", "oil whip", "whip", "fluid whirl", "steam whirl", "seal", "labyrinth seal", "Alford force",
        "Thomas force", "cross-coupled stiffness", "Black-Thomas", "aerodynamic cross-coupling", "forward whirl",
        "swirl", "oil film", "fluid film", "impeller force", "fluid-induced instability", "journal bearing force",
    ),
    "speed_dependent_stiffness": (
        "hydrodynamic stiffening", "Lomakin effect", "seal stiffness", "centrifugal stiffening",
        "bearing stiffness over speed", "ball bearing spin",
    ),
    "speed_dependent_damping": (
        "structural damping", "hysteretic damping", "loss factor", "material damping", "rubber mount",
        "damping over speed", "bearing damping over speed", "oil film", "fluid film",
        "journal bearing", "plain bearing",
    ),
    "speed_dependent_cross_coupling": (
        "annular seal", "pump seal", "wear ring", "balance piston", "seal whirl", "impeller-volute interaction",
        "swirl", "seal",
    ),
    "internal_damping": (
        "rotating damping", "hysteresis", "material damping", "shrink fit friction", "loose fit",
        "spline friction", "internal friction", "hysteresis whirl", "oil film", "fluid film", "journal bearing",
        "plain bearing",
    ),
    "foundation": (
        "soft foot", "loose foundation", "soft foundation", "pedestal", "pedestal resonance", "frame resonance",
        "support resonance", "loose bolts", "looseness", "baseplate", "flexible support", "cracked grout",
    ),
    "gyroscopic": ("overhung rotor", "overhung disk", "tilting disk", "Campbell splitting", "polar inertia"),
    "duffing": (
        "hardening spring", "softening spring", "cubic stiffness", "jump phenomenon", "nonlinear stiffness",
        "nonlinear spring", "jump",
    ),
    "clearance": (
        "bearing play", "play", "looseness", "loose bearing", "backlash", "dead band", "gap", "bearing clearance",
        "retainer bearing", "touchdown bearing", "snubber", "loose pedestal",
    ),
    "rub": (
        "rotor rub", "seal rub", "blade rub", "contact", "stator contact", "dry whip", "backward whirl", "annular rub",
        "light rub", "rubbing",
    ),
    "crack": ("cracked shaft", "breathing crack", "transverse crack", "fatigue crack", "shaft crack"),
    "asymmetric_shaft": (
        "keyway", "two-pole rotor", "two-pole", "anisotropic shaft", "dissymmetric shaft", "flat on the shaft",
        "unequal shaft stiffness", "twice per turn by gravity", "gravity critical", "generator rotor slots",
    ),
    "quadratic_damping": ("squeeze film damper", "turbulent damping", "fluid drag", "velocity squared damping"),
    "coulomb_friction": ("dry friction", "stick-slip", "stiction", "friction damper", "sliding friction"),
    "probe_gain": (
        "probe sensitivity", "scale factor", "calibration", "probe calibration", "sensor gain", "proximitor",
        "wrong sensitivity", "mV per mil", "millivolt per micrometre", "target material",
    ),
    "chain_gain": (
        "amplifier", "filter gain", "wrong units", "peak-to-peak", "rms", "conditioner", "integrator", "unit mix-up",
        "mils", "measuring chain",
    ),
    "probe_angle": (
        "probe orientation", "probe mounting", "probe direction", "rotated probe", "swapped probes",
        "exchanged probes", "probes interchanged", "reversed probe", "wrong mounting angle",
    ),
    "phase_reference_offset": (
        "keyphasor", "keyphasor offset", "key phasor", "once per turn", "tachometer offset", "trigger offset",
        "phase offset", "phase error", "tacho", "timing mark", "reference mark", "zero mark",
    ),
    "time_delay": ("filter delay", "latency", "late signal", "sampling skew", "multiplexer delay", "delay"),
    "runout": (
        "glitch", "electrical runout", "mechanical runout", "slow roll", "scratch", "out of round",
        "residual magnetism",
    ),
    "probe_saturation": ("clipping", "overrange", "range of the probe", "flattened waveform", "saturated sensor"),
    "speed_error": ("wrong speed", "tachometer ratio", "speed ratio", "rpm error", "wrong rpm", "pulses per turn"),
}  # fmt: skip
"""Effect -> everyday and textbook words for it."""
_SURE = 0.75
"""Likeness of spelling from which a name is a misspelling rather than another word."""
_ALIKE = 0.5
"""Likeness from which a name is worth a suggestion where nothing has its meaning."""
_MOST = 3
"""Effects that a message names."""


def words_of(text: str) -> frozenset[str]:
    """Words of a name or a phrase, small letters, singular."""
    words = re.findall(r"[^\W_]+", text.lower())
    return frozenset(w[:-1] if len(w) > 3 and w.endswith("s") and not w.endswith("ss") else w for w in words)


def meant_by(name: str, known: Iterable[str]) -> dict[str, str]:
    """Effects that a name stands for elsewhere, each with the synonym that says so: those with the very words, or else
    those with a synonym that has all words of the name or only such.
    """
    asked, allowed = words_of(name), set(known)
    every = [(effect, synonym) for effect, own in SYNONYMS.items() if effect in allowed for synonym in own]
    same = {effect: synonym for effect, synonym in reversed(every) if words_of(synonym) == asked}
    near = {e: s for e, s in reversed(every) if asked and (asked <= words_of(s) or words_of(s) <= asked)}
    found = same or near
    return {effect: found[effect] for effect in SYNONYMS if effect in found}


def misspelt(name: str, known: Iterable[str]) -> bool:
    """Whether a name is spelled much like a known one, or is the beginning of one."""
    names = list(known)
    return bool(close_to(name, names, _SURE)) or any(other.startswith(name.lower()) for other in names if name)


def nearest_effect(name: str, known: Iterable[str]) -> str:
    """The end of a message about an unknown effect: nearest by spelling if that is near, or by meaning."""
    names = list(known)
    meant = {} if misspelt(name, names) else meant_by(name, names)
    if not meant:
        return nearest(name, names) if close_to(name, names, _ALIKE) else "`rotorjax effects` lists those there are"
    told = [f"{effect!r} ({synonym})" for effect, synonym in meant.items()]
    more = f" `rotorjax effects {'_'.join(name.split())}` lists all." if len(told) > _MOST else ""
    return f"did you mean {' or '.join(told[:_MOST])}?{more}"
