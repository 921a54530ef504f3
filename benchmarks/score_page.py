"""Scores as a page in Markdown with pictures, every miss listed."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import tabulate

from scoring import (
    CERTAIN,
    CONFIDENT,
    SEEN,
    Rate,
    Row,
    by_decade,
    by_effect,
    calibration,
    confusion,
    held_out_ratios,
    hidden,
    is_confident_wrong,
    is_right,
    judged,
    mean_set,
    rates,
    search_missed,
    weakest,
    with_others_fitted,
)

mpl.use("Agg")
import matplotlib.pyplot as plt

BANDS = (0.0, 0.9, 0.95, 0.98, 1.1)
"""Of the probability of an answer."""


def write_page(rows: Sequence[Row], folder: Path, about: Mapping[str, Any]) -> str:
    """Write ``README.md``, ``confusion.png``, ``reliability.png`` and ``decades.png``. **Returns** the table of
    rates.
    """
    draw_confusion(rows, folder / "confusion.png")
    draw_reliability(rows, folder / "reliability.png")
    draw_decades(rows, folder / "decades.png")
    summary = f"{rates_table(rows)}\n\n{_numbers(rows)}"
    listed = "\n".join(f"- {key}: {value}" for key, value in about.items())
    oracle = (
        "*Oracle*: the answer, or the truth, fitted from its true values, where that is more probable in the same race "
        "(ties: less than 3 behind). *Others fitted*: what an effect improves once the parameters of all others are "
        "fitted anew without it."
    )
    explained = (
        "*ECE*: expected calibration error; in brackets what as many probabilities that are exactly right would show "
        "in the mean. *Error held out*: of right answers, over the noise and the tolerance of the model's form. "
        "*Readings proposed*: taken on the rotor, and the table with them explained anew."
    )
    parts = [
        "# Effects hidden in a detailed rotor, explained",
        f"{len(rows)} cases. *Seen* is what improves chi-square by more than {SEEN:g}.\n\n{listed}",
        f"## Scores\n\n{summary}\n\n{oracle} {explained}",
        f"## By improvement in chi-square\n\n{_by(by_decade(rows), 'improvement')}\n\n![by decade](decades.png)",
        f"## By effect, alone and seen\n\n{_by(by_effect(rows), 'effect')}\n\n![confusion](confusion.png)",
        f"## Calibration\n\n{_by_probability(rows)}\n\n![reliability](reliability.png)",
        f"## Confident and wrong\n\n{_cases([row for row in rows if is_confident_wrong(row)])}",
        f"## Other misses\n\n{_cases([r for r in rows if _missed(r)])}",
        f"## More probable than the answer, and not found\n\n{_cases(search_missed(rows))}",
    ]
    (folder / "README.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    return summary


def _missed(row: Row) -> bool:
    in_catalogue = row["outside"] is None and not is_right(row)
    return in_catalogue and not is_confident_wrong(row) and weakest(row) > SEEN


def _share(r: Rate) -> list[str]:
    if r.share is None:
        return ["", "0", ""]
    low, high = r.interval()
    return [f"{r.share:.3f}", f"{r.count} of {r.total}", f"{low:.3f} to {high:.3f}"]


def _table(rows: Sequence[Sequence[Any]], heads: Sequence[str]) -> str:
    return tabulate.tabulate(rows, heads, tablefmt="pipe", disable_numparse=True)


def rates_table(rows: Sequence[Row]) -> str:
    """All rates in Markdown, with intervals, goals and the oracle."""
    lines = [[r.name, *_share(r), r.goal, "" if r.oracle is None else f"{r.oracle} of {r.total}"] for r in rates(rows)]
    return _table(lines, ["", "share", "cases", "95 % interval", "goal", "oracle"])


def _numbers(rows: Sequence[Row]) -> str:
    listed: list[list[str]] = []
    wanted = (("among sets that were fitted", "probability"), ("step by step, as ranked", "step_probability"))
    for words, key in wanted:
        for below, where in ((1.0, ""), (CERTAIN, f", without those above {CERTAIN}")):
            found = calibration([row for row in rows if row.get(key) is not None], key, below)
            if found is not None:
                goal = "ECE <= 0.03" if key == "probability" and not where else ""
                value = f"ECE {found.error:.3f} ({found.by_chance:.3f}), Brier {found.brier:.3f}, {found.cases} cases"
                listed.append([f"probabilities {words}{where}", value, goal])
    size = mean_set(rows)
    listed.append(["explanations in a set of 95 %, mean", "" if size is None else f"{size:.2f}", "<= 1.5"])
    if ratios := held_out_ratios(rows):
        value = f"{np.median(ratios):.2f}, {np.quantile(ratios, 0.9):.2f}"
        listed.append(["error held out over what is expected, median and 90 % quantile", value, "<= 1.1, median"])
    for key, words in (("linearisations", "linearisations of a case"), ("took", "seconds of a case")):
        values = [row[key] for row in rows if key in row]
        if values:
            listed.append([f"{words}, median and worst", f"{np.median(values):,.0f}, {max(values):,.0f}", ""])
    return _table(listed, ["", "value", "goal"])


def _by_probability(rows: Sequence[Row]) -> str:
    """Of confident answers, by the probability that is stated, how many are wrong."""
    refitted, lines = [*map(with_others_fitted, rows)], []
    for low, high in pairwise(BANDS):
        own = [
            (row, beside)
            for row, beside in zip(rows, refitted, strict=True)
            if row["verdict"] in CONFIDENT and row["probability"] is not None and low <= row["probability"] < high
        ]
        wrong = [sum(is_confident_wrong(one[k]) for one in own) for k in (0, 1)]
        lines.append([f"{low:g} to {min(high, 1.0):g}", str(len(own)), *map(str, wrong)])
    heads = [
        "probability stated",
        "explained, or nothing missing",
        "of these wrong",
        "seen with all others fitted anew",
    ]
    return _table(lines, heads)


def _by(parts: Sequence[tuple[str, Rate, Rate]], what: str) -> str:
    lines = [[label, *_share(right), *_share(tied)[:1]] for label, right, tied in parts]
    return _table(lines, [what, "right", "cases", "95 % interval", "or tied"])


def _cases(rows: Sequence[Row]) -> str:
    if not rows:
        return "None."
    lines = []
    for row in rows:
        truth = " + ".join([*sorted(hidden(row)), *filter(None, [row["outside"]])]) or "nothing"
        alone = ", ".join(f"{value:.0f}" for value in row["improvements"].values())
        refitted = ", ".join(f"{value:.0f}" for value in with_others_fitted(row)["improvements"].values())
        ties = "; ".join(" + ".join(names) or "nothing" for names in row["ties"])
        answer = " + ".join(row["named"]) or "nothing"
        answer += f" (small: {', '.join(row['small'])})" if row.get("small") else ""
        p = row.get("probability")
        lines.append(
            [row["seed"], truth, alone, refitted, f"{row['noise']:.0%}", row["poorer"], row["verdict"], answer, ties,
             "" if p is None else f"{p:.3g}", judged(row)]
        )  # fmt: skip
    heads = [
        "seed",
        "hidden",
        "improves by",
        "others fitted",
        "noise",
        "poor",
        "verdict",
        "answer",
        "tied",
        "probability",
    ]
    heads += ["judged"]
    return _table(lines, heads)


def draw_confusion(rows: Sequence[Row], path: Path) -> None:
    """One thing hidden or none against what is named."""
    counts = confusion(rows)
    across = sorted({truth for truth, _ in counts})
    down = sorted({answer for _, answer in counts}, key=lambda name: (name not in across, name))
    grid = np.array([[counts.get((truth, answer), 0) for answer in down] for truth in across]).reshape(
        len(across), len(down)
    )
    figure, ax = plt.subplots(figsize=(2 + 0.3 * len(down), 2 + 0.25 * len(across)), layout="constrained")
    ax.imshow(np.where(grid > 0, grid, np.nan), cmap="Blues", vmin=0)
    for i, j in np.argwhere(grid):
        colour = "white" if grid[i, j] > 0.5 * grid.max() else "black"
        ax.text(j, i, str(grid[i, j]), ha="center", va="center", fontsize=7, color=colour)
    ax.set_xticks(range(len(down)), down, rotation=90, fontsize=7)
    ax.set_yticks(range(len(across)), across, fontsize=7)
    ax.set_xlabel("named")
    ax.set_ylabel("hidden")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw_reliability(rows: Sequence[Row], path: Path) -> None:
    """Share right over probability stated."""
    figure, ax = plt.subplots(figsize=(4.5, 4.5), layout="constrained")
    ax.plot([0, 1], [0, 1], color="grey", lw=1)
    series = {}
    for key, label in (("probability", "among sets fitted"), ("step_probability", "step by step, as ranked")):
        found = calibration([row for row in rows if row.get(key) is not None], key)
        if found is not None:
            series[label] = np.array(found.bins).T
    for label, (p, share, count) in series.items():
        (line,) = ax.plot(p, share, "o-", label=label)
        # Numbers on the side away from the other series.
        (other,) = [one for name, one in series.items() if name != label] or [(p, share - 1.0)]
        for x, y, n in zip(p, share, count, strict=True):
            above = y > other[1][np.argmin(np.abs(other[0] - x))]
            place = {"xytext": (0, 6 if above else -12), "ha": "center", "fontsize": 7, "color": line.get_color()}
            ax.annotate(f"{n:.0f}", (x, y), textcoords="offset points", **place)
    ax.set_xlabel("probability stated")
    ax.set_ylabel("share right")
    if ax.get_legend_handles_labels()[0]:
        figure.legend(frameon=False, loc="outside upper center", ncols=2)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw_decades(rows: Sequence[Row], path: Path) -> None:
    """Share right over improvement in chi-square, with intervals of 95 %."""
    figure, ax = plt.subplots(figsize=(5, 3.5), layout="constrained")
    parts = [part for part in by_decade(rows) if part[1].total]
    for which, label in ((1, "right"), (2, "right or tied")):
        shares = np.array([part[which].share for part in parts], float)
        ends = np.array([part[which].interval() for part in parts]).reshape(-1, 2)
        at = np.arange(len(parts)) + 0.06 * (which - 1)
        ax.errorbar(at, shares, np.abs(ends.T - shares), fmt="o", capsize=3, label=label)
    ax.set_xticks(range(len(parts)), [part[0] for part in parts])
    ax.set_ylim(0, 1.03)
    ax.set_xlabel("improvement in chi-square by the weakest effect hidden")
    ax.set_ylabel("share")
    figure.legend(frameon=False, loc="outside upper center", ncols=2)
    figure.savefig(path, dpi=110)
    plt.close(figure)
