"""Programs that are made ahead of their first use."""

import jax
import numpy as np
import pytest

from rotorjax import effects
from rotorjax.discovery.fit import Trial, fit_trials
from rotorjax.effects import CATALOG
from rotorjax.effects.terms import TERMS
from rotorjax.inference import ahead
from rotorjax.inference.budget import Budget
from rotorjax.inference.kernels import Kernels
from rotorjax.inference.programs import Compiled, Program, in_background
from rotorjax.inference.space import make_space

import hidden


def doubling(traced: list[int], *, fails_first: bool = False) -> Compiled:
    """Twice its rows, of which four are evaluated together; notes when it is traced."""

    def kernel(tree, rows):
        del tree
        traced.append(1)
        if fails_first and len(traced) == 1:
            raise RuntimeError("the first attempt fails")
        return (2.0 * rows,)

    return Compiled(Program(kernel, jax.tree.structure(()), ours=False), [], 4)


@pytest.mark.parametrize("fails_first", [False, True])
def test_what_is_made_ahead_is_not_made_again(fails_first):
    """And what could not be made in the background is made where it is needed."""
    traced = []
    program = doubling(traced, fails_first=fails_first)
    in_background(lambda: program.make(np.ones(1)))
    while not traced:
        pass
    (twice,) = program(np.arange(6.0))
    np.testing.assert_array_equal(twice, 2.0 * np.arange(6.0))
    assert len(traced) == 1 + fails_first


def test_fits_of_terms_need_no_programs_but_those_made_ahead(monkeypatch):
    model, measurement, _ = hidden.sufficient(effects.MassError, seed=1)
    made, needed = set(), set()
    monkeypatch.setattr(Kernels, "warm", False)
    monkeypatch.setattr(Compiled, "make", lambda self, *rows: made.add(self.program))
    monkeypatch.setattr(ahead, "in_background", lambda job: job())
    space = make_space(model.with_orders(measurement.orders).with_null_effects(CATALOG.values()), measurement.knowledge)
    ahead.make_programs_ahead(space, measurement)
    whole = Compiled.chunk
    monkeypatch.setattr(Compiled, "chunk", lambda self, *rows: needed.add(self.program) or whole(self, *rows))
    cubic = model.plus([TERMS["term_cubic_x"]()])
    fit_trials([Trial(cubic, ("term_cubic_x",), near=False)], measurement, Budget())
    assert needed
    assert needed <= made
