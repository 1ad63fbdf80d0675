"""The command line `gfp-grasp`, which `python -m gfp_grasp.cli` is too."""

from gfp_grasp.cli.program import main

__all__ = ["main"]
