"""Between a session and the one who runs it: a live table, plain lines, or JSON lines.

What is said is written by a thread of its own: a connection that hangs, a reader that does not
read, or a terminal that is gone never holds up the session.
"""

import json
import os
import sys
import threading
import time
from collections import deque
from contextlib import ExitStack, closing, suppress
from typing import TYPE_CHECKING, Any, Self, TextIO

from exumi_recorders.session.keys import read_keys, read_lines
from exumi_recorders.session.messages import COMMANDS, Message, SessionStatus
from exumi_recorders.session.session import Session
from exumi_recorders.session.terminal import draw_status, status_document

if TYPE_CHECKING:
    from rich.live import Live

__all__ = ["Operator", "age_text"]

_STYLES = {"info": "", "warning": "yellow", "error": "bold red"}
_PERIOD_S = 0.5
_MOST_WAITING = 1000
_LAST_WORDS_S = 2.0


def age_text(age_s: float | None) -> str:
    """Write the age of a calibration for people.

    Parameters
    ----------
    age_s : float, optional
        None where there is none.
    """
    if age_s is None:
        return "not calibrated"
    if age_s < 3600:
        return f"{age_s / 60:.0f} min old"
    return f"{age_s / 3600:.0f} h old" if age_s < 48 * 3600 else f"{age_s / 86400:.0f} days old"


class Operator:
    """Shows a session on the terminal and takes the operator's keys, while the block runs.

    Parameters
    ----------
    as_json : bool
        JSON lines on stdout, commands as lines on stdin.
    quiet : bool
        Say nothing but warnings.
    keys : bool
        Take keys; a session that runs by itself has no use for them.
    """

    def __init__(self, *, as_json: bool = False, quiet: bool = False, keys: bool = True) -> None:
        self._takes_keys = keys
        self._keys = ExitStack()
        self._writer: _JsonWriter | _TerminalWriter = (
            _JsonWriter() if as_json else _TerminalWriter(quiet=quiet)
        )
        self._as_json = as_json
        self._said: deque[Message | str | dict[str, Any]] = deque(maxlen=_MOST_WAITING)
        self._status: SessionStatus | None = None
        self._wake = threading.Event()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="operator", daemon=True)

    def __enter__(self) -> Self:
        self._writer.open()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._wake.set()
        self._thread.join(_LAST_WORDS_S)
        self._keys.close()

    def attend(self, session: Session, *, sync_age_s: float | None, preview: str | None) -> None:
        """Begin to show a session, and to listen.

        Parameters
        ----------
        session : Session
        sync_age_s : float, optional
            Age of the latency calibration by now.
        preview : str, optional
            Where the preview is.
        """
        self._writer.preview = preview
        if sync_age_s is not None:
            self._writer.synced_at = time.monotonic() - sync_age_s

        def want(name: str, reason: str = "") -> None:
            if name in COMMANDS:
                session.command(name, reason)
            else:
                text = f"there is no command {name[:40]!r}; there are: {', '.join(COMMANDS)}"
                self.tell(Message("warning", "unknown_command", text))

        if self._as_json:
            self._keys.enter_context(read_lines(want))
        elif self._takes_keys:
            self._writer.has_keys = self._keys.enter_context(read_keys(want))
            self._writer.is_live = self._writer.has_keys
        else:
            self._writer.is_live = True

    @property
    def sync_age_s(self) -> float | None:
        """How old the latency calibration is by now, seconds; None where there is none."""
        return self._writer.sync_age_s

    def tell(self, message: Message) -> None:
        """Say what happened; for any thread.

        Parameters
        ----------
        message : Message
        """
        self._said.append(message)
        self._wake.set()

    def show(self, status: SessionStatus) -> None:
        """Show how the session is.

        Parameters
        ----------
        status : SessionStatus
        """
        self._status = status

    def end(self, document: dict[str, Any], text: str) -> None:
        """Say how it ended; the last thing that is said.

        Parameters
        ----------
        document : dict
            For programs.
        text : str
            For people.
        """
        self._status = None
        self._said.append(document if self._as_json else text)
        self._wake.set()

    def _run(self) -> None:
        # When nobody is there any more, what is said goes nowhere.
        with suppress(OSError, ValueError), closing(self._writer) as writer:
            shown: SessionStatus | None = None
            due = 0.0
            while not self._ending.is_set():
                self._wake.wait(_PERIOD_S / 2)
                self._wake.clear()
                self._say_all(writer)
                status, now = self._status, time.monotonic()
                if status is not None and status is not shown and now >= due:
                    shown, due = status, now + _PERIOD_S
                    writer.show(status)
            writer.finish()
            self._say_all(writer)

    def _say_all(self, writer: "_JsonWriter | _TerminalWriter") -> None:
        while self._said:
            writer.say(self._said.popleft())


class _Writer:
    """What both have: a file of their own, which nobody else waits for or flushes."""

    name = "stderr"

    def __init__(self) -> None:
        self.synced_at: float | None = None
        self.preview: str | None = None
        self.has_keys = False
        self.is_live = False
        self._is_own = False

    @property
    def sync_age_s(self) -> float | None:
        """How old the latency calibration is by now, seconds."""
        return None if self.synced_at is None else time.monotonic() - self.synced_at

    def _own_file(self) -> TextIO:
        shared: TextIO = getattr(sys, self.name)
        with suppress(OSError, ValueError, AttributeError):
            shared.flush()
            file = os.fdopen(
                os.dup(shared.fileno()), "w", encoding=shared.encoding, errors="backslashreplace"
            )
            self._is_own = True
            return file
        return shared  # no real file

    def _close(self, file: TextIO) -> None:
        if self._is_own:
            with suppress(OSError):
                file.close()


class _JsonWriter(_Writer):
    """One JSON object a line."""

    name = "stdout"

    def open(self) -> None:
        self._file = self._own_file()

    def close(self) -> None:
        self._close(self._file)

    def say(self, said: Message | str | dict[str, Any]) -> None:
        if isinstance(said, Message):
            document = {"type": "message", "level": said.level, "code": said.code}
            document["text"] = said.text
            said = document | ({} if said.episode is None else {"episode": said.episode})
        self._print(said)

    def show(self, status: SessionStatus) -> None:
        self._print(status_document(status, sync_age_s=self.sync_age_s))

    def finish(self) -> None:
        pass

    def _print(self, document: Any) -> None:
        self._file.write(json.dumps(document, allow_nan=False, default=str) + "\n")
        self._file.flush()


class _TerminalWriter(_Writer):
    """Lines; and below them, where there is a terminal with keys, a table that is drawn anew."""

    def __init__(self, *, quiet: bool) -> None:
        super().__init__()
        self._quiet = quiet
        self._live: Live | None = None

    def open(self) -> None:
        from rich.console import Console

        self._file = self._own_file()

        class Plain(Console):
            def on_broken_pipe(self) -> None:
                """Leave the program as it is; rich would end it."""
                raise BrokenPipeError

        self._console = Plain(file=self._file, highlight=False, emoji=False)

    def close(self) -> None:
        with suppress(OSError):
            self.finish()
        self._close(self._file)

    def say(self, said: Message | str | dict[str, Any]) -> None:
        if not isinstance(said, Message):
            if not self._quiet:
                self._console.print(str(said), markup=False, soft_wrap=True)
            return
        if self._quiet and said.level == "info":
            return
        if said.level != "info":
            self._console.bell()
        self._console.print(
            f"{time.strftime('%H:%M:%S')} {said.text}",
            style=_STYLES[said.level],
            markup=False,
            soft_wrap=True,
        )

    def show(self, status: SessionStatus) -> None:
        if self._quiet or not self.is_live or not self._console.is_terminal:
            return
        if self._live is None:
            from rich.live import Live

            self._live = Live(
                console=self._console,
                auto_refresh=False,
                transient=True,
                redirect_stdout=False,
                redirect_stderr=False,
            )
            self._live.start()
        sync = age_text(self.sync_age_s)
        width, height = self._console.size
        drawn = draw_status(
            status,
            sync=sync,
            preview=self.preview,
            keys=self.has_keys,
            width=width,
            height=height,
        )
        self._live.update(drawn, refresh=True)

    def finish(self) -> None:
        live, self._live = self._live, None
        if live is not None:
            live.stop()
