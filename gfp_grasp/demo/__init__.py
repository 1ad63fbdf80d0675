"""The demonstration: what the package sees, completes and grasps, as a table, a folder of files and a page."""

from gfp_grasp.demo.run import run_demo

__all__ = ["run_demo"]
