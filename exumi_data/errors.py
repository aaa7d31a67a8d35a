"""The errors that users meet.

Every error says *what* is wrong, *where* (path, stream, frame) and *what to do*, and carries these
as fields, so that a program can act on them. Tree::

    ExumiError
    ├── UsageError            wrong argument or option; nothing was read or written
    ├── NotAnEpisodeError     the path holds no episode or dataset
    ├── UnsupportedError      a newer format, or a feature this version does not know
    ├── MetadataError         the metadata breaks the standard
    ├── DamagedDataError      bytes are missing or wrong
    │   └── ChangedDataError  they are not those of what was opened
    ├── LimitError            a file asks for more memory than it may
    ├── SourceError           a file to convert cannot be read
    ├── EpisodeExistsError    the final name is taken
    ├── UnreachableError      a server does not answer, or does not let us in
    └── MissingExtraError     an optional dependency is not installed (also an ImportError)
"""

from exumi_data.redaction import without_secrets

__all__ = [
    "ChangedDataError",
    "DamagedDataError",
    "EpisodeExistsError",
    "ExumiError",
    "LimitError",
    "MetadataError",
    "MissingExtraError",
    "NotAnEpisodeError",
    "SourceError",
    "UnreachableError",
    "UnsupportedError",
    "UsageError",
]


class ExumiError(Exception):
    """Base of all errors that this package raises on purpose.

    Parameters
    ----------
    what : str
        What is wrong, in one sentence without a full stop.
    where : object, optional
        Path, stream or frame that it is about.
    fix : str, optional
        What the user can do.
    """

    def __init__(self, what: str, *, where: object = None, fix: str | None = None) -> None:
        self.what = without_secrets(what)
        self.where = None if where is None else without_secrets(str(where))
        self.fix = None if fix is None else without_secrets(fix)
        super().__init__(str(self))

    @property
    def reason(self) -> str:
        """What is wrong and what to do, where it is clear what it is about."""
        return self.what if self.fix is None else f"{self.what}. {self.fix}"

    def __str__(self) -> str:
        return self.reason if self.where is None else f"{self.where}: {self.reason}"

    def __reduce__(self) -> tuple[object, ...]:
        # Exceptions with keyword-only fields cross process borders only with help.
        return (_rebuild, (type(self), self.what, self.where, self.fix))


def _rebuild(
    cls: type["ExumiError"], what: str, where: str | None, fix: str | None
) -> "ExumiError":
    return cls(what, where=where, fix=fix)


class UsageError(ExumiError):
    """A wrong argument or option; nothing was read or written."""


class NotAnEpisodeError(ExumiError):
    """The path holds no episode and no dataset."""


class UnsupportedError(ExumiError):
    """A newer format version, or a feature that this version does not know."""


class MetadataError(ExumiError):
    """The metadata breaks the standard.

    Attributes
    ----------
    problems : tuple of str
        All problems found, one line each, ``message @ $.json.path``.
    """

    def __init__(
        self,
        what: str,
        *,
        where: object = None,
        fix: str | None = None,
        problems: tuple[str, ...] = (),
    ) -> None:
        self.problems = problems
        super().__init__(what, where=where, fix=fix)

    def __reduce__(self) -> tuple[object, ...]:
        return (*super().__reduce__(), {"problems": self.problems})


class DamagedDataError(ExumiError):
    """Bytes are missing or wrong: a missing shard, a wrong checksum, a file cut short."""


class ChangedDataError(DamagedDataError):
    """A file was replaced, rewritten or removed after its episode was opened."""


class LimitError(ExumiError):
    """A file asks for more memory than it may."""


class SourceError(ExumiError):
    """A file to convert cannot be read."""


class EpisodeExistsError(ExumiError):
    """The final name of an episode is already taken."""


class UnreachableError(ExumiError):
    """A server does not answer, does not let us in, or cannot do what it has to.

    Nothing is said of the data: the same call may succeed later.
    """


class MissingExtraError(ExumiError, ImportError):
    """An optional dependency is not installed."""
