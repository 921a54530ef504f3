"""Forces outside the catalogue, drawn by seed with machine, plan and noise, and integrated in time: are they named?

Shapes that are terms of ours must be named, alone or among what does hardly worse; of the others, which no term is, nothing may be
claimed with certainty. Each is fitted in the response; what is left is compared with the noise. Writes a table, or prints it.

    python benchmarks/hidden_forces.py --seeds 24 --output benchmarks/results
"""

import argparse
import sys
from pathlib import Path

import jax
import numpy as np
import tabulate

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from drawn_forces import Drawn, draw

from rotorjax import Conditions, Jeffcott, Layout, Measurement, Model, fit
from rotorjax.discovery.named_force import NamedForce, name_force
from rotorjax.effects.terms import TERMS
from rotorjax.io.files import write_whole
from rotorjax.tables import number

SEEN = 1.1
"""Error over noise from which on there is something to explain."""


def measured(drawn: Drawn) -> tuple[Model, Measurement]:
    """The model that knows nothing of the force, and what was measured."""
    machine, plan = drawn.machine, drawn.plan
    orders = tuple(float(order) for order in plan.orders)
    rotor = Jeffcott(machine.mass, list(machine.stiffness), list(machine.ratio), gravity=list(drawn.gravity))
    run = np.repeat(np.arange(len(plan.weights)), len(plan.speeds))
    unbalance = np.array([[[w.real, w.imag] for w in planes] for planes in plan.weights.values()])[run]
    conditions = Conditions.at(np.tile(plan.speeds, len(plan.weights)), unbalance=unbalance)
    shape = drawn.vectors.shape
    there, sigma = np.ones(shape, bool), np.full(shape, plan.sigma)
    measurement = Measurement(tuple(plan.weights), ("X", "Y"), orders, run, ("",) * len(run), conditions, drawn.vectors, there, sigma, "given")
    return Model(rotor, layout=Layout(orders=orders)), measurement


def judged(drawn: Drawn, found: NamedForce, before: float) -> str:
    """In a word, whether the answer is right. **Arguments:** ``before``: what the model without the force leaves, over the noise."""
    if before < SEEN:
        return "too small to see" if not found.terms else "WRONG"
    if drawn.term is None:
        return "outside: left open" if not found.enough else "outside: terms are enough"
    names = [term.term for term in found.terms]
    if names == [drawn.term]:
        return "right"
    if any(rival.startswith(TERMS[drawn.term].words) for rival in found.rivals):
        return "among several"
    return "with others" if drawn.term in names else "nothing" if not names else "left open" if not found.enough else "WRONG"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, help="seed to begin with (%(default)s)")
    parser.add_argument("--seeds", type=int, default=24, help="number of cases (%(default)s)")
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
        answer = [found.words, "; ".join(found.rivals), number(before, 3), number(after, 3), judged(drawn, found, before)]
        rows.append([str(seed), f"{drawn.shape}, {drawn.axis}", plan, number(drawn.signal, 2), *answer])
        print(" | ".join(rows[-1]), flush=True)
    heads = ["seed", "hidden", "measured", "amplitude / noise", "named", "hardly worse", "rms before / noise", "after", "verdict"]
    table = tabulate.tabulate(rows, heads, tablefmt="pipe", disable_numparse=True)
    if arguments.output:
        write_whole(arguments.output / "hidden_forces.md", f"# Forces outside the catalogue, drawn by seed\n\n{table}\n")


if __name__ == "__main__":
    main()
