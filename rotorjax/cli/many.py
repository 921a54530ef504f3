"""`explain-many`: a fleet, explained overnight."""

import argparse
import hashlib
import importlib.metadata
import re
from collections import Counter
from collections.abc import Iterable
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any

from rotorjax.cli.arguments import check_outputs, check_search, effect_names
from rotorjax.cli.progress import progress_line
from rotorjax.cli.terminal import say, terminal_width
from rotorjax.data.files import check_writable, refusals, write_whole
from rotorjax.errors import InputError, do_every

if TYPE_CHECKING:
    from rotorjax.batch.case import Case, Executor
    from rotorjax.batch.pairs import Pair
    from rotorjax.batch.runner import Progress

BAR = 24
"""Characters of the progress bar."""
QUIET_S = 60.0
"""Between lines of progress where they are not shown in place and the bar does not grow."""
MOST_FAILURES = 5
"""Failures that are named at the end."""


def explain_many(options: argparse.Namespace) -> None:
    """Every table of a folder or of a list with its rig file."""
    check_outputs(options)
    _check(options)
    from rotorjax.batch.results import kept_in, write_results

    kept = kept_in(options.output)
    check_writable(kept)
    if options.output.exists() and not kept.exists():
        raise InputError(f"--output {options.output}: exists already; choose another file, or remove it")
    what_is_kept = f"what is finished is kept in {kept}: the same command goes on"
    with progress_line(what_is_kept, QUIET_S) as show:
        show(f"reading {options.source}")
        from rotorjax.batch.explaining import COLUMNS, explain_case
        from rotorjax.batch.pairs import pairs
        from rotorjax.batch.runner import run
        from rotorjax.batch.store import Store

        written = [options.output, kept, *filter(None, [options.report, options.reports])]
        found = pairs(options.source if options.cluster is None else options.source.resolve(), written)
        executor = _executor(options)
        with Store(kept, _configuration(options), list(COLUMNS)) as store:
            progress = run(
                explain_case, _cases(options, found), store, executor, lambda progress: show(progress_text(progress))
            )
            rows = store.rows()
    do_every(
        lambda: write_results(options.output, rows, COLUMNS),
        lambda: _overview(options, rows),
        lambda: say(_summary(options, rows, progress)),
    )


def _check(options: argparse.Namespace) -> None:
    check_search(options)
    if options.workers is not None and options.workers < 1:
        raise InputError(f"--workers {options.workers}: must be one or more")
    if options.workers is not None and options.cluster is not None:
        raise InputError("--workers: counts processes on this machine; with --cluster the cluster's workers are used")
    with refusals(options.source, cure="give a folder with tables and rig files, or a list of them"):
        options.source.stat()
    if options.reports is not None:
        with refusals(f"--reports {options.reports}", cure="name a folder"):
            if options.reports.resolve().exists() and not options.reports.is_dir():
                raise InputError(f"--reports {options.reports}: is a file; name a folder")
    if options.report is not None and options.report.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--report {options.report}: name a file that ends in .html")
    for flag in ("only", "exclude"):
        setattr(
            options,
            flag,
            effect_names(f"--{flag}", getattr(options, flag), with_mistakes=options.mistakes is not False),
        )


def _configuration(options: argparse.Namespace) -> dict[str, Any]:
    """All that the rows depend on beside tables and rig files."""
    return {
        "command": "explain-many",
        "version": importlib.metadata.version("rotorjax"),
        "source": str(options.source.resolve()),
        "max_effects": options.max_effects,
        "limit": options.limit,
        "only": options.only,
        "exclude": options.exclude,
        "mistakes": options.mistakes,
        "reports": None if options.reports is None else str(options.reports.resolve()),
    }


def _executor(options: argparse.Namespace) -> "Executor":
    if options.cluster is not None:
        from rotorjax.batch.cluster import Cluster

        return Cluster(options.cluster)
    from rotorjax.batch.pool import Processes, processors

    return Processes(options.workers or processors())


def _cases(options: argparse.Namespace, found: "list[Pair]") -> "list[Case]":
    from rotorjax.batch.case import Case
    from rotorjax.batch.explaining import Task

    reports = report_paths(pair.name for pair in found)
    folder = options.reports if options.reports is None or options.cluster is None else options.reports.resolve()
    return [
        Case(
            pair.name,
            Task(
                pair.data,
                pair.rig,
                None if folder is None else folder / reports[pair.name],
                options.max_effects,
                options.only,
                options.exclude or (),
                options.mistakes,
                options.limit,
            ),
            pair.digest,
        )
        for pair in found
    ]


def report_paths(names: Iterable[str]) -> dict[str, str]:
    """Name of a case -> path of its report in the folder of reports, never outside it, no two the same."""
    safe = {name: "/".join(map(_safe, _parts(name))) or "_" for name in names}
    # Some file systems do not tell capitals from small letters.
    count = Counter(path.lower() for path in safe.values())
    return {
        name: f"{path}{'' if count[path.lower()] == 1 else '-' + hashlib.sha256(name.encode()).hexdigest()[:8]}.html"
        for name, path in safe.items()
    }


def _parts(name: str) -> list[str]:
    return [part for part in PurePosixPath(name.replace("\\", "/")).parts if part not in ("/", "//", "..")]


def _safe(part: str) -> str:
    return re.sub(r'[<>:"|?*\x00-\x1f\x7f]', "_", part)


def progress_text(progress: "Progress") -> str:
    """How far a run is, for people."""
    from rotorjax.reporting.tables import duration

    finished = progress.before + progress.done
    full = BAR * finished // max(progress.total, 1)
    failed = f", {progress.failed} failed" if progress.failed else ""
    seconds = progress.left_s or 0.0
    left = f", about {duration(seconds)} left" if seconds >= 1.0 else ""
    return f"explaining [{'#' * full}{'-' * (BAR - full)}] ({finished} of {progress.total}{failed}{left})"


def _overview(options: argparse.Namespace, rows: list[dict[str, Any]]) -> None:
    if options.report is not None:
        from rotorjax.batch.overview import overview

        write_whole(options.report, overview(rows, title=f"{options.source}: explained", folder=options.report.parent))


def _summary(options: argparse.Namespace, rows: list[dict[str, Any]], progress: "Progress") -> str:
    """What is told at the end: verdicts, the first failures, and where everything is."""
    from rotorjax.batch.overview import by_attention, counted
    from rotorjax.reporting.tables import wrapped

    counts = ", ".join(f"{count} {verdict}" for verdict, count in counted(rows).items())
    before = f" ({progress.before} of them finished before)" if progress.before else ""
    lines = [f"{len(rows)} {'case' if len(rows) == 1 else 'cases'}{before}: {counts}."]
    failures = [row for row in by_attention(rows) if row["failure"]]
    # A message goes on over several lines where it has something to paste.
    lines += [f"- {row['name']}: {row['failure'].splitlines()[0]}" for row in failures[:MOST_FAILURES]]
    if len(failures) > MOST_FAILURES:
        lines.append(f"- and {len(failures) - MOST_FAILURES} more failures, with their messages in the results")
    places = [f"Results: {options.output}"]
    places += [f"overview: {options.report}"] if options.report else []
    places += [f"reports: {options.reports}"] if options.reports else []
    return wrapped("\n".join([*lines, "; ".join(places)]), terminal_width())
