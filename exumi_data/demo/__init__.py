"""The demonstration: a simulated play session as a dataset, and a picture of one grasp."""

from exumi_data.demo.dataset import (
    DATASET_NAME,
    DemoSettings,
    dataset_metadata,
    make_session,
    write_play_dataset,
)
from exumi_data.demo.deviation import Deviation, deviation_of
from exumi_data.demo.folder import DemoFolder, demo_folder
from exumi_data.demo.picture import ShownGrasp, draw_grasp, shown_grasp
from exumi_data.demo.story import SheetWindow, window_of_episode
from exumi_data.demo.touches import TouchSettings, write_touch_dataset

__all__ = [
    "DATASET_NAME",
    "DemoFolder",
    "DemoSettings",
    "Deviation",
    "SheetWindow",
    "ShownGrasp",
    "TouchSettings",
    "dataset_metadata",
    "demo_folder",
    "deviation_of",
    "draw_grasp",
    "make_session",
    "shown_grasp",
    "window_of_episode",
    "write_play_dataset",
    "write_touch_dataset",
]
