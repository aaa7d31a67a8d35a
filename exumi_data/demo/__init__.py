"""The demonstration: a simulated play session as a dataset, and a picture of one grasp."""

from exumi_data.demo.dataset import DATASET_NAME, DemoSettings, make_session, write_play_dataset
from exumi_data.demo.picture import ShownGrasp, draw_grasp, shown_grasp
from exumi_data.demo.story import SheetWindow, window_of_episode
from exumi_data.demo.touches import TouchSettings, write_touch_dataset

__all__ = [
    "DATASET_NAME",
    "DemoSettings",
    "SheetWindow",
    "ShownGrasp",
    "TouchSettings",
    "draw_grasp",
    "make_session",
    "shown_grasp",
    "window_of_episode",
    "write_play_dataset",
    "write_touch_dataset",
]
