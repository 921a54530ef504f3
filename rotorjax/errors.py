"""The error that a user's input causes."""

from collections.abc import Callable

MOST_PROBLEMS = 20
"""Problems of one input that are shown."""


class InputError(ValueError):
    """Input from a user that cannot be used: one line per problem, each with place and cure."""

    def __init__(self, *problems: str):
        super().__init__("\n".join(problems))
        self.problems = problems

    def shown(self) -> list[str]:
        """The problems as they are shown: the first ones, and how many more there are."""
        more = len(self.problems) - MOST_PROBLEMS
        return [*self.problems[:MOST_PROBLEMS], *([f"and {more} more problems"] if more > 0 else [])]


def do_every(*tasks: Callable[[], object] | None) -> None:
    """Do one after the other, whatever becomes of those before.

    **Arguments:** ``tasks``; none where there is nothing to do. **Errors.** One `InputError` of all that was refused.
    """
    problems: list[str] = []
    for task in tasks:
        try:
            if task is not None:
                task()
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(*problems)
