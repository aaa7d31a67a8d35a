"""What a simulated camera does, and exactly when: the truth behind its stamps.

Frame *k* of a camera with period P::

    exposure of row r of H      from  start(k) + readout · r / H   for `exposure`
    start(k)                    =     epoch + phase + k · P
    stamp(k)                    =     start(k) + exposure + latency + jitter(k), cut to µs
    handed out                  at    stamp(k) + readout

So the stamp is when the first row had been exposed and its data had come to the hub, as uvcvideo
stamps a frame with the arrival of its first packet. What a picture shows is spread over
``readout + exposure``; its middle row at mid-exposure shows the truth of

    stamp(k) − jitter(k) − `image_latency_ns`,   image_latency = latency + exposure/2 − readout/2

which is the latency that a calibration has to find. Everything is a pure function of the setup and
k, so that whoever checks a recording knows which frames were lost, and why.
"""

from fractions import Fraction
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from exumi_data.model.base import Rational
from exumi_data.simulation import PlaySession, simulate_play
from exumi_data.time import NS_PER_S
from exumi_recorders.simulated.schedule import FramedSetup

__all__ = ["CameraSetup", "PlaySetup"]


class PlaySetup(BaseModel):
    """Which play session the world is: the same arguments give the same truth in every process."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    seed: int = Field(default=0, ge=0)
    duration_s: float = Field(default=20.0, ge=3.0)
    objects: tuple[str, ...] | None = None
    dotted: bool = False
    taps: int = Field(default=0, ge=0)

    def session(self, *, size: tuple[int, int] = (240, 320)) -> PlaySession:
        """Return the session, with images of (height, width) pixels."""
        return simulate_play(
            seed=self.seed,
            duration_s=self.duration_s,
            objects=self.objects,
            tactile_size=size,
            rgb_size=size,
            dotted=self.dotted,
            taps=self.taps,
        )


class CameraSetup(FramedSetup):
    """A simulated camera, served as `FramedSetup` says.

    Attributes
    ----------
    shows : {"tactile_left", "tactile_right", "rgb", "synthetic"}
        The play session seen by one of its cameras; or pictures without meaning, of
        `bytes_per_frame`, which cost the sender next to nothing.
    width, height, rate, quality
        Pixels, images per second, JPEG quality.
    exposure_ns, readout_ns : int
        Exposure of a row; from the first row to the last one.
    latency_ns : int
        From the end of the first row's exposure to the stamp.
    bands, exposures : int
        How finely readout and exposure are drawn: a picture is put together of `bands` strips, and
        each of the mean of `exposures` moments.
    live : bool
        Draw a frame when it is due; a frame that is not done in time is lost, as on a camera that
        is too slow. Otherwise all of the session is drawn before the socket is there, and its last
        second repeats for ever after.
    """

    shows: Literal["tactile_left", "tactile_right", "rgb", "synthetic"] = "synthetic"
    play: PlaySetup = PlaySetup()
    width: int = Field(default=640, ge=32, le=8192)
    height: int = Field(default=480, ge=32, le=8192)
    rate: Rational = "30"
    quality: int = Field(default=90, ge=1, le=100)
    bytes_per_frame: int = Field(default=80_000, ge=2_000, le=16 << 20)
    exposure_ns: int = Field(default=0, ge=0)
    readout_ns: int = Field(default=0, ge=0)
    latency_ns: int = Field(default=20_000_000, ge=0)
    bands: int = Field(default=4, ge=1, le=64)
    exposures: int = Field(default=2, ge=1, le=16)
    live: bool = False

    @property
    def period(self) -> Fraction:
        """Nanoseconds from one frame to the next."""
        return NS_PER_S / Fraction(self.rate)

    @property
    def image_latency_ns(self) -> int:
        """From what the middle row shows, at mid-exposure, to the stamp (without its jitter)."""
        return self.latency_ns + self.exposure_ns // 2 - self.readout_ns // 2

    @property
    def frames_of_session(self) -> int:
        """How many frames the session has."""
        return int(self.play.duration_s * Fraction(self.rate))

    def exposure_start_ns(self, k: int) -> int:
        """Return when the first row of frame `k` begins to be exposed, CLOCK_MONOTONIC."""
        return self.start_ns(k)

    @property
    def stamp_delay_ns(self) -> int:
        """From the start of a frame to its stamp, without jitter."""
        return self.exposure_ns + self.latency_ns

    @property
    def hand_out_delay_ns(self) -> int:
        """From the stamp until the frame is handed out."""
        return self.readout_ns

    def shown_ns(self, k: int) -> int:
        """Return the moment that the middle of picture `k` shows, CLOCK_MONOTONIC."""
        return self.exposure_start_ns(k) + self.readout_ns // 2 + self.exposure_ns // 2
