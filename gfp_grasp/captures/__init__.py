"""A user's own recordings: clouds and captures from files, and their completion."""

from gfp_grasp.captures.capture import Capture, complete_capture
from gfp_grasp.captures.read import SUFFIXES, read_capture

__all__ = ["SUFFIXES", "Capture", "complete_capture", "read_capture"]
