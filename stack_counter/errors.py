# SPDX-License-Identifier: Apache-2.0
"""Errors: one class for each cause that a caller can act on.

Every message holds the value seen and the value expected, on one line.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class StackCounterError(Exception):
    """Base of all errors raised on purpose by this package."""


class ConfigError(StackCounterError):
    """A setting is missing, unknown or out of range. The user mends the configuration."""


class PartError(StackCounterError):
    """The part is unknown or its unit volume is not a positive number. The user names another."""


class MeshError(StackCounterError):
    """A CAD file is not the one solid that is expected. The user mends it, or names another."""


class BagError(StackCounterError):
    """A recording cannot be read or lacks what a count needs. The user records again."""


class ScanError(StackCounterError):
    """The views of a scan do not suffice for a count. The caller scans again."""


class WeightsError(StackCounterError):
    """A weights file is missing, damaged or of another estimator. The user names another file."""


class LostWorkerError(StackCounterError):
    """The processes that were to do a task have been killed. The user gives them more memory."""


class ViewError(StackCounterError):
    """One view is refused; the scan goes on without it.

    Attributes:
        reason: short slug under which the view is counted as skipped, e.g. ``no_tf``.
    """

    def __init__(self, reason: str, message: str):
        """Makes the error; its text is `reason: message`."""
        super().__init__(f"{reason}: {message}")
        self.reason, self._message = reason, message

    def on(self, topic: str) -> ViewError:
        """Returns the error with the name of the topic that has given rise to it."""
        return ViewError(self.reason, f"{topic}: {self._message}")


# Packages that `make setup-cell` leaves out and commands import as they start.
_LEFT_OUT_OF_CELLS = ("torch", "sapien", "coacd", "manifold3d", "matplotlib")


@contextmanager
def naming_missing_packages() -> Iterator[None]:
    """Has the lack of a package that `make setup-cell` leaves out be a wrong set-up, no defect.

    Raises:
        ConfigError: in place of the error of the import; other modules that are missing are
            defects, and their error stays.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in _LEFT_OUT_OF_CELLS:
            raise
        raise ConfigError(f"this takes the package {package}, which is not installed; expected "
                          "what make clean setup installs (make setup-cell leaves it out)"
                          ) from error


def defect_line(what: str, error: Exception) -> str:
    """Returns one line for a scan that an exception nobody expected has ended.

    Args:
        what: could not be done, e.g. `counted`.
        error: the exception.
    """
    said = " ".join(str(error).split())[:200]
    return (f"the scan could not be {what}: {type(error).__name__}: {said}; expected a scan that "
            "can be: send its recording and the node's log to whoever maintains this package")


def exit_code_of(error: BaseException) -> int:
    """Returns the exit code of a command that an error ends, or of one of its tasks.

    2: the command line, part, configuration or a path, which the user mends; 3: a recording that
    cannot give a count; 1: a defect of this package, or a worker that was lost.
    """
    if isinstance(error, (ConfigError, MeshError, PartError, WeightsError, OSError)):
        return 2
    if isinstance(error, StackCounterError) and not isinstance(error, LostWorkerError):
        return 3
    return 1
