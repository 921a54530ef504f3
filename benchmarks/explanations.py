"""The whole of `explain` on effects drawn by seed, one or two, with machine, plan, noise and what is poor about the
measurement.

Motion is integrated in time by code that shares nothing with rotorjax. A confident wrong answer is the worst defect: it
is called WRONG, and the script exits with 1 if there is one. Seeds below 730 were looked at while the method was made.
Some half an hour on one processor; prints a line for each as it ends and writes a table in the order of the seeds.

    python benchmarks/explanations.py --output benchmarks/results
"""

import argparse
import hashlib
import json
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from timing import timed
from verdicts import summary, write_page

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from rotorjax import explain
from rotorjax.batch.case import Case
from rotorjax.batch.pool import Processes, processors
from rotorjax.batch.runner import Progress, run
from rotorjax.batch.store import Store
from rotorjax.compilation import spare_memory, use_double_precision
from rotorjax.discovery.explanation import Explanation
from rotorjax.discovery.ties import Alternative
from rotorjax.reporting.tables import number

from drawn_effects import Hidden, draw
from drawn_mistakes import draw_with_mistake

ROOT = Path(__file__).resolve().parent.parent
ABOUT = """One effect of the catalogue or two, or none, drawn by seed with machine, plan, noise and what is poor about
the measurement; integrated in time. Seeds below 730 were looked at while the method was made.

*Right*: "explained" by what is hidden, or "nothing missing" where nothing is. *Right but for the small*: a
part is named, and it leaves no more than the noise. *Among what is open*: "undecided", and the hidden effects
are the answer or one that the data cannot tell from it. *Left open*: "undecided" or "unexplained", without
them. *In other words*: "explained" by less, and said to be contained in what is hidden. *WRONG*: "explained"
by others, or "nothing missing" while something is and can be seen.

Written by `python benchmarks/explanations.py --output benchmarks/results`."""


class Drawn(NamedTuple):
    """A case: its seed, and whether every second one has a mistake in rig file or table."""

    seed: int
    mistakes: bool
    beginning: str = ""
    """Of the names of those mistakes."""


def judged(hidden: Hidden, found: Explanation, mistake: str | None = None) -> str:
    """In a few words, whether the answer is right."""
    truth, answer = {*hidden.effects, *filter(None, [mistake])}, set(found.named)
    if found.verdict in ("explained", "nothing missing"):
        if answer == truth:
            return "right"
        small = {s.effect for s in found.detected_but_small}
        if answer < truth and (found.p_value is not None or truth <= answer | small):
            return "right but for the small"
        return "in other words" if truth in _replaced(answer, found.ties.contains) else "WRONG"
    other_mistakes = [set(other.named) for other in found.written.tied]
    if found.verdict == "undecided" and truth in [answer, *_replaced(answer, found.ties.tied), *other_mistakes]:
        return "among what is open"
    return "left open"


def _replaced(answer: set[str], others: tuple[Alternative, ...]) -> list[set[str]]:
    """The answer with each of some alternatives in the place of a part of it."""
    return [answer - set(other.instead_of) | set(other.effects) for other in others]


def explained(drawn: Drawn) -> dict[str, Any]:
    """One case: its row of the table, and how long it took."""
    use_double_precision()
    hidden, mistake = draw_with_mistake(drawn.seed, drawn.beginning) if drawn.mistakes else (draw(drawn.seed), None)
    found, seconds = timed(lambda: explain(hidden.model, hidden.measurement))
    spare_memory()
    story = found.story
    noise = None if hidden.measurement.sigma is None else np.sqrt(2.0) * hidden.measurement.sigma.max()
    before, after = (number(None if noise is None else view.rms / noise, 3) for view in (story.declared, story.last))
    p = "" if found.p_value is None else number(found.p_value.value, 2)
    ties = "; ".join(" + ".join(others) or "nothing" for group in found.tied_groups() for others in group[1:])
    cells = [
        str(drawn.seed),
        " + ".join([*filter(None, [mistake]), *hidden.effects]),
        hidden.words,
        before,
        found.verdict,
        " + ".join(found.named),
        ties,
        after,
        p,
        judged(hidden, found, mistake),
    ]
    return {"cells": cells, "took": seconds}


def told(progress: Progress) -> None:
    """Print the case that ended last."""
    if progress.latest is not None and progress.latest.row is not None:
        row = json.loads(progress.latest.row)
        print(" | ".join(row["cells"]), f"({row['took']:.0f} s)", flush=True)
    elif progress.latest is not None:
        print(progress.latest.name, "|", progress.latest.failure, flush=True)


def sources() -> str:
    """A digest of the code that the rows depend on."""
    digest = hashlib.sha256()
    for folder in ("rotorjax", "tests", "benchmarks"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=730, help="seed to begin with (%(default)s)")
    parser.add_argument("--seeds", type=int, default=50, help="number of cases (%(default)s)")
    parser.add_argument(
        "--mistakes",
        action="store_true",
        help="every second case with a mistake in rig file or table",
    )
    parser.add_argument("--kind", default="", help="with --mistakes: only those whose names begin so, such as run_")
    parser.add_argument("--output", type=Path, help="folder for explanations.md")
    parser.add_argument("--workers", type=int, default=processors(), help="processes at one time (%(default)s)")
    parser.add_argument("--keep", type=Path, help="SQLite file for the rows as they end: given again, the rest is done")
    arguments = parser.parse_args()
    if arguments.output:
        arguments.output.mkdir(parents=True, exist_ok=True)
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    cases = [Case(str(seed), Drawn(seed, arguments.mistakes, arguments.kind)) for seed in seeds]
    configuration = {"mistakes": arguments.mistakes, "kind": arguments.kind, "sources": sources()}
    with (
        tempfile.TemporaryDirectory() as folder,
        Store(arguments.keep or Path(folder) / "rows.sqlite", configuration) as store,
    ):
        run(explained, cases, store, Processes(arguments.workers), told)
        kept = store.rows()
    if failures := [f"{row['name']}: {row['failure']}" for row in kept if row["failure"]]:
        sys.exit("\n".join(failures))
    rows = [row["cells"] for row in kept]
    heads = [
        "seed",
        "hidden",
        "measured",
        "rms before / noise",
        "verdict",
        "answer",
        "tied with",
        "after",
        "p",
        "judged",
    ]
    print(summary(rows))
    if arguments.output:
        write_page(arguments.output / "explanations.md", "Effects drawn by seed, explained", ABOUT, heads, rows)
    sys.exit(int(any(row[-1] == "WRONG" for row in rows)))


if __name__ == "__main__":
    main()
