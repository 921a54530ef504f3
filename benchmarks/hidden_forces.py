"""Forces outside the catalogue, drawn by seed with machine, plan and noise, and integrated in time: are they named?

Shapes that are terms of ours must be named, alone or among what does nearly as well; of the others, which no term is,
nothing may be claimed with certainty. Each is fitted in the response; what is left is compared with the noise. Seeds
below 872 were looked at while the method was made. Some half an hour; prints a line for each and writes a table.

    python benchmarks/hidden_forces.py --output benchmarks/results
"""

import argparse
import re
import sys
from pathlib import Path

import jax
import numpy as np
from verdicts import write_page

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from rotorjax import fit
from rotorjax.discovery.named_force import NamedForce, name_force
from rotorjax.effects.terms import TERMS
from rotorjax.reporting.tables import number

from drawn_forces import Drawn, draw, measured

ABOUT = """Machine, plan, noise, shape, axis and size are drawn, and the motion is integrated in time. Errors are root
mean squares over those of the noise.

Seeds below 872 were looked at while the method was made.

*Right*: the term named is the force. *Among several*: so is one of those that do nearly as well. *With others*:
a second term is named beside it. *Left open*: what is named leaves more than the noise, and is said to. *Too
small to see*: no more than noise to explain, and nothing named. *Outside*: no term is this force; what is
named comes near it or is left open. *WRONG*: another term is named and leaves no more than the noise.

Written by `python benchmarks/hidden_forces.py --output benchmarks/results`."""
POWERS = {"fifth power": 5.0, "cubic damping": 3.0}
"""Of the shapes of which the term has its power fitted."""
SEEN = 1.1
"""Error over noise from which on there is something to explain."""


def judged(drawn: Drawn, found: NamedForce, before: float) -> str:
    """In a word, whether the answer is right. **Arguments:** ``before``: what the model without the force leaves, over
    the noise.
    """
    if before < SEEN and not found.terms:
        return "too small to see"
    if drawn.term is None:
        return "outside: left open" if not found.enough else "outside: terms are enough"
    if _said_in(found.words, drawn):
        return "right" if len(found.terms) == 1 else "with others"
    if any(_said_in(rival, drawn) for rival in found.rivals):
        return "among several"
    return "left open" if not found.enough else "WRONG"


def _said_in(words: str, drawn: Drawn) -> bool:
    """Whether an answer has the term that is the force, with its power within 0.3 where that is fitted."""
    opening, *_ = TERMS[drawn.term or ""].words.split(" a power of ")
    power = re.search(re.escape(opening) + r" the power ([\d.-]+)", words)
    if drawn.shape in POWERS:
        return power is not None and abs(float(power[1]) - POWERS[drawn.shape]) < 0.3
    return opening in words


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=872, help="seed to begin with (%(default)s)")
    parser.add_argument("--seeds", type=int, default=36, help="number of cases (%(default)s)")
    parser.add_argument("--output", type=Path, help="folder for hidden_forces.md")
    arguments = parser.parse_args()
    if arguments.output:
        arguments.output.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_enable_x64", True)
    rows = []
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        drawn = draw(seed)
        model, measurement = measured(drawn)
        declared = fit(model, measurement, free=(), held_out=False)
        found = name_force(declared, declared, ())
        noise = np.sqrt(2.0) * drawn.plan.sigma
        before = measurement.rms_of(declared.predicted) / noise
        after = measurement.rms_of(found.fit.predicted) / noise if found.fit else None
        orders = " ".join(str(order) for order in drawn.plan.orders)
        plan = f"{len(measurement.run)} cases, orders {orders}{', weight' if any(drawn.gravity) else ''}"
        answer = [
            found.words,
            "; ".join(found.rivals),
            number(before, 3),
            number(after, 3),
            judged(drawn, found, before),
        ]
        rows.append([str(seed), f"{drawn.shape}, {drawn.axis}", plan, number(drawn.signal, 2), *answer])
        print(" | ".join(rows[-1]), flush=True)
    heads = [
        "seed",
        "hidden",
        "measured",
        "amplitude / noise",
        "named",
        "nearly as well",
        "rms before / noise",
        "after",
        "verdict",
    ]
    if arguments.output:
        write_page(
            arguments.output / "hidden_forces.md", "Forces outside the catalogue, drawn by seed", ABOUT, heads, rows
        )


if __name__ == "__main__":
    main()
