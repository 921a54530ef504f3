"""The whole of `explain` on effects drawn by seed, one or two, with machine, plan, noise and what is poor about the
measurement.

Motion is integrated in time by code that shares nothing with rotorjax. A confident wrong answer is the worst defect: it
is called WRONG, and the script exits with 1 if there is one. Seeds below 730 were looked at while the method was made.
Some half an hour; prints a line for each and writes a table.

    python benchmarks/explanations.py --output benchmarks/results
"""

import argparse
import sys
from pathlib import Path

import jax
import numpy as np
from timing import timed
from verdicts import summary, write_page

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from drawn_slips import draw_with_mistake

from rotorjax import explain
from rotorjax.discovery.explain import Explanation
from rotorjax.discovery.ties import Alternative
from rotorjax.reporting.tables import number

from drawn_effects import Hidden, draw

ABOUT = """One effect of the catalogue or two, or none, drawn by seed with machine, plan, noise and what is poor about
the measurement; integrated in time. Seeds below 730 were looked at while the method was made.

*Right*: "explained" by what is hidden, or "nothing missing" where nothing is. *Right but for the small*: a
part is named, and it leaves no more than the noise. *Among what is open*: "undecided", and the hidden effects
are the answer or one that the data cannot tell from it. *Left open*: "undecided" or "unexplained", without
them. *In other words*: "explained" by less, and said to be contained in what is hidden. *WRONG*: "explained"
by others, or "nothing missing" while something is and can be seen.

Written by `python benchmarks/explanations.py --output benchmarks/results`."""


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=730, help="seed to begin with (%(default)s)")
    parser.add_argument("--seeds", type=int, default=50, help="number of cases (%(default)s)")
    parser.add_argument(
        "--slips",
        action="store_true",
        help="every second case with a mistake in rig file or table",
    )
    parser.add_argument("--output", type=Path, help="folder for explanations.md")
    arguments = parser.parse_args()
    if arguments.output:
        arguments.output.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_enable_x64", True)
    rows = []
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        hidden, mistake = draw_with_mistake(seed) if arguments.slips else (draw(seed), None)
        found, seconds = timed(
            lambda hidden=hidden: explain(hidden.model, hidden.measurement, slips=arguments.slips or None)
        )
        story = found.story
        noise = None if hidden.measurement.sigma is None else np.sqrt(2.0) * hidden.measurement.sigma.max()
        before, after = (
            number(None if noise is None else view.rms / noise, 3) for view in (story.declared, story.last)
        )
        p = "" if found.p_value is None else number(found.p_value.value, 2)
        ties = "; ".join(" + ".join(others) or "nothing" for group in found.tied_groups() for others in group[1:])
        row = [
            str(seed),
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
        rows.append(row)
        print(" | ".join(row), f"({seconds:.0f} s)", flush=True)
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
