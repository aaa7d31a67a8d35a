"""Tactile images: grey, contact representation, activity, salient frames, choice of a reference.

Everything here works on uint8 images of one sensor, which `rectification` makes straight; a
gripper's two fingers are put together by `combined`. Grey levels are 0 to 255. A *reference image*
shows the sensor without contact.

OpenCV is imported where it is used, so that importing this package costs nothing.
"""

from exumi_data.tactile.activity import (
    ACTIVE_THRESHOLD,
    ACTIVE_THRESHOLD_COMBINED,
    ACTIVITY_METHOD,
    ACTIVITY_SIZE,
    PIXEL_THRESHOLD,
    ActivityMeter,
    active_pixels,
)
from exumi_data.tactile.combined import Combiner, combined_scale
from exumi_data.tactile.fingers import pattern_difference, resembled_finger
from exumi_data.tactile.images import REPRESENTATION_GAIN, representation, to_grey
from exumi_data.tactile.painting import paint_change
from exumi_data.tactile.rectification import PixelMap, Rectifier, read_ninedtact
from exumi_data.tactile.reference import (
    REFERENCE_METHOD,
    ReferenceChoice,
    choose_reference,
    reference_image,
    thumbnail,
)
from exumi_data.tactile.salience import SALIENCE_METHOD, difference_energy, salient_frames

__all__ = [
    "ACTIVE_THRESHOLD",
    "ACTIVE_THRESHOLD_COMBINED",
    "ACTIVITY_METHOD",
    "ACTIVITY_SIZE",
    "PIXEL_THRESHOLD",
    "REFERENCE_METHOD",
    "REPRESENTATION_GAIN",
    "SALIENCE_METHOD",
    "ActivityMeter",
    "Combiner",
    "PixelMap",
    "Rectifier",
    "ReferenceChoice",
    "active_pixels",
    "choose_reference",
    "combined_scale",
    "difference_energy",
    "paint_change",
    "pattern_difference",
    "read_ninedtact",
    "reference_image",
    "representation",
    "resembled_finger",
    "salient_frames",
    "thumbnail",
    "to_grey",
]
