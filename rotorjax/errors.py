"""The error that a user's input causes."""


class InputError(ValueError):
    """Input from a user that cannot be used: one line per problem, each with place and cure."""

    def __init__(self, *problems: str):
        super().__init__("\n".join(problems))
        self.problems = problems
