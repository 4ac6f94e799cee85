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

    def handleError(self, record: logging.LogRecord) -> None:
        pass

    def close(self) -> None:
        try:
            self._file.close()
        except OSError:
            pass
        super().close()
