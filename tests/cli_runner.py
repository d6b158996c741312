"""Calls the command line in this process, as tests of it do."""

from __future__ import annotations

from dataclasses import dataclass

from fastslam.cli import application
from typer.testing import CliRunner


@dataclass(frozen=True)
class Outcome:
    """What a command left behind."""

    exit_code: int
    stdout: str
    stderr: str

    def assert_one_line_error(self, *, exit_code: int, contains: str) -> None:
        """The error contract: one line on stderr, nothing on stdout, no traceback."""
        assert self.exit_code == exit_code, (self.exit_code, self.stdout, self.stderr)
        assert "Traceback" not in self.stdout + self.stderr
        assert self.stdout == ""
        lines = self.stderr.splitlines()
        errors = [line for line in lines if line.startswith("error: ")]
        assert len(errors) == 1 and lines[-1] == errors[0], self.stderr
        assert contains in errors[0], errors[0]


def _runner() -> CliRunner:
    """One that keeps stdout and stderr apart, which click did not do by itself before 8.2."""
    try:
        return CliRunner(mix_stderr=False)  # type: ignore[call-arg]
    except TypeError:
        return CliRunner()


def fastslam(*arguments: object) -> Outcome:
    """Runs `fastslam ARGUMENTS...`; an unexpected exception of the command is raised here."""
    result = _runner().invoke(application(), [str(argument) for argument in arguments], prog_name="fastslam")
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return Outcome(result.exit_code, result.stdout, result.stderr)
