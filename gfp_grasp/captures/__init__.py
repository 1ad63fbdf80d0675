"""A user's own recordings: clouds and captures from files, and their completion."""

from gfp_grasp.captures.capture import Capture, complete_capture
from gfp_grasp.captures.pictures import read_depth
from gfp_grasp.captures.read import SAMPLE_FILE, STREET_FILE, SUFFIXES, read_capture

__all__ = ["SAMPLE_FILE", "STREET_FILE", "SUFFIXES", "Capture", "complete_capture", "read_capture", "read_depth"]
