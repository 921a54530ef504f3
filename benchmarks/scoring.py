"""Scores of answers to drawn cases: pure functions of rows, each with what is true and what was answered.

What counts as what is the same for every tool. *Seen*: it improves chi-square by more than 30; what does not may be
left out. *Right*: nothing is named that is not hidden, and all that can be seen is, be it among what is said to be too
small to matter. *Confident*: the verdict is "explained" or "nothing missing".
"""

import csv
import dataclasses
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta

Row = dict[str, Any]
SEEN = 30.0
"""Improvement in chi-square from which on something must be found."""
FELT = 10.0
"""Improvement in chi-square from which on something may be named."""
CERTAIN = 0.999
"""Probability above which an answer tells little about calibration."""
TIE = 3.0
"""Log posterior behind an answer up to which the truth counts as tied with it."""
DECADES = ((10.0, 100.0), (100.0, 1e3), (1e3, 1e4))
BINS = 10
CONFIDENT = ("explained", "nothing missing")


def hidden(row: Row) -> frozenset[str]:
    """All names that a full answer has; a force outside the catalogue has none."""
    return frozenset([*row["effects"], *filter(None, [row["mistake"]])])


def true(row: Row) -> frozenset[str]:
    """All that may be named: what is hidden, and what the rotor has besides by its detail, as far as that improves
    chi-square by more than `FELT`.
    """
    return hidden(row) | {name for name, brings in row["detail"].items() if brings > FELT}


def named(row: Row) -> frozenset[str]:
    """What was answered."""
    return frozenset(row["named"])


def small(row: Row) -> frozenset[str]:
    """What was said to be there, but too small to matter."""
    return frozenset(row.get("small", ()))


def small_or_tied(row: Row) -> list[frozenset[str]]:
    """The same, and what is said to do as well in the place of parts of it: all choices."""
    chosen = [small(row)]
    for part, *others in row.get("small_ties", ()):
        chosen += [known - set(part) | set(other) for known in chosen if known >= set(part) for other in others]
    return chosen


def improvements(row: Row) -> dict[str, float]:
    """What each thing hidden brings in chi-square."""
    return {**row["improvements"], **({row["mistake"]: row["mistake_improvement"]} if row["mistake"] else {})}


def with_others_fitted(row: Row) -> Row:
    """The row with what each effect improves once the parameters of all others are fitted anew without it, where that
    is known, by the noise and the tolerance as `explain` counts them: what is left to be seen. Drawn sizes only hold
    stiffness, damping and mass free.
    """
    alone, brings = row["improvements"], row.get("brings") or {}
    return {**row, "improvements": {name: min(value, brings.get(name, value)) for name, value in alone.items()}}


def weakest(row: Row) -> float:
    """Improvement in chi-square by the least visible of what is hidden; endless where nothing is."""
    return min(improvements(row).values(), default=math.inf)


def needed(row: Row) -> frozenset[str]:
    """What is hidden and can be seen."""
    return frozenset(name for name in hidden(row) if improvements(row)[name] > SEEN)


def stands_out(row: Row) -> bool:
    """Whether all that is hidden changes the vectors by more than the noise, root mean square: then it improves
    chi-square by more than the number of real and imaginary parts.
    """
    return weakest(row) > 2 * row["cells"]


def _fits(row: Row, names: frozenset[str], slight: frozenset[str]) -> bool:
    return row["outside"] is None and needed(row) <= names | slight <= true(row)


def is_right(row: Row) -> bool:
    """Whether the answer is right, whatever the verdict."""
    return _fits(row, named(row), small(row))


def is_named(row: Row) -> bool:
    """Whether the answer itself is right, without what is said to be too small to matter."""
    return row["outside"] is None and needed(row) <= named(row) <= true(row)


def is_right_or_tied(row: Row) -> bool:
    """The same, or what is said to tie with it."""
    named_or_tied = [named(row), *map(frozenset, row["ties"])]
    return any(_fits(row, names, slight) for names in named_or_tied for slight in small_or_tied(row))


def is_confident_wrong(row: Row) -> bool:
    """Whether the verdict is confident, and something is named that is not hidden, or something that can be seen is
    left out without a word. What is too small to matter by another name is not counted here: `is_small_misnamed`.
    """
    if row["verdict"] not in CONFIDENT:
        return False
    if row["outside"] is not None:
        return (row["verdict"] == "explained" and is_distinguishable(row)) or (
            weakest(row) > SEEN and _says_nothing(row)
        )
    if is_contained(row):
        return False
    unsaid = small(row) <= true(row) and not any(needed(row) <= named(row) | slight for slight in small_or_tied(row))
    return not named(row) <= true(row) or unsaid


def is_distinguishable(row: Row) -> bool:
    """Whether a force outside the catalogue does what neither its nearest relative in it nor an answer called explained
    does, as far as these readings tell: by chi-square of the vectors without their noise.
    """
    left = row.get("left_by_answer")
    return row["beyond"] > SEEN and (left is None or left > SEEN)


def _says_nothing(row: Row) -> bool:
    return row["verdict"] == "nothing missing" and not small(row)


def is_contained(row: Row) -> bool:
    """Whether less is named, and what is hidden is said to do the same with more parameters."""
    return any(needed(row) <= names | small(row) <= true(row) for names in map(frozenset, row["contains"]))


def is_small_misnamed(row: Row) -> bool:
    """Whether what is said to be too small to matter is not hidden, nor anything that is said to do as well."""
    return row["verdict"] in CONFIDENT and not any(slight <= true(row) for slight in small_or_tied(row))


def judged(row: Row) -> str:
    """In a few words, whether the answer is right."""
    if is_confident_wrong(row):
        return "WRONG"
    if row["outside"] is not None:
        said = {"nothing missing": "too small to see", "explained": "by a relative that does the same"}
        return said.get(row["verdict"], "not called explained")
    if is_right(row):
        return "right" if row["verdict"] in CONFIDENT else f"right, {row['verdict']}"
    if is_right_or_tied(row):
        return "among what ties"
    if row["verdict"] not in CONFIDENT:
        return "left open"
    return "in other words" if is_contained(row) else "small by another name"


@dataclasses.dataclass(frozen=True)
class Rate:
    """So many of so many, with what was hoped for."""

    name: str
    count: int
    total: int
    goal: str = ""
    oracle: int | None = None
    """How many of an oracle that knows the truth, if it is known."""

    @property
    def share(self) -> float | None:
        """Count over total."""
        return self.count / self.total if self.total else None

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Of the share (Clopper, Pearson 1934, Biometrika 26:404-413)."""
        tail, k, n = 0.5 * (1.0 - level), self.count, self.total
        low = 0.0 if k == 0 else float(beta.ppf(tail, k, n - k + 1))
        return low, 1.0 if k == n else float(beta.ppf(1.0 - tail, k + 1, n - k))


def rate(
    name: str, rows: Sequence[Row], test: Callable[[Row], bool], goal: str = "", oracle: float | None = None
) -> Rate:
    """How many of some rows pass a test. **Arguments:** ``oracle``: it passes, too, where the truth, fitted from
    its true values, is more probable than the answer by this much.
    """
    passed = None
    if oracle is not None and any("lead_of_truth" in row for row in rows):
        passed = sum(test(row) or _leads(row, oracle) for row in rows)
    return Rate(name, sum(map(test, rows)), len(rows), goal, passed)


def _leads(row: Row, by: float) -> bool:
    """Whether the truth is more probable than the answer by a difference of log posterior."""
    lead = row.get("lead_of_truth")
    return lead is not None and lead > by


def search_missed(rows: Sequence[Row]) -> list[Row]:
    """Answers that are wrong or incomplete although the truth is more probable in the same race."""
    return [row for row in rows if row["outside"] is None and not is_right(row) and _leads(row, 0.0)]


def standard(rows: Sequence[Row], noise: float) -> list[Row]:
    """One effect or two of the catalogue that can be seen, by the standard plan: run-up and two trial weights."""
    return [
        row
        for row in rows
        if row["poorer"] == "none"
        and row["noise"] == noise
        and row["effects"]
        and row["mistake"] is None
        and row["outside"] is None
        and weakest(row) > SEEN
    ]


def rates(rows: Sequence[Row]) -> list[Rate]:
    """All rates with their goals."""
    clean, in_catalogue = standard(rows, 0.01), [row for row in rows if row["outside"] is None]
    nothing = [row for row in in_catalogue if not hidden(row)]
    outside = [row for row in rows if row["outside"] is not None and weakest(row) > SEEN]
    told = [row for row in outside if row["beyond"] > SEEN]
    mistaken = [row for row in in_catalogue if row["mistake"] and row["mistake_improvement"] > SEEN]
    two = [row for row in in_catalogue if len(row["effects"]) == 2 and row["mistake"] is None and weakest(row) > SEEN]
    usual = [row for row in two if row["poorer"] == "none"]
    refitted = [*map(with_others_fitted, rows)]
    seen_beside = [row for row in map(with_others_fitted, two) if weakest(row) > SEEN]
    read_more = [row for row in in_catalogue if row.get("further_readings")]
    return [
        rate("1 % noise, standard plan: right", clean, is_right, ">= 0.97", 0.0),
        rate("the same, or said to tie", clean, is_right_or_tied, ">= 0.99", -TIE),
        rate("of the first: named in the answer itself, not as too small", clean, is_named, "", 0.0),
        rate("of the first, those above the noise: right", [*filter(stands_out, clean)], is_right, "", 0.0),
        rate("the same, or said to tie", [*filter(stands_out, clean)], is_right_or_tied, "", -TIE),
        rate("5 % noise, standard plan: right", standard(rows, 0.05), is_right, ">= 0.93, or 0.98 of the oracle", 0.0),
        rate("10 % noise, standard plan: right", standard(rows, 0.1), is_right, ">= 0.85, or 0.98 of the oracle", 0.0),
        rate("all: confident and wrong", rows, is_confident_wrong, "<= 0.005"),
        rate("the same, what counts as seen with all others fitted anew", refitted, is_confident_wrong),
        rate("all: less named, what is hidden said to contain it", rows, _in_other_words),
        rate("all: too small to matter, by a wrong name", rows, is_small_misnamed),
        rate("nothing hidden: explained by what is not there", nothing, is_confident_wrong, "<= 0.02"),
        rate("force outside the catalogue, told from it: not called explained", told, _not_explained, ">= 0.95"),
        rate("the same, told from an answer called explained too", [*filter(is_distinguishable, told)], _not_explained),
        rate("force outside the catalogue, seen: not called explained", outside, _not_explained),
        rate("mistake: named, or tied", mistaken, _mistake_named, ">= 0.90"),
        rate("mistake: explained by something else", mistaken, _mistake_lost, "<= 0.01"),
        rate("two effects, standard plan: both named", usual, _both_named, ">= 0.85", 0.0),
        rate("two effects, all plans: both named", two, _both_named, "", 0.0),
        rate("the same, each seen with the other fitted anew", seen_beside, _both_named, "", 0.0),
        rate("set of 95 %: holds the truth", with_set(rows), _in_set, "0.93 to 1.0"),
        rate("intervals of 90 %: hold the true value", intervals(rows, exact=True), bool, "0.85 to 0.95"),
        rate("the same, where the true value is an estimate", intervals(rows, exact=False), bool),
        rate("readings proposed: settle what they separate", read_more, _settled_by("proposed"), ">= 0.80"),
        rate("the same, by as many at random", read_more, _settled_by("random")),
        rate("readings proposed: the answer or what ties holds the truth", read_more, _true_after("proposed")),
        rate("the same, after as many at random", read_more, _true_after("random")),
    ]


def _settled_by(which: str) -> Callable[[Row], bool]:
    """Whether only one of two explanations that were open is so after further readings."""

    def settled(row: Row) -> bool:
        more = row["further_readings"]
        left = [set(names) for names in (more[which]["named"], *more[which]["ties"])]
        return sum(set(names) in left for names in more["separates"]) == 1

    return settled


def _true_after(which: str) -> Callable[[Row], bool]:
    """Whether the truth is the answer after further readings, or among what ties with it."""
    return lambda row: is_right_or_tied({**row, **row["further_readings"][which]})


def _both_named(row: Row) -> bool:
    return hidden(row) <= named(row) | small(row)


def _not_explained(row: Row) -> bool:
    return row["verdict"] != "explained"


def _in_other_words(row: Row) -> bool:
    return judged(row) == "in other words"


def _mistake_named(row: Row) -> bool:
    return any(row["mistake"] in names for names in [row["named"], *row["ties"]])


def _mistake_lost(row: Row) -> bool:
    return row["verdict"] == "explained" and row["mistake"] not in row["named"]


def by_decade(rows: Sequence[Row]) -> list[tuple[str, Rate, Rate]]:
    """Decade of the improvement of the weakest -> right, and right or tied, of catalogue effects without mistakes."""
    some = [row for row in rows if row["effects"] and row["mistake"] is None]
    found = []
    for low, high in DECADES:
        here = [row for row in some if low <= weakest(row) < high]
        label = f"{low:g} to {high:g}"
        found.append((label, rate(label, here, is_right), rate(label, here, is_right_or_tied)))
    return found


def by_effect(rows: Sequence[Row]) -> list[tuple[str, Rate, Rate]]:
    """Effect alone and seen -> right, and right or tied."""
    alone = [row for row in rows if len(row["effects"]) == 1 and row["mistake"] is None and weakest(row) > SEEN]
    found = []
    for name in sorted({row["effects"][0] for row in alone}):
        here = [row for row in alone if row["effects"] == [name]]
        found.append((name, rate(name, here, is_right), rate(name, here, is_right_or_tied)))
    return found


def confusion(rows: Sequence[Row]) -> dict[tuple[str, str], int]:
    """(what is hidden, what is named) -> cases with one thing hidden or none; several named stand as they are."""
    counts: dict[tuple[str, str], int] = {}
    for row in rows:
        truth = [*hidden(row), *filter(None, [row["outside"]])]
        if len(truth) > 1 or (truth and weakest(row) <= SEEN):
            continue
        answer = " + ".join(sorted(named(row))) or "nothing"
        if row["outside"] and row["verdict"] in ("unexplained", "undecided"):
            answer = row["verdict"]
        key = (truth[0].split(".")[0] if truth else "nothing", answer)
        counts[key] = counts.get(key, 0) + 1
    return counts


@dataclasses.dataclass(frozen=True)
class Calibration:
    """Probabilities stated, against how often they were right."""

    cases: int
    error: float
    """Expected calibration error: mean over cases of |mean probability - share right| of the case's bin (Naeini et al.,
    AAAI 2015).
    """
    brier: float
    """Mean squared difference of probability and 1 or 0."""
    by_chance: float
    """What the error would be in the mean if all probabilities were exactly right."""
    bins: tuple[tuple[float, float, int], ...]
    """Mean probability, share right, cases."""


def calibration(rows: Sequence[Row], key: str = "probability", below: float = 1.0) -> Calibration | None:
    """Of answers to cases that the catalogue can explain. **Arguments:** ``below``: up to which probability."""
    pairs = [
        (row[key], float(is_right(row)))
        for row in rows
        if row["outside"] is None and row[key] is not None and row[key] <= below
    ]
    if not pairs:
        return None
    p, right = np.array(pairs).T
    place = np.minimum((BINS * p).astype(int), BINS - 1)
    bins = tuple(
        (float(p[place == k].mean()), float(right[place == k].mean()), int(np.sum(place == k)))
        for k in range(BINS)
        if np.any(place == k)
    )
    error = sum(n * abs(mean - share) for mean, share, n in bins) / len(p)
    return Calibration(len(p), float(error), float(np.mean((p - right) ** 2)), by_chance(p), bins)


def by_chance(p: Sequence[float], draws: int = 2000) -> float:
    """Expected calibration error, in the mean, of as many probabilities that are exactly right."""
    stated, rng = np.asarray(p), np.random.default_rng(0)
    right = rng.random((draws, len(stated))) < stated
    place = np.minimum((BINS * stated).astype(int), BINS - 1)
    apart = [np.abs((right[:, place == k] - stated[place == k]).sum(axis=1)) for k in range(BINS)]
    return float(np.mean(np.sum(apart, axis=0)) / len(stated))


def held_out_ratios(rows: Sequence[Row]) -> list[float]:
    """Error on data held out over what noise and the tolerance of the model's form let expect, of right answers that
    add something.
    """
    return [
        row["held_out_rms"] / row["error"]
        for row in rows
        if row["outside"] is None and row["named"] and is_right(row) and row.get("held_out_rms") is not None
    ]


def with_set(rows: Sequence[Row]) -> list[Row]:
    """Rows that give a set of explanations, of cases that the catalogue can explain and where all can be seen."""
    return [row for row in rows if row["set95"] and row["outside"] is None and weakest(row) > SEEN]


def _in_set(row: Row) -> bool:
    return any(needed(row) <= names <= true(row) for names in map(frozenset, row["set95"]))


def mean_set(rows: Sequence[Row]) -> float | None:
    """Mean number of explanations in the sets of 95 %."""
    return float(np.mean([len(row["set95"]) for row in with_set(rows)])) if with_set(rows) else None


def intervals(rows: Sequence[Row], *, exact: bool) -> list[bool]:
    """For every determined parameter of a right answer whose true value is known: whether its interval holds it."""
    found = []
    for row in rows:
        for size in row["sizes"] if is_right(row) else []:
            effect = size["name"].split(".")[0]
            if size["name"] in row["values"] and size["determined"] and (effect in row["exact"]) == exact:
                found.append(abs(size["value"] - row["values"][size["name"]]) <= size["half"])
    return found


def read_rows(path: Path) -> list[Row]:
    """Rows as a campaign wrote them, one a line."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def read_answers(answers: Path, truth: Path) -> list[Row]:
    """Rows from the answers of another tool and what is true.

    **Arguments:** ``answers``: CSV with the columns ``seed``, ``verdict`` (as `explain` has them), ``effects`` (joined
    by " + ", mistakes among them, empty for none), ``probability`` (of this answer, may be empty), and if the tool has
    them ``ties`` and ``set95`` (alternatives joined by ";"); ``truth``: JSON lines as the cases were written with.
    **Errors.** ``ValueError`` for a case that is not answered.
    """
    given = {}
    with answers.open(encoding="utf-8", newline="") as file:
        for line in csv.DictReader(file):
            given[int(line["seed"])] = line
    rows = []
    for text in truth.read_text(encoding="utf-8").splitlines():
        true = json.loads(text)
        if true["seed"] not in given:
            raise ValueError(f"{answers}: no answer for seed {true['seed']}; every case counts, give each a verdict")
        line = given[true["seed"]]
        probability = line.get("probability") or None
        rows.append(
            {
                **true,
                "verdict": line["verdict"],
                "named": _names(line["effects"]),
                "probability": None if probability is None else float(probability),
                "ties": [_names(part) for part in (line.get("ties") or "").split(";") if part.strip()],
                "set95": [_names(part) for part in (line.get("set95") or "").split(";") if part.strip()],
                "contains": [],
                "sizes": [],
                "small": [],
            }
        )
    return rows


def _names(text: str) -> list[str]:
    """Names joined by plus signs; "nothing" is none."""
    return [name.strip() for name in text.split("+") if name.strip() not in ("", "nothing")]
