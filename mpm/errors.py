"""The ways a run ends badly, each with its exit code."""

INTERRUPTED = 130  # exit code after Ctrl-C, as a shell expects


class SceneError(ValueError):
    """Bad input (exit code 2): every problem found, one message a line."""

    exit_code = 2

    def __init__(self, problems):
        self.problems = [problems] if isinstance(problems, str) else list(problems)
        super().__init__("\n".join(self.problems))

    def __reduce__(self):  # what another process raises is one of several problems still
        return type(self), (self.problems,)


class NumericalError(RuntimeError):
    """A run that cannot go on (exit code 3): says the time, the step, the point and what is saved."""

    exit_code = 3


class StepRefused(NumericalError):
    """A step that was not taken because it would be unstable; the state before it is whole."""
