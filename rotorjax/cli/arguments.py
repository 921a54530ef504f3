"""What the arguments of a command mean, checked before anything is computed."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rotorjax.data.files import check_writable, resolved
from rotorjax.errors import InputError

if TYPE_CHECKING:
    from rotorjax.data.declarations import Mistake
    from rotorjax.data.measurement import Measurement
    from rotorjax.model.contract import Effect
    from rotorjax.model.model import Model


def check_search(options: argparse.Namespace) -> None:
    """`InputError` for a number of effects, or of linearisations, that no search can have."""
    if options.max_effects < 0:
        raise InputError(f"--max-effects {options.max_effects}: must be zero or more")
    if options.limit is not None and options.limit < 1:
        raise InputError(f"--limit {options.limit}: must be one or more")


def parse_effects(texts: list[str], model: "Model") -> "tuple[list[Effect], frozenset[str]]":
    """Effects from ``NAME:PARAMETER=VALUE,...`` as the command line gives them, and the keys of the values given."""
    from rotorjax.data.rig import effect_from_labels
    from rotorjax.data.section import nearest
    from rotorjax.data.synonyms import nearest_effect
    from rotorjax.effects.terms import NAMED

    effects, fixed, problems = [], set(), []
    for text in texts:
        name, _, assignments = text.partition(":")
        if name in {effect.name for effect in effects}:
            problems.append(f"--effect {text}: {name} is there already; give all its values in one --effect")
            continue
        if name not in NAMED:
            problems.append(f"--effect {text}: unknown effect {name!r}; {nearest_effect(name, NAMED)}")
            continue
        labels = [label for p in NAMED[name].parameters() for label in p.labels(model.layout)]
        problems += [] if labels else [f"--effect {text}: this effect needs a second balancing plane in the rig file"]
        given: dict[str, float] = {}
        for assignment in filter(None, assignments.split(",")):
            parameter, _, value = assignment.partition("=")
            matching = [label for label in labels if label == parameter or label.startswith(f"{parameter}.")]
            if set(matching) & set(given):
                problems.append(f"--effect {text}: {parameter} is given twice; keep one value")
            if not matching:
                problems.append(f"--effect {text}: {name} has no parameter {parameter!r}; {nearest(parameter, labels)}")
            try:
                number = float(value)
                if not abs(number) < float("inf"):
                    raise ValueError(value)
            except ValueError:
                problems.append(f"--effect {text}: {value!r} is not a finite number; write {parameter}=1.5")
                continue
            given.update(dict.fromkeys(matching, number))
        fixed |= {f"{name}.{label}" for label in given}
        effects.append(effect_from_labels(NAMED[name], model.layout, _beyond(model, name, given)))
    if problems:
        raise InputError(*problems)
    return effects, frozenset(fixed)


def parse_mistake(texts: list[str], model: "Model", measurement: "Measurement") -> "tuple[Mistake | None, list[str]]":
    """The mistake in rig file or table among ``--effect`` options, if there is one, and the other options: by its name,
    ``runs_exchanged.A.B``, or as ``runs_exchanged:A=trial-a,B=trial-b``, whatever stands before the equals signs.
    """
    from rotorjax.data.declarations import KINDS, mistakes
    from rotorjax.data.odd_runs import every_odd_run
    from rotorjax.data.section import nearest
    from rotorjax.data.wrong_readings import every_wrong_reading

    found, others = [], []
    for text in texts:
        kind = text.partition(":")[0].partition(".")[0]
        if kind not in KINDS:
            others.append(text)
            continue
        name, _, about = text.partition(":")
        wanted = ".".join([name, *(part.partition("=")[2] for part in filter(None, about.split(",")))])
        every = [*mistakes(model, measurement, [kind]), *every_odd_run(model, measurement, [kind])]
        every += every_wrong_reading(measurement, [kind])
        known = {mistake.name: mistake for mistake in every}
        # What is exchanged may be named in either order.
        backwards = {".".join((kind, *reversed(mistake.about))): mistake for mistake in known.values()}
        mistake = (backwards | known).get(wanted)
        if mistake is None:
            what = nearest(wanted, known) if known else "what is stated excludes it, or it would change nothing"
            raise InputError(f"--effect {text}: no such mistake can be made here; {what}")
        found.append(mistake)
    if len(found) > 1:
        raise InputError(f"--effect {found[1].name}: one mistake in rig file or table at a time")
    return (found[0] if found else None), others


def _beyond(model: "Model", name: str, given: dict[str, float]) -> dict[str, float]:
    """Values given less those that the model has already: what is added makes up the value given."""
    present = model.find(name)
    if present is None:
        return given
    labels = [label for p in present.parameters() for label in p.labels(model.layout)]
    has = dict(zip(labels, (float(v) for value in present.values() for v in value.ravel()), strict=True))
    return {label: value - has[label] for label, value in given.items()}


def effect_names(flag: str, text: str | None, *, with_mistakes: bool = True) -> tuple[str, ...] | None:
    """Names of effects, separated by commas, all known; also those of mistakes, ``with_mistakes``."""
    if text is None:
        return None
    from rotorjax.data.declarations import KINDS
    from rotorjax.data.synonyms import nearest_effect
    from rotorjax.effects import CATALOG

    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if not with_mistakes and (mistakes := [name for name in names if name in KINDS]):
        raise InputError(
            f"{flag}: {mistakes[0]} is a mistake in rig file or table: it takes no part with --no-mistakes"
        )
    if unknown := [name for name in names if name not in CATALOG and name not in KINDS]:
        raise InputError(*(f"{flag}: unknown effect {name!r}; {nearest_effect(name, CATALOG)}" for name in unknown))
    if flag == "--only" and not names:
        raise InputError("--only: names no effect; name those that may be missing, or leave the option out")
    return names


def check_outputs(options: argparse.Namespace) -> None:
    """Refuse outputs that would overwrite an input or one another, or cannot be written, before
    anything is computed.
    """
    read = {
        resolved(path): f"{path} is read"
        for path in (
            *(getattr(options, n, None) for n in ("data", "rig", "like", "source", "recordings", "healthy")),
            *getattr(options, "files", ()),
        )
        if isinstance(path, Path)
    }
    problems = []
    for name in ("json", "report", "write_rig", "output", "html"):
        path = getattr(options, name, None)
        if path is None:
            continue
        try:
            if use := read.get(resolved(path)):
                raise InputError(f"{path}: {use} by the same command; choose another file")
            check_writable(path)
            read[resolved(path)] = f"{path} is written"
        except InputError as error:
            problems += [f"--{name.replace('_', '-')} {problem}" for problem in error.problems]
    if problems:
        raise InputError(*problems)
