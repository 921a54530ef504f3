"""What `rotorjax.discovery.explain` does after its search, as far as the budget reaches."""

from typing import NamedTuple

from rotorjax.discovery.progress import Progress
from rotorjax.inference.budget import Budget


class Stages(NamedTuple):
    """What is done after the search, as far as the budget reaches."""

    budget: Budget
    thorough: bool
    progress: Progress
    untried: list[str]

    def go(self, what: str) -> bool:
        """Whether there is budget left for a stage; what is left out is noted."""
        if not self.thorough:
            return False
        if self.budget.exhausted:
            self.untried.append(what)
            return False
        self.progress(what)
        return True

    def ended(self, what: str) -> None:
        """Note a stage in which the budget ran out."""
        if self.budget.exhausted:
            self.untried.append(f"part of {what}")
