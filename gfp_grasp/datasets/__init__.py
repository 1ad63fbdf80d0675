"""Data sets on disk: meshes of objects (ModelNet40, ShapeNet, plain folders), and KITTI's scans of traffic."""

from gfp_grasp.datasets.kitti import ALIKE, Scan, TrafficBox, accumulated, read_bin, read_scans, read_tracks
from gfp_grasp.datasets.layouts import LAYOUTS, layout_of, read_dataset
from gfp_grasp.datasets.modelnet import MODELNET_CLASSES, read_modelnet, whole_shapes

__all__ = [
    "ALIKE",
    "LAYOUTS",
    "MODELNET_CLASSES",
    "Scan",
    "TrafficBox",
    "accumulated",
    "layout_of",
    "read_bin",
    "read_dataset",
    "read_modelnet",
    "read_scans",
    "read_tracks",
    "whole_shapes",
]
