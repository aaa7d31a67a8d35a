"""``--from mcap``: our own files as they were, and other files by Foxglove's schemas."""

from pathlib import Path

from pydantic import Field

from exumi_converters.converter import ConvertOptions, Discovery, EpisodeSource, SourceFile
from exumi_converters.detection import unreadable
from exumi_converters.format_options import FormatOptions, parse_options
from exumi_converters.identity import relative_name
from exumi_converters.mcap_files.foreign import ForeignFile
from exumi_converters.mcap_files.own_record import read_own_record
from exumi_converters.mcap_files.restoring import RestoredFile
from exumi_converters.mcap_files.topics import require_mcap
from exumi_converters.report import Failure
from exumi_converters.source_folder import source_files
from exumi_data.errors import ExumiError, SourceError
from exumi_data.model import UNKNOWN_LICENCE, Task
from exumi_data.store.episode_writer import EpisodeWriter

__all__ = ["McapConverter", "McapReadOptions"]

_MAGIC = b"\x89MCAP0\r\n"
_HEAD_RECORDS = 4096


class McapReadOptions(FormatOptions):
    """What only this format can be told."""

    tactile: str = Field(
        "", description="Topics of tactile images, separated by commas; other images are rgb."
    )


class McapConverter:
    """A file an episode. Files that exUMI wrote become the episodes that they were."""

    name = "mcap"
    version = "1"
    id_version = 1
    describes = "MCAP files with Foxglove's schemas, such as exumi convert --to mcap writes"
    keeps: tuple[str, ...] = (
        "of files that exUMI wrote: everything but the id, which becomes parent_id",
        "of other files: CompressedImage and RawImage, FrameTransform, PoseInFrame, RawAudio",
        "JPEGs byte for byte, times to the nanosecond",
    )
    loses: tuple[str, ...] = (
        "messages in other schemas and encodings (each topic is named)",
        "messages that cannot be read, or go back in time (they are counted)",
    )
    options: type[FormatOptions] = McapReadOptions

    def recognise(self, source: Path) -> str | None:
        """Recognise files by their first bytes."""
        paths = [source] if source.is_file() else _files(source)
        found = next((path for path in paths if _is_mcap(path)), None)
        return None if found is None else f"{found.name} begins as MCAP files do"

    def discover(self, source: Path, options: ConvertOptions) -> Discovery:
        """Find the files, and read what each says of itself."""
        require_mcap()
        told = parse_options(McapReadOptions, options.settings, self.name)
        root = source.parent if source.is_file() else source
        paths = [source] if source.is_file() else _files(source)
        if not paths:
            raise SourceError("there is no .mcap file", where=source)
        items, failed = [], []
        for path in paths:
            name = relative_name(path, root)
            try:
                items.append(_item(path, name, options, told))
            except OSError as error:
                failed.append(Failure(name, str(unreadable(path, error))))
            except ExumiError as error:
                failed.append(Failure(name, str(error)))
        return Discovery(
            layout=f"{len(paths)} MCAP file(s)", items=tuple(items), failed=tuple(failed)
        )

    def convert(self, item: EpisodeSource, writer: EpisodeWriter) -> int:
        """Write the streams of one file."""
        path = item.files[0].path
        if item.settings["own"]:
            return RestoredFile(path, writer).write()
        return ForeignFile(path, writer, tactile=tuple(item.settings["tactile"])).write()


def _files(source: Path) -> list[Path]:
    return [path for path in source_files(source) if path.suffix == ".mcap"]


def _is_mcap(path: Path) -> bool:
    try:
        if not path.is_file():  # a pipe would be waited for
            return False
        with path.open("rb") as file:
            return file.read(len(_MAGIC)) == _MAGIC
    except OSError:
        return False


def _item(path: Path, name: str, options: ConvertOptions, told: McapReadOptions) -> EpisodeSource:
    if not _is_mcap(path):
        if path.is_file():
            path.open("rb").close()  # says why, if it cannot be read
        raise SourceError("is no MCAP file: it begins otherwise", where=path)
    files = (SourceFile(path, name),)
    own = read_own_record(path)
    if own is None:
        topics = [topic.strip() for topic in told.tactile.split(",") if topic.strip()]
        return EpisodeSource(
            key=name,
            files=files,
            task=Task(name=options.task),
            licence=options.licence,
            regime="demonstration",
            settings={"own": False, "tactile": topics},
        )
    metadata = own.metadata
    given = options.licence != UNKNOWN_LICENCE
    return EpisodeSource(
        key=name,
        files=files,
        task=metadata.task,
        licence=options.licence if given else metadata.licence,
        annotations=metadata.annotations,
        regime=metadata.regime,
        settings={"own": True},
        parent_id=metadata.id,
        derived=() if own.derived is None else tuple(own.derived.items),
    )
