"""Frames of any encoding: video that Rerun plays is kept as video, all else goes frame by frame."""

from exumi_data.episode import StreamView
from exumi_data.model.images import VideoImages
from exumi_data.model.streams import images_of
from exumi_data.view.frames import OnGrey, log_frames, watch_frames
from exumi_data.view.log import Event, Log
from exumi_data.view.names import ViewOptions
from exumi_data.view.video import log_video, not_playable

__all__ = ["log_pictures"]


def log_pictures(
    log: Log,
    stream: StreamView,
    path: str,
    options: ViewOptions,
    *,
    on_grey: OnGrey | None = None,
) -> list[Event]:
    """Log the frames of a stream.

    Parameters
    ----------
    log : Log
    stream : StreamView
        With frames.
    path : str
    options : ViewOptions
    on_grey : callable, optional
        Told about each frame.

    Returns
    -------
    list of Event
        Frames that are missing.
    """
    if not isinstance(images_of(stream.metadata), VideoImages):
        return log_frames(log, stream, path, on_grey=on_grey)
    why = "asked for" if options.decode_video else not_playable(stream)
    if why is None:
        why = log_video(log, stream, path)
    if why is None:
        if on_grey is not None:
            return watch_frames(log, stream, on_grey)
        log.on_samples(len(stream))
        return []
    log.notes.append(f"{stream.name}: video is shown as decoded frames ({why})")
    return log_frames(log, stream, path, on_grey=on_grey)
