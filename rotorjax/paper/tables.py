"""One function for each table of the paper."""

import math

import numpy as np

from rotorjax.diagnosis.compensation import (
    average_fault,
    value_errors,
)
from rotorjax.diagnosis.fault import Fault
from rotorjax.diagnosis.features import fault_table, feature_covariance, feature_map, inverse_map
from rotorjax.diagnosis.training import rms_errors
from rotorjax.model.rotor import Jeffcott, bearing_stiffness, effective_mass, in_series
from rotorjax.paper.printed import CASES, DIAGNOSED, HALF_DIGIT, INHERENT, PARAMETERS, SPEEDS, printed, rotor
from rotorjax.paper.schemes import figure_10, table_10_11
from rotorjax.paper.sheet import NOT, REBUILT, UNITS, Row, Sheet, Verdict, our_row
from rotorjax.paper.study import FRACTION, Study
from rotorjax.units import GRAM_MILLIMETRE

NOISES = (0.1e-6, 1e-6)
"""Standard errors of the features for which errors are given [m]."""
DISK_MASS, SHAFT_MASS = 0.8, 0.35062
"""Stated in section 2.3.1 [kg]."""

READINGS = (("A (kg m, m)", 1.0, 1.0), ("B (g mm, mm)", 1e6, 1e3), ("C (kg mm, m)", 1e3, 1.0))
"""Units that table 1 may mean: name, and how many of them make one kg m and one m."""


def every(study: Study) -> list[Sheet]:
    """All tables, in the paper's order."""
    sheets = [table_01(study), table_03()]
    sheets += [table_04_05(study, speed) for speed in SPEEDS] + [joint(study), table_06(study), table_07(study)]
    sheets += [table_08_09(study, speed) for speed in SPEEDS] + [table_10_11(study, speed) for speed in SPEEDS]
    return [*sheets, figure_10(study)]


def table_01(study: Study) -> Sheet:
    """Root mean square error of the network on the test cases, under three readings of its units."""
    published, default = (
        rms_errors(net.diagnose, study.test) for net in (study.training_as_published.network, study.networks[SPEEDS[0]])
    )
    data, rows = printed("table01_fnn_rmse"), []
    for reading, unbalance, bow in READINGS:
        for k, row in enumerate(data):
            factor = (unbalance, unbalance, bow, bow)[k]
            unit = reading.split("(")[1].rstrip(")").split(", ")[k // 2]
            value, ours = float(row["rmse"]), float(published[k] * factor)
            pair = slice(k // 2 * 2, k // 2 * 2 + 2)
            together = float(
                np.linalg.norm(published[pair]) * factor / np.linalg.norm([float(r["rmse"]) for r in data[pair]])
            )
            verdict: Verdict = "reproduced" if reading.startswith("C") and 0.5 <= together <= 2.0 else NOT
            reason = _reading_reason(reading[0], row["component"][0], together)
            rows.append(
                Row(
                    reading,
                    row["component"],
                    unit,
                    value,
                    ours,
                    verdict,
                    reason,
                    (float(default[k] * factor), ours / value),
                )
            )
    text = (
        "The paper gives no units. Ours as published: 4-40-4 tanh, Bayesian regularisation, 1000 epochs, one seed "
        "(`make benchmark` has five); "
        f"training stopped because {study.training_as_published.stopped}. Default: whitened inputs and linear least "
        "squares, then evidence steps. "
        "All of these are errors on noise-free features. With noise of 1e-5 of the features' half range even the exact "
        "linear inverse misses U by "
        f"{_noisy_unbalance(study):.2g} g mm: see table 4 for what real sensors allow."
    )
    return Sheet("table_01", "Table 1: error of the network on the test cases", text, ("default", "ratio"), tuple(rows))


def _reading_reason(reading: str, fault: str, ratio: float) -> str:
    """Why a reading is taken or not. ``ratio``: of both components together, since nothing but chance
    tells x from y.
    """
    if reading == "A":
        return "no units are printed; in these, U = 6 g mm could not be measured (error 24 g mm)"
    if reading == "B":
        return "no units are printed; in these, the training described stays a thousand times above"
    return (
        f"no units are printed; in these, the training described gives {ratio:.2f} times {fault}x and {fault}y together"
    )


def _noisy_unbalance(study: Study) -> float:
    """Root mean square error of a component of U [g mm] for noise of 1e-5 of the features' half range, through the
    exact inverse.
    """
    half = np.asarray(study.networks[SPEEDS[0]].inputs.half)
    return float(np.linalg.norm(inverse_map(rotor(), SPEEDS[0])[0] * half) * 1e-5 / GRAM_MILLIMETRE)


def table_03() -> Sheet:
    """The rig's parameters, each from the others."""
    data = {
        row["axis"]: {key: float(value) for key, value in row.items() if key != "axis"}
        for row in printed("table03_rig_parameters")
    }
    rows = []
    for axis, p in data.items():
        shaft, bearing, whole = (1e3 * p[f"K_{part}_kN_per_m"] for part in ("s", "b", "eq"))
        series = float(in_series(shaft, bearing))
        rows.append(_checked(axis, "K_eq", "kN/m", p["K_eq_kN_per_m"], series / 1e3, 6e-4, "K_s and K_b in series"))
        for mass, name in ((p["M_eq_kg"], "printed mass"), (0.9686, "0.9686 kg")):
            wheel = Jeffcott(mass, whole, 0.0)  # pyright: ignore
            omega, critical = math.sqrt(whole / mass), float(wheel.critical_speeds_rpm()[0])
            for what, unit, printed_value, ours, tolerance in (
                ("omega_n", "rad/s", p["omega_n_rad_per_s"], omega, 0.06),
                ("first critical speed", "rpm", p["first_critical_rpm"], critical, 0.6),
            ):
                rows.append(
                    _checked(axis, f"{what}, {name}", unit, printed_value, ours, tolerance, "sqrt(K_eq / M_eq)")
                )
        mass = whole / p["omega_n_rad_per_s"] ** 2
        rows.append(_checked(axis, "M_eq", "kg", p["M_eq_kg"], mass, 6e-3, "K_eq / omega_n²"))
        found = float(bearing_stiffness(critical_speed_rpm=p["first_critical_rpm"], mass=0.9686, shaft_stiffness=shaft))
        how = "from the critical speed, K_s and 0.9686 kg; half an rpm is 0.1 kN/m"
        rows.append(_checked(axis, "K_b", "kN/m", p["K_b_kN_per_m"], found / 1e3, 0.35, how))
    mass = float(effective_mass(DISK_MASS, SHAFT_MASS))
    reason = "0.8 kg and 0.35062 kg of section 2.3.1 rather support 0.9686 kg"
    rows.append(Row("both", "M_eq, disk and 17/35 of the shaft", "kg", 0.96, mass, NOT, reason))
    text = (
        "The printed M_eq = 0.96 kg contradicts the printed natural frequencies and critical speeds; 0.9686 kg "
        "reproduces all four, "
        f"and disk plus 17/35 of the shaft gives {mass:.4f} kg. Everything below uses 0.9686 kg."
    )
    return Sheet("table_03", "Table 3: parameters of the rig, each from the others", text, (), tuple(rows))


def _checked(case: str, parameter: str, unit: str, paper: float, ours: float, tolerance: float, how: str) -> Row:
    verdict: Verdict = "reproduced" if abs(ours - paper) <= tolerance else NOT
    return Row(
        case,
        parameter,
        unit,
        paper,
        ours,
        verdict,
        how if verdict == "reproduced" else f"{how} gives {ours:.6g}: the printed numbers contradict one another",
    )


def standard_errors(faults: np.ndarray, covariance: np.ndarray) -> tuple[float, float, float, float]:
    """Of U [g mm], α [°], s [mm], θ [°]; an angle that is not determined has 180°."""
    unbalance, bow = Fault(faults[:2], covariance[:2, :2]), Fault(faults[2:], covariance[2:, 2:])
    errors = (
        unbalance.standard_error,
        unbalance.angle_standard_error_deg,
        bow.standard_error,
        bow.angle_standard_error_deg,
    )
    assert all(error is not None for error in errors)
    return errors[0] / GRAM_MILLIMETRE, errors[1], errors[2] * 1e3, errors[3]  # pyright: ignore


def table_04_05(study: Study, speed: float) -> Sheet:
    """Diagnosis without compensation at one speed, by least squares and by network, with standard errors."""
    r = study.rebuilt[speed]
    squares = fault_table(r.features @ inverse_map(rotor(), speed).T)
    network = fault_table(study.networks[speed].diagnose(r.features))
    errors = value_errors(r.features @ inverse_map(rotor(), speed).T, r.induced)
    at = [feature_covariance(rotor(), speed, noise) for noise in NOISES]
    rows = []
    for index, row in enumerate(printed(DIAGNOSED[speed])):
        case, k = divmod(index, 4)
        value = float(row["diagnosed"])
        ses = [standard_errors(r.diagnosed[case], covariance)[k] for covariance in at]
        good = abs(squares[case, k] - value) <= HALF_DIGIT
        reason = "" if good else "the printed value and the printed error disagree"
        more = (network[case, k], float(row["error"]), errors[case, k], *ses)
        verdict: Verdict = REBUILT if good else NOT
        case_name, parameter = row["case"], row["parameter"]
        rows.append(Row(case_name, parameter, UNITS[parameter], value, squares[case, k], verdict, reason, more))
    number = 4 if speed == SPEEDS[0] else 5
    u = [standard_errors(r.diagnosed[0], covariance)[0] for covariance in at]
    text = (
        "Features are rebuilt from the printed diagnosis (value and printed error together) with J(Ω), since the raw "
        "signals are not public; that least squares "
        "returns them is a check of the arithmetic, not of the rig. The network is ours, trained on simulated cases. "
        "What matters is on the right: standard errors "
        f"of one reading at {speed:.0f} rpm for features good to 0.1 µm and 1 µm. Of U = {squares[0, 0]:.2g} g mm they "
        f"are {u[0]:.2g} and {u[1]:.2g} g mm, because at one speed an unbalance and a bow differ only by the two axes' "
        "unequal stiffness. `table_04_05_joint` shows what both speeds together allow."
    )
    more = ("network", "paper_error", "our_error", "se_at_0.1_um", "se_at_1_um")
    return Sheet(
        f"table_{number:02d}",
        f"Table {number}: diagnosis at {speed:.0f} rpm without compensation",
        text,
        more,
        tuple(rows),
    )


def joint(study: Study) -> Sheet:
    """The same cases from both speeds jointly."""
    stacked = np.concatenate([study.rebuilt[speed].features for speed in SPEEDS], axis=1)
    inverse, maps = inverse_map(rotor(), SPEEDS), feature_map(rotor(), SPEEDS).reshape(8, 4)
    found = stacked @ inverse.T
    left = np.sqrt(np.mean((stacked - found @ maps.T) ** 2)) * 1e6
    values, errors = fault_table(found), value_errors(found, study.rebuilt[SPEEDS[0]].induced)
    at = [feature_covariance(rotor(), SPEEDS, noise) for noise in NOISES]
    single = [
        standard_errors(study.rebuilt[speed].diagnosed[0], feature_covariance(rotor(), speed, NOISES[0]))
        for speed in SPEEDS
    ]
    ses_joint = standard_errors(found[0], at[0])
    reason = "the paper diagnoses each speed by itself"
    rows = []
    for case, name in enumerate(CASES):
        for k, parameter in enumerate(PARAMETERS):
            ses = tuple(standard_errors(found[case], covariance)[k] for covariance in at)
            rows.append(our_row(name, parameter, values[case, k], reason, (errors[case, k], *ses)))
    text = (
        "Least squares on the rebuilt features of 1500 and 2500 rpm together. The two speeds contradict one another: "
        "what is left is "
        f"{left:.0f} µm rms per feature, far above any sensor's noise, so that no pair of unbalance and bow, inherent "
        "or installed, explains both; least squares puts the contradiction into U, "
        f"{values[:, 0].min():.0f} to {values[:, 0].max():.0f} g mm where 6 or 12 were installed. The standard errors, "
        "from sensor noise "
        f"alone, fall {single[0][0] / ses_joint[0]:.0f}-fold for U and {single[0][2] / ses_joint[2]:.0f}-fold for s "
        f"beside 1500 rpm, {single[1][0] / ses_joint[0]:.1f}- and {single[1][2] / ses_joint[2]:.1f}-fold beside 2500 "
        "rpm; the errors against what was induced do not fall, because here the model fails and not the sensor. "
        "`rotorjax explain` on these vectors says what may be missing."
    )
    return Sheet(
        "table_04_05_joint",
        "Tables 4 and 5 jointly: diagnosis from both speeds",
        text,
        ("error", "se_at_0.1_um", "se_at_1_um"),
        tuple(rows),
    )


def table_06(study: Study) -> Sheet:
    """Self-compensation of the first case at 1500 rpm."""
    r, found, loop = study.rebuilt[SPEEDS[0]], study.compensations[SPEEDS[0]][0], study.loop
    after = study.networks[SPEEDS[0]].diagnose(r.features[0] - found.features)
    values = fault_table(after)
    rows = []
    for k, row in enumerate(printed("table06_self_compensation_1500rpm")):
        value = float(row["diagnosed"])
        good = abs(values[k] - value) <= (0.0351 if UNITS[row["parameter"]] == "degree" else HALF_DIGIT)
        more = (float(row["error"]), 100.0 * float(found.errors[-1, k]))
        reason = "" if good else "the paper stops its loop at 0.1 %"
        verdict: Verdict = REBUILT if good else NOT
        case_name, parameter = row["case"], row["parameter"]
        rows.append(Row(case_name, parameter, UNITS[parameter], value, values[k], verdict, reason, more))
    below = int(np.argmax(np.all(found.errors < 1e-3, axis=1)))
    text = (
        "That the induced values come out is no test of the rig: a root finder returns its target for any inverse. "
        f"Newton's method is below 0.1 % after {below} step and at rounding after {found.steps}; the paper's loop, "
        f"adding {100.0 * FRACTION:.3g} % of the missing correction per iteration, takes {loop.steps} "
        f"as the paper does. The paper prints no size of the increment: {100.0 * FRACTION:.3g} % is the one that needs "
        "38 iterations from table 4's errors. Figure 9 begins "
        "at 0.114-0.136 %, table 4 at 36 %: the loop of figure 9 did not begin at the uncompensated diagnosis (erratum "
        "11)."
    )
    return Sheet(
        "table_06",
        "Table 6: self-compensation of the same-quadrant case at 1500 rpm",
        text,
        ("paper_error_percent", "our_error_percent"),
        tuple(rows),
    )


def _inherent_rows(case: str, row: dict[str, str], faults: np.ndarray, features: np.ndarray) -> list[Row]:
    values = fault_table(faults)
    rows = []
    for k, key in enumerate(("dU", "dalpha_deg", "ds", "dtheta_deg")):
        unit = ("g mm (paper: not stated)", "degree", "mm (paper: not stated)", "degree")[k]
        angle = abs((values[k] - float(row[key]) + 180.0) % 360.0 - 180.0)
        near = k % 2 == 1 and angle < 15.0
        reason = (
            f"within {angle:.0f}°, by chance or not: the magnitude beside it disagrees" if near
            else "the difference diagnosed - induced of the paper's own tables is this; what is printed cannot be had "
                 "from it"
        )  # fmt: skip
        rows.append(Row(case, key, unit, float(row[key]), values[k], NOT, reason))
    for k in range(4):
        signed = f"f{k + 1}" in row
        paper = float(row[f"f{k + 1}" if signed else f"f{k + 1}_abs"])
        ours = float(features[k] if signed else abs(features[k]))
        reason = "J times the inherent fault of the paper's own tables is this" + (
            "" if signed else "; signs were lost in the text, magnitudes are compared"
        )
        rows.append(Row(case, f"f{k + 1}", "m", paper, ours, NOT, reason))
    return rows


def table_07(study: Study) -> Sheet:
    """Inherent fault and features of the first case."""
    found = study.compensations[SPEEDS[0]][0]
    rows = _inherent_rows(CASES[0], printed("table07_inherent_same_quadrant_1500rpm")[0], found.faults, found.features)
    text = (
        "The inherent fault that brings the same-quadrant case to its induced values. Ours is exact for the rebuilt "
        "features; the paper's magnitudes are a hundred times smaller (erratum 9)."
    )
    return Sheet("table_07", "Table 7: inherent fault and features, same quadrant, 1500 rpm", text, (), tuple(rows))


def table_08_09(study: Study, speed: float) -> Sheet:
    """Inherent faults and features of all cases at one speed, and their averages."""
    inherent = study.inherent(speed)
    data = {row["case"]: row for row in printed(INHERENT[speed])}
    rows: list[Row] = []
    number = 8 if speed == SPEEDS[0] else 9
    for k, case in enumerate(CASES):
        rows += _inherent_rows(case, data[case], inherent.faults[k], inherent.features[k])
    averaged = average_fault(inherent.faults, "arithmetic"), np.mean(inherent.features, axis=0)
    rows += _inherent_rows("average", data["average"], *averaged)
    for key in ("dalpha_deg", "dtheta_deg"):
        angles = np.array([float(data[case][key]) for case in CASES])
        mean, name, value = float(np.mean(angles)), "average of the paper's own", float(data["average"][key])
        circular = float(np.degrees(np.angle(np.mean(np.exp(1j * np.radians(angles))))) % 360.0)
        how = "the paper averages angles as numbers"
        rows.append(Row(name, f"{key}, arithmetic", "degree", value, mean, "reproduced", how))
        rows.append(Row(name, f"{key}, circular", "degree", value, circular, "ours", "on the circle"))
    for how in ("circular", "components"):
        values = fault_table(average_fault(inherent.faults, how))
        reason = "average of our inherent faults: " + (
            "angles on the circle, magnitudes apart"
            if how == "circular"
            else "of the components, the only one that is linear"
        )
        rows += [our_row(f"average, {how}", p, values[k], reason) for k, p in enumerate(PARAMETERS)]
    turned = fault_table(inherent.faults)[:, 1]
    text = (
        "Inherent faults case by case, found through the network. An inherent fault of the rotor would be the same in "
        "all four cases; ours, from the paper's own tables, turn with "
        f"the installed unbalance (angles of ΔU from {turned.min():.0f} to {turned.max():.0f}°): what is inherent here "
        "is rather a gain and a phase (erratum 7)."
    )
    return Sheet(
        f"table_{number:02d}", f"Table {number}: inherent faults and features at {speed:.0f} rpm", text, (), tuple(rows)
    )
