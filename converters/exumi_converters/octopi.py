"""Format ``octopi``: the PhysiCLeAR data of Octopi-1 and Octopi-1.5, in their three layouts."""

import re
from fractions import Fraction
from pathlib import Path

from exumi_converters.converter import ConvertOptions, Discovery, EpisodeSource, NamedSplit
from exumi_converters.format_options import FormatOptions
from exumi_converters.frame_files import FrameFiles, add_jpeg_stream, add_lossy, add_png_stream
from exumi_converters.image_stream import StreamSpec
from exumi_converters.octopi_items import ItemMaker
from exumi_converters.octopi_labels import PartLabels, read_labels
from exumi_converters.octopi_layout import detect_layout
from exumi_converters.octopi_samples import frame_paths, read_frames
from exumi_converters.video_episode import add_video
from exumi_data.errors import ExumiError, UsageError
from exumi_data.model import LossyStep, QualityNote
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.video import probe_video
from exumi_data.time import parse_rate

__all__ = ["OctopiConverter"]

_SPLITS = (
    NamedSplit("octopi1", "part", "published with Octopi-1: part ids, 60 train, 7 val, 7 test"),
    NamedSplit("octopi15", "part", "published with Octopi-1.5: part ids, 104 train, 6 val, 7 test"),
)


_CLIP = re.compile(r".+_\d{1,9}\.mov", re.IGNORECASE)


class OctopiConverter:
    """Clips become episodes with their video kept verbatim; processed samples keep their JPEGs."""

    name = "octopi"
    version = "1"
    id_version = 1
    describes = "PhysiCLeAR clips of Octopi-1, or the raw tree or processed samples of Octopi-1.5"
    keeps: tuple[str, ...] = (
        "every clip's file, byte for byte (processed samples: every JPEG)",
        "part, object, trial, procedure and pad type",
        "labels with scale, provenance and origin, and the published splits",
    )
    loses: tuple[str, ...] = ("anything in a PNG frame but its pixels (ObjectFolder)",)
    options = FormatOptions

    def recognise(self, source: Path) -> str | None:
        """Recognise one of the layouts; a flat folder by names like ``<part_id>_<trial>.mov``."""
        try:
            layout = detect_layout(source)
        except (ExumiError, OSError):
            return None
        if layout.name == "Octopi-1":
            videos = [path for path in source.iterdir() if probe_video(path.name)]
            if not all(_CLIP.fullmatch(path.name) for path in videos):
                return None
        return f"{layout.name}: {layout.reason}"

    def discover(self, source: Path, options: ConvertOptions) -> Discovery:
        """Recognise the layout and list its clips or samples."""
        if options.rate is not None:
            _parse(options.rate)
        labels: dict[str, PartLabels] = {}
        notices: list[str] = []
        if options.labels is not None:
            labels, notices = read_labels(options.labels)
        layout = detect_layout(source)
        maker = ItemMaker(source, options, labels if options.labels is not None else None)
        items = layout.items(maker)
        notices += layout.notices
        notices += maker.notices()
        used = {name for item in items for name in item.splits}
        return Discovery(
            layout=f"{layout.name}: {layout.reason}",
            items=tuple(items),
            notices=tuple(notices),
            failed=tuple(maker.failed),
            splits=tuple(split for split in _SPLITS if split.name in used),
        )

    def convert(self, item: EpisodeSource, writer: EpisodeWriter) -> int:
        """Write one clip or sample."""
        spec = StreamSpec(**item.settings["stream"])
        if "rate" in item.settings:
            return _convert_sample(item, writer, spec)
        inputs = writer.metadata.source.inputs or []
        usual = item.settings.get("usual_frames")
        return add_video(
            writer, spec, item.files[0].path, inputs[0], usual_frames=usual
        ).stream.count


def _parse(text: str) -> Fraction:
    try:
        return parse_rate(text)
    except ValueError as error:
        raise UsageError(str(error)) from None


def _convert_sample(item: EpisodeSource, writer: EpisodeWriter, spec: StreamSpec) -> int:
    folder = item.files[0].path
    rate = _parse(item.settings["rate"])
    paths = frame_paths(folder)
    files = FrameFiles(lambda: read_frames(paths), 1 / rate, rate, folder, clock="none")
    if item.settings["rate_is_assumed"]:
        writer.metadata.quality.append(_assumed_rate(spec.name, rate))
    if paths[0].suffix.lower() == ".png":
        return add_png_stream(writer, spec, files).stream.count
    added = add_jpeg_stream(writer, spec, files)
    if item.settings["processed"]:
        _note_processing(writer, spec.name)
    return added.stream.count


def _assumed_rate(stream: str, rate: Fraction) -> QualityNote:
    return QualityNote(
        code="assumed-rate",
        message=f"the source does not say its frame rate; {rate} frames/s were assumed",
        stream=stream,
    )


def _note_processing(writer: EpisodeWriter, stream: str) -> None:
    by = "process_datasets.py of Octopi-1.5"
    add_lossy(
        writer,
        LossyStep(
            step="frame-selection",
            stream=stream,
            detail="of the clip's frames only a few (5 to 10, in up to two runs) were kept before "
            "this conversion; the files' numbers say which",
            by=by,
        ),
    )
    add_lossy(
        writer,
        LossyStep(
            step="jpeg-encode",
            stream=stream,
            detail="the clip's frames were decoded and encoded as JPEG before this conversion",
            by=by,
        ),
    )
