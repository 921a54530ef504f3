"""How results come to be words and pictures: by `rotorjax.reporting.results`, which is loaded when one asks for that
and not before.
"""

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rotorjax.data.record_vectors import Records
    from rotorjax.data.rig import Rig
    from rotorjax.reporting.pictures import Plots


def _results() -> Any:
    """Everything else imports one way; a result must not need what draws it."""
    return importlib.import_module("rotorjax.reporting.results")


class Shown:
    """A result that notebooks show as HTML and that has a summary in words."""

    def summary(self, rig: "Rig | None" = None) -> str:
        """What the command line prints of it. **Arguments:** ``rig``: its angles count as the rig file says, and its
        planes are balanced.
        """
        return _results().summary(self, rig)

    def to_pandas(self) -> Any:
        """Its rows as a pandas data frame (extra ``pandas``): see `rotorjax.reporting.frames.frame`."""
        return importlib.import_module("rotorjax.reporting.frames").frame(self)

    def _repr_html_(self) -> str:
        return _results().html(self)


class Reported(Shown):
    """A result that has pictures and a report besides."""

    def report(
        self, path: str | Path, rig: "Rig | None" = None, *, title: str = "", records: "Records | None" = None
    ) -> Path:
        """Write the HTML report, one file that needs no network.

        **Arguments:** ``rig`` as for `summary`; ``records``: recordings that the vectors are from, shown as recorded
        where the rig is given. **Returns** the path.
        """
        return _results().write_report(Path(path), self, rig, title=title, records=records)

    @property
    def plot(self) -> "Plots":
        """Its pictures, each drawn on the axes that one gives or on new ones: ``found.plot.amplitude()``."""
        return importlib.import_module("rotorjax.reporting.pictures").Plots(self)
