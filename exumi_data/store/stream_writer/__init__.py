"""Writing one stream: samples are appended, memory stays bounded, nothing is measured twice."""

from exumi_data.store.stream_writer.audio import AudioStreamWriter
from exumi_data.store.stream_writer.base import StreamWriter
from exumi_data.store.stream_writer.data import DataStreamWriter
from exumi_data.store.stream_writer.encoded import EncodedStreamWriter
from exumi_data.store.stream_writer.video import VideoStreamWriter

__all__ = [
    "AudioStreamWriter",
    "DataStreamWriter",
    "EncodedStreamWriter",
    "StreamWriter",
    "VideoStreamWriter",
]
