"""Between a session and the one who runs it: a live table, plain lines, or JSON lines."""

import json
import sys
import threading
import time
from contextlib import ExitStack
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from exumi_recorders.session.keys import read_keys, read_lines
from exumi_recorders.session.session import CommandName, Message, Session, SessionStatus
from exumi_recorders.session.terminal import draw_status, status_document

if TYPE_CHECKING:
    from rich.console import Console
    from rich.live import Live

__all__ = ["Operator", "age_text"]

_STYLES = {"info": "", "warning": "yellow", "error": "bold red"}
_JSON_PERIOD_S = 0.5
_DRAWN_A_SECOND = 4


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
        self._as_json = as_json
        self._quiet = quiet
        self._keys = keys
        self._console: Console | None = None
        self._live: Live | None = None
        self._stack = ExitStack()
        self._sync_age_s: float | None = None
        self._preview: str | None = None
        self._told_at = 0.0
        self._lock = threading.Lock()

    def __enter__(self) -> Self:
        if not self._as_json:
            from rich.console import Console

            self._console = Console(stderr=True, highlight=False, emoji=False)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def attend(self, session: Session, *, sync_age_s: float | None, preview: str | None) -> None:
        """Begin to show a session, and to listen.

        Parameters
        ----------
        session : Session
        sync_age_s : float, optional
            Age of the latency calibration.
        preview : str, optional
            Where the preview is.
        """
        self._sync_age_s, self._preview = sync_age_s, preview

        def want(name: str, reason: str = "") -> None:
            wanted: CommandName = name  # type: ignore[assignment]  # keys and lines know these only
            session.command(wanted, reason)

        if self._as_json:
            self._stack.enter_context(read_lines(want))
        elif not self._keys or self._stack.enter_context(read_keys(want)):
            self._show_live()

    def _show_live(self) -> None:
        from rich.live import Live

        if self._console is not None and self._console.is_terminal and not self._quiet:
            self._live = self._stack.enter_context(
                Live(console=self._console, refresh_per_second=_DRAWN_A_SECOND, transient=True)
            )

    def tell(self, message: Message) -> None:
        """Say what happened.

        Parameters
        ----------
        message : Message
        """
        if self._as_json:
            self._print({"type": "message", **_said(message)})
        elif self._console is not None and not (self._quiet and message.level == "info"):
            if message.level != "info":
                self._console.bell()
            self._console.print(
                f"{time.strftime('%H:%M:%S')} {message.text}",
                style=_STYLES[message.level],
                markup=False,
                soft_wrap=True,
            )

    def show(self, status: SessionStatus) -> None:
        """Show how the session is.

        Parameters
        ----------
        status : SessionStatus
        """
        if self._as_json:
            now = time.monotonic()
            if now - self._told_at >= _JSON_PERIOD_S:
                self._told_at = now
                self._print(status_document(status, sync_age_s=self._sync_age_s))
        elif self._live is not None:
            sync = age_text(self._sync_age_s)
            self._live.update(
                draw_status(status, sync=sync, preview=self._preview, keys=self._keys)
            )

    def end(self, document: dict[str, Any], text: str) -> None:
        """Say how it ended.

        Parameters
        ----------
        document : dict
            For programs.
        text : str
            For people.
        """
        self._stack.close()
        if self._as_json:
            self._print(document)
        elif self._console is not None and not self._quiet:
            self._console.print(text, markup=False)

    def _print(self, document: dict[str, Any]) -> None:
        with self._lock:
            sys.stdout.write(json.dumps(document, allow_nan=False, default=str) + "\n")
            sys.stdout.flush()


def _said(message: Message) -> dict[str, Any]:
    said = {"level": message.level, "code": message.code, "text": message.text}
    return said | ({} if message.episode is None else {"episode": message.episode})
