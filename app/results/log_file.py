"""The log of a run, log.txt."""

from __future__ import annotations

import logging
import os
from pathlib import Path


class LogFile(logging.StreamHandler):
    """Log file, opened at its end. A line that cannot be written is lost: the log must not cost the run.

    OSError: the file cannot be opened, or is a link.
    """

    def __init__(self, path: Path) -> None:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        self._file = open(handle, "a", encoding="utf-8")
        super().__init__(self._file)
        self.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
        self._passed_on: _PassedOn | None = None
        self._has_set_level = False

    def attach(self, log: logging.Logger) -> None:
        """Take the messages of `log` from INFO on, or from the level that it has been given.

        Other handlers get what they got before: a level of the root logger, say, counts for them.
        """
        log.addHandler(self)
        if log.level == logging.NOTSET:
            if log.propagate:
                self._passed_on = _PassedOn(log.getEffectiveLevel())
                log.addHandler(self._passed_on)
                log.propagate = False
            log.setLevel(logging.INFO)
            self._has_set_level = True

    def detach(self, log: logging.Logger) -> None:
        """End what `attach` began, with the logger as it was."""
        log.removeHandler(self)
        if self._has_set_level:
            log.setLevel(logging.NOTSET)
            self._has_set_level = False
        if self._passed_on is not None:
            log.removeHandler(self._passed_on)
            log.propagate = True
            self._passed_on = None

    def handleError(self, record: logging.LogRecord) -> None:
        pass

    def close(self) -> None:
        try:
            self._file.close()
        except OSError:
            pass
        super().close()


class _PassedOn(logging.Handler):
    """Passes the messages of a logger on to the loggers above it, from a level on."""

    def emit(self, record: logging.LogRecord) -> None:
        above = logging.getLogger(record.name).parent
        if above is not None:
            above.callHandlers(record)


def is_passed_on(log: logging.Logger) -> bool:
    """Whether a log file that is attached passes the messages of a logger on."""
    return any(isinstance(handler, _PassedOn) for handler in log.handlers)
